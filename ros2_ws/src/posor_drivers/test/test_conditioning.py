# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Groups of scans, and the scan that each group becomes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest
from posor.errors import BagError, ParameterError, PosorError
from posor.numerics.stamps import NS
from posor_drivers.conditioning import MAX_DARK_SCANS, condition_scans, stamp_ns
from posor_drivers.driver_parameters import ConditioningParameters
from posor_drivers.sources.source import SourceMessage
from posor_lab.harness.case_tables import refusal
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message
from scipy.stats import chi2

from .sample_bags import header, scan

START = 1000 * NS
TICK = 1_000_001
LIT, DARK = np.array([0, 1], dtype=np.uint8), np.array([255, 255], dtype=np.uint8)
NET_A = np.linspace(1e-5, 8e-5, 8)
BACKGROUND_A = np.linspace(3e-6, 1e-6, 8)


def item(number: int, **fields: Any) -> SourceMessage:
    fields = {"gap_voltages": np.full(3, 0.5)} | fields
    return SourceMessage("raw", 0, scan(number, START + number * TICK, **fields).data, number / 1000)


def pattern(text: str, drift: float = 0.0) -> Iterator[SourceMessage]:
    """Yield a scan for each letter: L lit, D dark; the background grows by a part ``drift`` of itself per scan."""
    for number, letter in enumerate(text):
        background = BACKGROUND_A * (1.0 + drift * number)
        if letter == "L":
            yield item(number, diode_currents=NET_A + background, lit_sources=LIT)
        else:
            yield item(number, diode_currents=background, lit_sources=DARK)


def condition(
    items: Iterable[SourceMessage], method: Any = "mean", samples: int = 5, **options: Any
) -> list[SourceMessage]:
    return list(condition_scans(iter(items), ConditioningParameters(method=method, samples=samples, **options)))


def scans(items: Iterable[SourceMessage], method: str = "mean", samples: int = 5, **options: Any) -> list[RawScan]:
    return [result.data for result in condition(items, method, samples, **options)]


def numbers(items: Iterable[SourceMessage], **options: Any) -> list[tuple[int, int]]:
    return [(result.scan, result.samples) for result in scans(items, **options)]


def test_the_times_of_a_mean_are_those_of_its_scans() -> None:
    others = np.zeros((2, 8))  # of the diodes
    offsets = np.hstack([[[-1e-4, 0.0, 1e-4], [-1e-4, math.nan, 2e-4]], others])
    errors = [{"exposure_span": 2e-4, "stamp_uncertainty": 1e-5}, {"exposure_span": 1e-4, "stamp_limit": 1e-3}]
    raw = [item(n, exposure_offsets=offsets[n], **errors[n]) for n in range(2)]
    unlike = item(2, exposure_offsets=np.empty(0))
    first, second = scans([*raw, unlike], samples=3)
    np.testing.assert_allclose(first.exposure_offsets, [-1e-4, math.nan, 1.5e-4, *others[0]], atol=1e-9)
    assert (first.stamp_uncertainty, first.stamp_limit) == (1e-5, 1e-3)
    assert first.exposure_span == pytest.approx(2e-4 + TICK / 1e9)
    assert (second.scan, list(second.exposure_offsets), second.exposure_span) == (2, [], 0.0)


@pytest.mark.parametrize(("method", "lost"), [("mean", math.nan), ("trimmed", 5.0)])
def test_a_reading_that_is_dropped_moves_the_exposure_of_its_channel(method: str, lost: float) -> None:
    """A channel that moves evenly reads its mean at the time that is stated, whichever reading is dropped."""
    noise = np.random.default_rng(1).normal(0.0, 1e-9, (9, 3))
    volts = 0.5 + 1e-7 * np.arange(9)[:, None] + noise
    volts[1, 0] = volts[8, 2] = lost
    (result,) = scans((item(n, gap_voltages=volts[n]) for n in range(9)), method=method, samples=9, significance=1e-9)
    assert stamp_ns(result) == START + 4 * TICK
    shown = 4.0 + np.array(result.exposure_offsets[:3]) * 1e9 / TICK
    np.testing.assert_allclose(shown, [35.0 / 8.0, 4.0, 28.0 / 8.0], rtol=1e-9)
    np.testing.assert_allclose(result.gap_voltages, 0.5 + 1e-7 * shown, rtol=0.0, atol=5e-9)
    assert result.exposure_span == pytest.approx(8 * TICK / 1e9)


