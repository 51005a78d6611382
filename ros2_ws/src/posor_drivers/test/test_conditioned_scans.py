"""Which scans become one, and what that one says."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.conditioned_scans import ConditioningParameters, conditioned
from posor_drivers.scan_groups import MOST_DARK, stamp_of
from posor_drivers.timeline import Due
from posor_estimator.errors import BagError, ParameterError, PosorError
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message
from scipy.stats import chi2

from .bags import header, scan

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

START = 1000 * 1_000_000_000
TICK = 1_000_001
LIT, DARK = np.array([0, 1], dtype=np.uint8), np.array([255, 255], dtype=np.uint8)
NET_A = np.linspace(1e-5, 8e-5, 8)
BACKGROUND_A = np.linspace(3e-6, 1e-6, 8)


def due(number: int, **fields: Any) -> Due:
    fields = {"gap_voltages": np.full(3, 0.5)} | fields
    return Due("raw", scan(number, START + number * TICK, **fields).data, number / 1000)


def pattern(text: str, drift: float = 0.0) -> Iterator[Due]:
    """Yield a scan for each letter: L lit, D dark; the background grows by a part ``drift`` of itself at each scan."""
    for number, letter in enumerate(text):
        background = BACKGROUND_A * (1.0 + drift * number)
        if letter == "L":
            yield due(number, diode_currents=NET_A + background, lit_sources=LIT)
        else:
            yield due(number, diode_currents=background, lit_sources=DARK)


def run(dues: Iterable[Due], method: Any = "mean", samples: int = 5, **options: Any) -> list[Due]:
    return list(conditioned(iter(dues), ConditioningParameters(method=method, samples=samples, **options)))


def scans(dues: Iterable[Due], method: str = "mean", samples: int = 5, **options: Any) -> list[RawScan]:
    return [each.content for each in run(dues, method, samples, **options)]


def numbers(dues: Iterable[Due], **options: Any) -> list[tuple[int, int]]:
    return [(each.scan, each.samples) for each in scans(dues, **options)]


def test_five_scans_become_one() -> None:
    gaps = np.random.default_rng(1).normal(0.5, 0.01, (5, 3))
    currents = np.random.default_rng(2).normal(5e-5, 1e-6, (5, 8))
    rings = np.random.default_rng(3).normal(0.4, 0.01, (5, 4))
    flags = [0, RawScan.STATUS_SATURATED, 0, RawScan.STATUS_HOME_BUMP, RawScan.STATUS_SATURATED]
    raw = [
        due(7 + n, gap_voltages=gaps[n], ring_voltages=rings[n], diode_currents=currents[n], status=flags[n])
        for n in range(5)
    ]
    (only,) = run(raw)
    assert (only.topic, only.after_s) == ("raw", raw[-1].after_s)
    result = only.content
    assert (result.scan, stamp_of(result), result.samples) == (9, START + 9 * TICK, 5)
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


def test_even_number_of_scans_has_the_stamp_between_and_the_number_before() -> None:
    (result,) = scans([due(3), due(4)], samples=2)
    assert (result.scan, stamp_of(result)) == (3, START + 7 * TICK // 2)


def test_incomplete_last_group_is_published_with_fewer_samples() -> None:
    assert numbers(due(n) for n in range(12)) == [(2, 5), (7, 5), (10, 2)]
    (*_, last) = scans(due(n) for n in range(6))
    assert (last.samples, stamp_of(last)) == (1, START + 5 * TICK)
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
def test_group_ends_early_where_scans_do_not_belong_together(other: dict[str, Any]) -> None:
    result = run([due(0), due(1), due(2), due(3, **other)])
    assert [(each.content.scan, each.content.samples, each.after_s) for each in result] == [
        (1, 3, 0.003),
        (3, 1, 0.003),
    ]


def test_scan_without_a_stamp_does_not_spoil_the_stamp_of_others() -> None:
    results = scans([due(0, header=header(0)), due(1), due(2)])
    assert [(stamp_of(each), each.samples) for each in results] == [(0, 1), (START + 3 * TICK // 2, 2)]


def test_samples_of_averaged_scans_add_up() -> None:
    two = {"samples": 2, "gap_voltage_spreads": np.full(3, 0.1)}
    (result,) = scans([due(0, **two), due(1, **two)], samples=2)
    assert result.samples == 4
    np.testing.assert_allclose(result.gap_voltage_spreads, math.sqrt(2 * 0.1**2 / 3))
    assert all(math.isnan(spread) for spread in result.diode_current_spreads)  # these came without: not known


def test_outlier_is_dropped_and_told() -> None:
    values = [0.5, 0.501, 0.9, 0.499, 0.5]
    raw = [due(n, gap_voltages=np.array([value, 0.1, 0.2])) for n, value in enumerate(values)]
    (result,) = scans(raw, method="trimmed")
    assert (result.status, result.samples) == (RawScan.STATUS_OUTLIERS_DROPPED, 4)
    assert result.gap_voltages[0] == pytest.approx(0.5)
    (untrimmed,) = scans(raw)
    assert (untrimmed.status, untrimmed.samples) == (0, 5)
    assert untrimmed.gap_voltages[0] == pytest.approx(0.58)


def test_contacts_of_a_diode_are_dropped_together() -> None:
    currents = np.random.default_rng(4).normal(5e-5, 1e-8, (5, 8))
    currents[1, 6] += 1e-5
    (result,) = scans((due(n, diode_currents=currents[n]) for n in range(5)), method="trimmed")
    np.testing.assert_allclose(result.diode_currents[:4], currents[:, :4].mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(result.diode_currents[4:], currents[[0, 2, 3, 4], 4:].mean(axis=0), rtol=1e-14)


def test_reading_that_is_not_finite_is_never_hidden() -> None:
    once = [due(n, gap_voltages=np.array([0.1, math.nan if n == 1 else 0.2, math.nan])) for n in range(5)]
    (result,) = scans(once)
    assert (result.status, result.samples) == (RawScan.STATUS_OUTLIERS_DROPPED, 4)
    assert list(result.gap_voltages[:2]) == pytest.approx([0.1, 0.2])
    assert math.isnan(result.gap_voltages[2])
    (dead,) = scans(due(n, gap_voltages=np.array([0.1, math.nan, 0.3])) for n in range(5))
    assert (dead.status, dead.samples) == (0, 5)
    assert math.isnan(dead.gap_voltages[1])


def test_supply_and_temperature_are_means_of_where_they_were_measured() -> None:
    raw = [due(n, supply_voltage=5.0 + n, temperature=math.nan if n else 290.0) for n in range(5)]
    (result,) = scans(raw)
    assert (result.supply_voltage, result.temperature, result.status, result.samples) == (7.0, 290.0, 0, 5)
    (unmeasured,) = scans(due(n) for n in range(5))
    assert math.isnan(unmeasured.supply_voltage)
    (glitch,) = scans((due(n, supply_voltage=9.0 if n == 2 else 5.0 + n / 1000) for n in range(5)), method="trimmed")
    assert glitch.supply_voltage == pytest.approx(5.00200)
    assert glitch.status == RawScan.STATUS_OUTLIERS_DROPPED


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("DLDLDLDLDLD", [(5, 5)]),
        ("DLDLDLDLDLDLDLDLDLDLD", [(5, 5), (15, 5)]),
        ("LLDDLLL", [(4, 5)]),
        ("DDLLLLLDLD", [(4, 5), (8, 1)]),
        ("D" * 250 + "LLLLL", [(252, 5)]),
    ],
)
def test_background_is_subtracted(text: str, expected: list[tuple[int, int]]) -> None:
    results = scans(pattern(text), subtract_dark=True)
    assert [(each.scan, each.samples) for each in results] == expected
    for each in results:
        np.testing.assert_allclose(each.diode_currents, NET_A, rtol=1e-12)
        assert each.status == RawScan.STATUS_DARK_SUBTRACTED
        assert list(each.lit_sources) == [0, 1]


def test_steady_drift_of_the_background_cancels_between_dark_neighbours() -> None:
    for result in scans(pattern("DLDLDLDLDLD" + "LDLDLDLDLD", drift=0.1), subtract_dark=True):
        np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)


def test_only_near_dark_scans_are_background() -> None:
    far = (due(n, diode_currents=np.ones(8), lit_sources=DARK) for n in range(50))
    near = (due(50 + each, diode_currents=BACKGROUND_A, lit_sources=DARK) for each in range(MOST_DARK))
    lit = due(50 + MOST_DARK, diode_currents=NET_A + BACKGROUND_A)
    (result,) = scans([*far, *near, lit], subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)


def test_dark_scans_of_before_a_break_are_no_background() -> None:
    for dark in (due(0, header=header(START, "another_frame"), lit_sources=DARK), due(5, lit_sources=DARK)):
        (result,) = scans([dark, due(1, diode_currents=NET_A)], subtract_dark=True)
        assert result.status == 0
        np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-14)


def test_single_scans_can_be_freed_of_their_background() -> None:
    results = scans(pattern("DLDLDL", drift=0.1), method="none", samples=1, subtract_dark=True)
    assert [(each.scan, each.samples) for each in results] == [(1, 1), (3, 1), (5, 1)]
    for each in results[:2]:
        np.testing.assert_allclose(each.diode_currents, NET_A, rtol=1e-12)


def test_noise_of_the_background_adds_to_that_of_the_mean() -> None:
    groups, sigma, random = 600, 1e-7, np.random.default_rng(5)
    raw = (Due(each.topic, noisy(each.content, random, sigma), each.after_s) for each in pattern(groups * "DLDLDDDDDD"))
    results = scans(raw, samples=2, subtract_dark=True)
    assert len(results) == groups
    # Neighbours share the dark scans between them, so that only every second one is independent. Each has 2 lit scans,
    # and 7 dark ones before, 1 between and 7 after them; the last has fewer.
    independent = np.array([each.diode_currents - NET_A for each in results[1:-1:2]])
    variance = sigma**2 * (1 / 2 + 1 / 15)
    statistic = (independent**2).sum() / variance
    assert chi2.ppf(5e-7, independent.size) < statistic < chi2.isf(5e-7, independent.size)


def noisy(data: bytes, random: np.random.Generator, sigma: float) -> RawScan:
    content = deserialize_message(data, RawScan)
    content.diode_currents = (np.array(content.diode_currents) + random.normal(0.0, sigma, 8)).tolist()
    return content


def test_scans_without_dark_neighbours_stay_as_they_are_and_say_so() -> None:
    first, second = scans(pattern("LLLLLLLLLLD"), subtract_dark=True)
    assert (first.status, second.status) == (0, RawScan.STATUS_DARK_SUBTRACTED)
    np.testing.assert_allclose(first.diode_currents, NET_A + BACKGROUND_A, rtol=1e-12)
    np.testing.assert_allclose(second.diode_currents, NET_A, rtol=1e-12)


def test_currents_that_are_net_already_are_not_touched() -> None:
    net = due(1, diode_currents=NET_A, status=RawScan.STATUS_DARK_SUBTRACTED)
    (result,) = scans([due(0, lit_sources=DARK), net], method="none", samples=1, subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-14)


def test_bad_dark_readings_are_dropped_or_shown() -> None:
    nan = due(2, diode_currents=np.full(8, math.nan), lit_sources=DARK)
    raw = list(pattern("DLDLD"))
    (result,) = scans([*raw[:2], nan, *raw[3:]], samples=2, subtract_dark=True)
    np.testing.assert_allclose(result.diode_currents, NET_A, rtol=1e-12)
    assert result.status == RawScan.STATUS_DARK_SUBTRACTED | RawScan.STATUS_OUTLIERS_DROPPED
    (hidden,) = scans([raw[1], nan], samples=2, subtract_dark=True)
    assert np.isnan(hidden.diode_currents).all()


def test_home_mark_of_a_dark_scan_counts_once_and_its_other_flags_wherever_it_is_used() -> None:
    status = RawScan.STATUS_HOME_BUMP | RawScan.STATUS_SATURATED
    raw = [due(0), due(1), due(2, lit_sources=DARK, status=status), due(3), due(4)]
    first, second = scans(raw, samples=2, subtract_dark=True)
    assert first.status == status | RawScan.STATUS_DARK_SUBTRACTED
    assert second.status == RawScan.STATUS_SATURATED | RawScan.STATUS_DARK_SUBTRACTED


def test_light_that_stays_off_does_not_hold_back_the_scans_before() -> None:
    results = run(pattern("LLL" + 3 * MOST_DARK * "D" + "LLLLL"), subtract_dark=True)
    assert [(each.content.scan, each.content.samples) for each in results] == [(1, 3), (3 * MOST_DARK + 5, 5)]
    assert results[0].after_s == pytest.approx((2 + MOST_DARK) / 1000)


def test_dark_scans_are_scans_like_others_unless_they_are_to_be_subtracted() -> None:
    assert numbers(pattern("LLDDD")) == [(0, 2), (3, 3)]


def test_darkness_without_end_is_told() -> None:
    with pytest.raises(ParameterError) as caught:
        run(pattern("DDD"), subtract_dark=True)
    assert str(caught.value) == (
        "parameter 'conditioning.subtract_dark': no light source was lit in any of the 3 scans; "
        "expected false, or lit scans among the dark ones."
    )


def test_other_topics_and_idle_conditioning_change_nothing() -> None:
    raw = [due(0), Due("/truth", b"x", 0.0), due(1)]
    assert run(raw, method="none", samples=1) == raw
    result = run(raw, samples=2)
    assert [each.topic for each in result] == ["/truth", "raw"]
    assert result[0] is raw[1]


def test_group_that_was_begun_goes_out_before_the_source_fails() -> None:
    def failing() -> Iterator[Due]:
        yield from (due(0), due(1))
        raise BagError("breaks off")

    stream = conditioned(failing(), ConditioningParameters(method="mean", samples=5))
    assert next(stream).content.samples == 2
    with pytest.raises(BagError, match="breaks off"):
        next(stream)


@pytest.mark.parametrize(
    ("raw", "sentence"),
    [
        ([due(4, samples=0)], "scan 4: is the mean of 0 samples; expected at least 1."),
        (
            [due(4, samples=40_000), due(5, samples=40_000)],
            "scans 4 to 5: are the mean of 80000 samples; expected at most 65535.",
        ),
        ([Due("raw", due(4).content[:40], 0.0)], "topic raw: the 40 bytes of a scan cannot be decoded."),
    ],
)
def test_scans_that_cannot_be_are_refused(raw: list[Due], sentence: str) -> None:
    with pytest.raises(PosorError) as caught:
        run(raw, samples=2)
    assert str(caught.value) == sentence
