# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Dwells of a reference, the mean scans in them, and readings that disagree with their dwell."""

from __future__ import annotations

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.errors import FitError, TrackError
from posor.estimation.forward import empty_scans
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS
from posor_calibration.dwells import (
    Dwell,
    DwellOptions,
    average_dwells,
    average_recording,
    find_dwells,
    mask_outliers,
    scans_with_reference,
    use_values_once,
)

GAPS = ("gap_voltages",)
SOURCE = "bag, topic /reference"


def track(values: FloatArray, period_ns: int = 100_000_000, sigma: float = 0.0) -> Track:
    stamps = period_ns * (1 + np.arange(len(values), dtype=np.int64))
    return Track(stamps, values, np.full(values.shape[1], sigma), SOURCE)


def stepped(*levels: tuple[float, int]) -> Track:
    return track(np.repeat([level for level, _ in levels], [count for _, count in levels])[:, None])


def test_dwells_are_where_the_reference_rests_long_enough() -> None:
    reference = stepped((0.0, 10), (0.5, 1), (1.0, 20), (1.5, 2), (2.0, 10))
    found = find_dwells(reference, 0.01, 500_000_000)
    assert [dwell.mean[0] for dwell in found] == [0.0, 1.0, 2.0]
    assert [dwell.samples for dwell in found] == [10, 20, 10]
    assert (found[1].begin_ns, found[1].end_ns) == (1_200_000_000, 3_100_000_000)
    assert [dwell.mean[0] for dwell in find_dwells(reference, 0.01, 1_500_000_000)] == [1.0]


def test_each_value_of_a_reference_counts_once() -> None:
    reference = track(np.arange(4.0)[:, None], period_ns=100)  # at 100 to 400 ns
    known = np.ones(8, dtype=bool)
    frequent = np.array([100, 130, 160, 190, 220, 250, 310, 400])
    assert use_values_once(reference, frequent, known).tolist() == [1, 0, 0, 1, 0, 0, 1, 1]
    known[3] = False  # the next one stands in
    assert use_values_once(reference, frequent, known).tolist() == [1, 0, 0, 0, 1, 0, 1, 1]
    rare, every = np.array([120, 330]), np.ones(2, dtype=bool)
    assert use_values_once(reference, rare, every).tolist() == [1, 1]
    assert not use_values_once(reference, rare, ~every).any()


def test_slow_motion_is_no_dwell() -> None:
    assert find_dwells(track(1e-3 * np.arange(100.0)[:, None]), 1.5e-3, 500_000_000) == []


def test_the_beginning_of_a_dwell_is_left_out_while_it_settles() -> None:
    reference = stepped((0.0, 10), (1.004, 3), (1.0, 17))
    (found,) = find_dwells(reference, 0.01, NS, settle_ns=300_000_000)
    assert (found.mean[0], found.deviation[0], found.samples) == (1.0, 0.0, 17)


def test_deviation_of_a_dwell_is_that_of_its_values(rng: np.random.Generator) -> None:
    values = 1.0 + 1e-3 * rng.normal(size=(50, 2))
    (found,) = find_dwells(track(values, 100), 0.1, 1000)
    np.testing.assert_allclose(found.mean, values.mean(axis=0))
    np.testing.assert_allclose(found.deviation, values.std(axis=0, ddof=1))
    assert (found.begin_ns, found.end_ns) == (100, 5000)


def test_dwells_need_every_quantity_of_the_reference() -> None:
    with pytest.raises(TrackError, match=r"^bag, topic /reference: the value at 200 ns is incomplete; expected every"):
        find_dwells(track(np.array([[0.0, 1.0], [np.nan, 1.0]]), 100), 0.1, 100)


def scans_of(volts: FloatArray, stamps: list[int] | None = None, lit: list[list[int]] | None = None) -> Scans:
    times = np.arange(1, len(volts) + 1) * 20_000_000 if stamps is None else np.array(stamps)
    scans = empty_scans(times.astype(np.int64)).with_fields({"gap_voltages": volts})
    return scans if lit is None else scans.with_fields({"lit_sources": np.array(lit, dtype=np.int64)})


def dwell(begin: int, end: int, mean: float = 0.0, deviation: float = 0.0, samples: int = 4) -> Dwell:
    return Dwell(begin, end, np.array([mean]), np.array([deviation]), samples)


REFERENCE = track(np.zeros((2, 1)), 1)


def test_means_are_of_the_scans_within_each_dwell() -> None:
    scans = scans_of(np.array([[9.0], [1.0], [3.0], [9.0], [5.0], [9.0]]), [10, 20, 30, 40, 50, 60])
    found = average_dwells(scans, REFERENCE, [dwell(20, 30), dwell(45, 55), dwell(56, 59)], source="bag")
    assert found.scans.gap_voltages[:, 0].tolist() == [2.0, 5.0]
    assert found.scans.stamps_ns.tolist() == [25, 50]
    assert (found.counts.tolist(), len(found)) == ([2, 1], 2)


def test_uncertainty_of_means_is_pooled_over_the_dwells(rng: np.random.Generator) -> None:
    volts = rng.normal(size=(60, 2)) * [1e-3, 5e-3] + np.repeat([[1.0, 2.0], [3.0, -1.0], [0.0, 0.0]], 20, axis=0)
    dwells = [dwell(1, 20), dwell(21, 40), dwell(41, 60)]
    found = average_dwells(scans_of(volts, list(range(1, 61))), REFERENCE, dwells, source="bag")
    pooled = np.sqrt(np.mean(volts.reshape(3, 20, 2).var(axis=1, ddof=1), axis=0))
    np.testing.assert_allclose(found.deviations["gap_voltages"], pooled)
    np.testing.assert_allclose(found.sigmas("gap_voltages"), np.tile(pooled / np.sqrt(20.0), (3, 1)))