def test_offsets_of_other_channels_are_refused() -> None:
    with pytest.raises(PosorError, match="scan 0: has 3 exposure_offsets; expected one of each channel, 11, or none"):
        scans([item(n, exposure_offsets=np.zeros(3)) for n in range(2)], samples=2)


def test_a_group_ends_where_scans_are_missing() -> None:
    assert numbers(item(n) for n in (0, 1, 2, 300, 301, 302, 303, 304)) == [(1, 3), (302, 5)]


def test_five_scans_become_one() -> None:
    gaps = np.random.default_rng(1).normal(0.5, 0.01, (5, 3))
    currents = np.random.default_rng(2).normal(5e-5, 1e-6, (5, 8))
    rings = np.random.default_rng(3).normal(0.4, 0.01, (5, 4))
    flags = [0, RawScan.STATUS_SATURATED, 0, RawScan.STATUS_HOME_BUMP, RawScan.STATUS_SATURATED]
    raw = [
        item(5 + n, gap_voltages=gaps[n], ring_voltages=rings[n], diode_currents=currents[n], status=flags[n])
        for n in range(5)
    ]
    (only,) = condition(raw)
    assert (only.topic, only.after_s) == ("raw", raw[-1].after_s)
    result = only.data
    assert (result.scan, stamp_ns(result), result.samples) == (7, START + 7 * TICK, 5)
    assert result.header.frame_id == "posor_receiving"
    assert result.status == RawScan.STATUS_SATURATED | RawScan.STATUS_HOME_BUMP
    assert list(result.lit_sources) == [0, 1]
    for name, spread, values in (
        ("gap_voltages", "gap_voltage_spreads", gaps),
        ("ring_voltages", "ring_voltage_spreads", rings),
        ("diode_currents", "diode_current_spreads", currents),
    ):
        np.testing.assert_allclose(getattr(result, name), values.mean(axis=0), rtol=1e-14)
        np.testing.assert_allclose(getattr(result, spread), values.std(axis=0, ddof=1), rtol=1e-11)


def test_groups_of_joints_fall_together_whenever_a_driver_begins_or_misses_a_scan() -> None:
    """Else the stamps of two joints differ for ever, and the arm has no endpoint."""
    late = (n for n in range(103, 130) if n != 111)
    assert numbers(item(n) for n in range(100, 130)) == [(n, 5) for n in range(102, 130, 5)]
    full = [(n, 5) for n in range(117, 130, 5)]
    assert numbers(item(n) for n in late) == [(103, 2), (107, 5), (110, 1), (113, 3), *full]
    switched = (item(n, lit_sources=LIT + (n >= 112)) for n in range(100, 130))
    assert numbers(switched) == [(102, 5), (107, 5), (110, 2), (113, 3), *full]


def test_scans_without_numbers_are_counted() -> None:
    raw = [SourceMessage("raw", 0, scan(0, START + n * TICK, gap_voltages=np.full(3, 0.5)).data) for n in range(10)]
    assert [samples for _, samples in numbers(raw)] == [5, 5]