def test_uncertainty_of_the_reference_includes_its_scatter() -> None:
    scans = scans_of(np.zeros((4, 1)), [10, 20, 30, 40])
    reference = track(np.zeros((2, 1)), 1, sigma=3e-6)
    found = average_dwells(scans, reference, [dwell(10, 40, mean=0.5, deviation=8e-6, samples=4)], source="bag")
    np.testing.assert_allclose(found.reference, [[0.5]])
    np.testing.assert_allclose(found.reference_sigmas, [[5e-6]])


@pytest.mark.parametrize(
    ("lit", "ends", "sentence"),
    [
        (None, (30, 40), "none of its 1 dwells holds a scan; expected scans of the same time span."),
        ([[0, 1], [0, 2]], (10, 20), "the lit source changes within the dwell from 10 ns to 20 ns; expected one lit "),
    ],
)
def test_dwell_without_a_usable_scan_is_refused(
    lit: list[list[int]] | None, ends: tuple[int, int], sentence: str
) -> None:
    with pytest.raises(TrackError) as caught:
        average_dwells(scans_of(np.zeros((2, 1)), [10, 20], lit), REFERENCE, [dwell(*ends)], source=SOURCE)
    assert str(caught.value).startswith(f"bag, topic /reference: {sentence}")


def test_scans_without_a_reference_are_left_out() -> None:
    reference = track(np.array([[0.0], [1.0]]), 100)
    scans, values = scans_with_reference(scans_of(np.zeros((3, 1)), [50, 150, 250]), reference, 1000)
    assert (scans.stamps_ns.tolist(), values.tolist()) == ([150], [[0.5]])
    with pytest.raises(TrackError, match="has no value at the times of the 1 scans; expected values at most 1e-06 s"):
        scans_with_reference(scans_of(np.zeros((1, 1)), [50]), reference, 1000)


def test_of_scans_between_two_values_of_a_reference_those_next_to_them_are_used() -> None:
    reference = track(np.array([[0.0], [1.0]]), 100)
    scans, values = scans_with_reference(scans_of(np.zeros((4, 1)), [110, 130, 160, 190]), reference, 1000)
    assert (scans.stamps_ns.tolist(), values.ravel().tolist()) == ([110, 190], [0.1, 0.9])


def test_without_a_least_dwell_each_scan_is_one() -> None:
    reference = track(np.array([[0.0], [1.0]]), 100, sigma=0.1)
    recording = Recording(scans_of(np.array([[7.0], [8.0]]), [100, 200]), {"/reference": reference}, "bag")
    found = average_recording(recording, reference, DwellOptions(least_dwell=0.0))
    assert found.reference.tolist() == [[0.0], [1.0]]
    assert found.reference_sigmas.tolist() == [[0.1], [0.1]]
    assert np.isnan(found.sigmas("gap_voltages")).all()


def test_reference_that_never_rests_is_refused() -> None:
    moving = track(np.arange(100.0)[:, None], NS)
    recording = Recording(scans_of(np.zeros((1, 1)), [NS]), {"/reference": moving}, "bag")
    sentence = r"^bag, topic /reference: never stands still within 0\.1 for 0\.2 s; expected dwells"
    with pytest.raises(TrackError, match=sentence):
        average_recording(recording, moving, DwellOptions(still=0.1))


def noise(count: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(3e-4 * np.round(3.0 * rng.normal(size=(count, 3))))


def test_outliers_and_missing_readings_are_left_out_and_named(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[40:] += 0.5
    volts[7, 1] += 0.1
    volts[55, 1] = np.nan
    whole = scans_of(volts)
    parts, (sentence,) = mask_outliers([whole.part(0, 40), whole.part(40, 80)], np.zeros(2), GAPS, "bag")
    left = np.concatenate([part.gap_voltages for part in parts])
    assert np.argwhere(np.isnan(left)).tolist() == [[7, 1], [55, 1]]
    np.testing.assert_array_equal(left[~np.isnan(left)], volts[~np.isnan(left)])
    assert sentence == "bag: left out 2 of 80 readings of gap voltage 2 that disagree with their dwell (scan 7, 55)."


def test_readings_may_follow_a_reference_that_moves_within_its_dwell(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[40:] += 0.5
    volts[36:40] += 0.1
    whole = scans_of(volts)
    parts = [whole.part(0, 40), whole.part(40, 80)]
    assert len(mask_outliers(parts, np.zeros(2), GAPS, "bag")[1]) == 3
    assert mask_outliers(parts, np.array([0.05, 0.0]), GAPS, "bag")[1] == ()


def test_too_many_outliers_are_refused(rng: np.random.Generator) -> None:
    volts = noise(80, rng)
    volts[9:18, 2] += 1.0
    sentence = (
        r"^bag: 9 of 80 readings of gap voltage 3 disagree with their dwell, the first in scan 9; expected at most"
    )
    with pytest.raises(FitError, match=sentence):
        mask_outliers([scans_of(volts)], np.zeros(1), GAPS, "bag")