def test_even_group_has_the_mean_stamp_and_the_earlier_number() -> None:
    (result,) = scans([item(4), item(5)], samples=2)
    assert (result.scan, stamp_ns(result)) == (4, START + 9 * TICK // 2)


def test_incomplete_last_group_is_published_with_fewer_samples() -> None:
    assert numbers(item(n) for n in range(12)) == [(2, 5), (7, 5), (10, 2)]
    (*_, last) = scans(item(n) for n in range(6))
    assert (last.samples, stamp_ns(last)) == (1, START + 5 * TICK)
    assert [len(last.gap_voltage_spreads), len(last.ring_voltage_spreads), len(last.diode_current_spreads)] == [0, 0, 0]


@pytest.mark.parametrize(
    "other",
    [
        {"lit_sources": np.array([2, 1], dtype=np.uint8)},
        {"gap_voltages": np.full(2, 0.5)},
        {"header": header(START + 99 * TICK, "another_frame")},
        {"header": header(START - TICK)},
        {"header": header(0)},
        {"status": RawScan.STATUS_DARK_SUBTRACTED},
    ],
)
def test_group_ends_early_where_scans_are_not_comparable(other: dict[str, Any]) -> None:
    result = condition([item(0), item(1), item(2), item(3, **other)])
    assert [(each.data.scan, each.data.samples, each.after_s) for each in result] == [(1, 3, 0.003), (3, 1, 0.003)]


def test_scan_without_stamp_does_not_affect_the_stamps_of_others() -> None:
    results = scans([item(0, header=header(0)), item(1), item(2)])
    assert [(stamp_ns(result), result.samples) for result in results] == [(0, 1), (START + 3 * TICK // 2, 2)]


def test_samples_of_averaged_scans_add_up() -> None:
    two = {"samples": 2, "gap_voltage_spreads": np.full(3, 0.1)}
    (result,) = scans([item(0, **two), item(1, **two)], samples=2)
    assert result.samples == 4
    np.testing.assert_allclose(result.gap_voltage_spreads, math.sqrt(2 * 0.1**2 / 3))
    assert all(math.isnan(spread) for spread in result.diode_current_spreads)  # these came without: not known


def test_outlier_is_dropped_and_flagged() -> None:
    values = [0.5, 0.501, 0.9, 0.499, 0.5]
    raw = [item(n, gap_voltages=np.array([value, 0.1, 0.2])) for n, value in enumerate(values)]
    (result,) = scans(raw, method="trimmed")
    assert (result.status, result.samples) == (RawScan.STATUS_OUTLIERS_DROPPED, 4)
    assert result.gap_voltages[0] == pytest.approx(0.5)
    (untrimmed,) = scans(raw)
    assert (untrimmed.status, untrimmed.samples) == (0, 5)
    assert untrimmed.gap_voltages[0] == pytest.approx(0.58)


def test_contacts_of_a_diode_are_dropped_together() -> None:
    currents = np.random.default_rng(4).normal(5e-5, 1e-8, (5, 8))
    currents[1, 6] += 1e-5
    (result,) = scans((item(n, diode_currents=currents[n]) for n in range(5)), method="trimmed")
    np.testing.assert_allclose(result.diode_currents[:4], currents[:, :4].mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(result.diode_currents[4:], currents[[0, 2, 3, 4], 4:].mean(axis=0), rtol=1e-14)


def test_reading_that_is_not_finite_is_flagged_or_gives_nan() -> None:
    once = [item(n, gap_voltages=np.array([0.1, math.nan if n == 1 else 0.2, math.nan])) for n in range(5)]
    (result,) = scans(once)
    assert (result.status, result.samples) == (RawScan.STATUS_OUTLIERS_DROPPED, 4)
    assert list(result.gap_voltages[:2]) == pytest.approx([0.1, 0.2])
    assert math.isnan(result.gap_voltages[2])
    (dead,) = scans(item(n, gap_voltages=np.array([0.1, math.nan, 0.3])) for n in range(5))
    assert (dead.status, dead.samples) == (0, 5)
    assert math.isnan(dead.gap_voltages[1])


def test_supply_and_temperature_are_means_of_measured_values() -> None:
    raw = [item(n, supply_voltage=5.0 + n, temperature=math.nan if n else 290.0) for n in range(5)]
    (result,) = scans(raw)
    assert (result.supply_voltage, result.temperature, result.status, result.samples) == (7.0, 290.0, 0, 5)
    (unmeasured,) = scans(item(n) for n in range(5))
    assert math.isnan(unmeasured.supply_voltage)
    (glitch,) = scans((item(n, supply_voltage=9.0 if n == 2 else 5.0 + n / 1000) for n in range(5)), method="trimmed")
    assert glitch.supply_voltage == pytest.approx(5.00200)
    assert glitch.status == RawScan.STATUS_OUTLIERS_DROPPED


@pytest.mark.parametrize(
    ("text", "drift", "expected"),
    [
        ("DLDLDLDLDLD", 0.0, [(5, 5)]),
        ("DLDLDLDLDLDLDLDLDLDLD", 0.1, [(5, 5), (15, 5)]),  # a steady drift cancels between dark neighbours
        ("LLDDLLL", 0.0, [(4, 5)]),
        ("DDLLLLLDLD", 0.0, [(4, 5), (8, 1)]),
        ("D" * 250 + "LLLLL", 0.0, [(252, 5)]),
    ],
)
def test_background_is_subtracted(text: str, drift: float, expected: list[tuple[int, int]]) -> None:
    results = scans(pattern(text, drift), subtract_dark=True)
    assert [(result.scan, result.samples) for result in results] == expected
    for result in results:
        np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)
        assert result.status == RawScan.STATUS_DARK_SUBTRACTED
        assert list(result.lit_sources) == [0, 1]


def test_only_the_nearest_dark_scans_are_background() -> None:
    far = (item(n, diode_currents=np.ones(8), lit_sources=DARK) for n in range(50))
    near = (item(50 + result, diode_currents=BACKGROUND_A, lit_sources=DARK) for result in range(MAX_DARK_SCANS))
    lit = item(50 + MAX_DARK_SCANS, diode_currents=NET_A + BACKGROUND_A)
    (result,) = scans([*far, *near, lit], subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)


def test_dark_scans_before_a_break_are_not_background() -> None:
    for dark in (item(0, header=header(START, "another_frame"), lit_sources=DARK), item(5, lit_sources=DARK)):
        (result,) = scans([dark, item(1, diode_currents=NET_A)], subtract_dark=True)
        assert result.status == 0
        np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-14)


def test_background_of_single_scans_is_subtracted() -> None:
    results = scans(pattern("DLDLDL", drift=0.1), method="none", samples=1, subtract_dark=True)
    assert [(result.scan, result.samples) for result in results] == [(1, 1), (3, 1), (5, 1)]
    for result in results[:2]:
        np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)


def test_noise_of_the_background_adds_to_that_of_the_mean() -> None:
    groups, sigma, random = 600, 1e-7, np.random.default_rng(5)
    raw = (
        SourceMessage(result.topic, 0, noisy(result.data, random, sigma), result.after_s)
        for result in pattern(groups * "DLDLDDDDDD")
    )
    results = scans(raw, samples=2, subtract_dark=True)
    assert len(results) == groups
    # Neighbours share the dark scans between them, so that only every second one is independent. Each has 2 lit scans,
    # and 7 dark ones before, 1 between and 7 after them; the last has fewer.
    independent = np.array([result.diode_currents - NET_A for result in results[1:-1:2]])
    variance = sigma**2 * (1 / 2 + 1 / 15)
    statistic = (independent**2).sum() / variance
    assert chi2.ppf(5e-7, independent.size) < statistic < chi2.isf(5e-7, independent.size)


def noisy(data: bytes, random: np.random.Generator, sigma: float) -> RawScan:
    content = deserialize_message(data, RawScan)
    content.diode_currents = (np.array(content.diode_currents) + random.normal(0.0, sigma, 8)).tolist()
    return content


def test_scans_without_dark_neighbours_are_unchanged_and_unflagged() -> None:
    first, second = scans(pattern("LLLLLLLLLLD"), subtract_dark=True)
    assert (first.status, second.status) == (0, RawScan.STATUS_DARK_SUBTRACTED)
    np.testing.assert_allclose(first.diode_currents, NET_A + BACKGROUND_A, rtol=1e-12)
    np.testing.assert_allclose(second.diode_currents, NET_A, rtol=1e-12)


def test_background_is_not_subtracted_twice() -> None:
    net = item(1, diode_currents=NET_A, status=RawScan.STATUS_DARK_SUBTRACTED)
    (result,) = scans([item(0, lit_sources=DARK), net], method="none", samples=1, subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-14)


def test_invalid_dark_readings_are_dropped_or_give_nan() -> None:
    nan = item(2, diode_currents=np.full(8, math.nan), lit_sources=DARK)
    raw = list(pattern("DLDLD"))
    (result,) = scans([*raw[:2], nan, *raw[3:]], samples=2, subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)
    assert result.status == RawScan.STATUS_DARK_SUBTRACTED | RawScan.STATUS_OUTLIERS_DROPPED
    (hidden,) = scans([raw[1], nan], samples=2, subtract_dark=True)
    assert np.isnan(hidden.diode_currents).all()


def test_home_mark_of_a_dark_scan_counts_once_and_its_other_flags_in_both_groups() -> None:
    status = RawScan.STATUS_HOME_BUMP | RawScan.STATUS_SATURATED
    raw = [item(0), item(1), item(2, lit_sources=DARK, status=status), item(3), item(4)]
    first, second = scans(raw, samples=2, subtract_dark=True)
    assert first.status == status | RawScan.STATUS_DARK_SUBTRACTED
    assert second.status == RawScan.STATUS_SATURATED | RawScan.STATUS_DARK_SUBTRACTED


def test_light_that_stays_off_does_not_delay_earlier_scans() -> None:
    results = condition(pattern("LLL" + 3 * MAX_DARK_SCANS * "D" + "LLLLL"), subtract_dark=True)
    assert [(each.data.scan, each.data.samples) for each in results] == [(1, 3), (3 * MAX_DARK_SCANS + 5, 5)]
    assert results[0].after_s == pytest.approx((2 + MAX_DARK_SCANS) / 1000)


def test_dark_scans_are_averaged_without_background_subtraction() -> None:
    assert numbers(pattern("LLDDD")) == [(0, 2), (3, 3)]


def test_record_without_lit_scans_is_refused() -> None:
    assert str(refusal(ParameterError, condition, pattern("DDD"), subtract_dark=True)) == (
        "parameter 'conditioning.subtract_dark': no light source was lit in any of the 3 scans; "
        "expected false, or lit scans among the dark ones."
    )


def test_other_topics_and_idle_conditioning_change_nothing() -> None:
    raw = [item(0), SourceMessage("/truth", 0, b"x", 0.0), item(1)]
    assert condition(raw, method="none", samples=1) == raw
    result = condition(raw, samples=2)
    assert [result.topic for result in result] == ["/truth", "raw"]
    assert result[0] is raw[1]


def test_incomplete_group_is_published_before_the_failure_of_the_source() -> None:
    def failing() -> Iterator[SourceMessage]:
        yield from (item(0), item(1))
        raise BagError("breaks off")

    stream = condition_scans(failing(), ConditioningParameters(method="mean", samples=5))
    assert next(stream).data.samples == 2
    with pytest.raises(BagError, match="breaks off"):
        next(stream)


TOO_MANY = [item(4, samples=40_000), item(5, samples=40_000)]


@pytest.mark.parametrize(
    ("raw", "sentence"),
    [
        ([item(4, samples=0)], "scan 4: is the mean of 0 samples; expected at least 1."),
        (TOO_MANY, "scans 4 to 5: are the mean of 80000 samples; expected at most 65535."),
        ([SourceMessage("raw", 0, item(4).data[:40])], "topic raw: the 40 bytes of a scan cannot be decoded."),
    ],
)
def test_invalid_scans_are_refused(raw: list[SourceMessage], sentence: str) -> None:
    assert str(refusal(PosorError, condition, raw, samples=2)) == sentence
