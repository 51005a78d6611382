from __future__ import annotations

import numpy as np
import pytest
from posor_estimator.core.calibrate.track import Track, dwells
from posor_estimator.errors import TrackError

SECOND = 1_000_000_000


def track(stamps: list[int], values: list[list[float]]) -> Track:
    return Track(np.array(stamps, dtype=np.int64), np.array(values), np.zeros(len(values[0])), "bag, topic /reference")


def stepped(*levels: tuple[float, int], period_ns: int = 100_000_000) -> Track:
    values = [level for level, count in levels for _ in range(count)]
    return track([period_ns * (n + 1) for n in range(len(values))], [[value] for value in values])


def test_values_between_stamps_lie_on_the_line_between_neighbours() -> None:
    reference = track([100, 200, 400], [[1.0, 0.0], [2.0, -1.0], [6.0, 1.0]])
    found = reference.at(np.array([100, 150, 200, 250, 400]), longest_gap_ns=1000)
    np.testing.assert_allclose(found, [[1.0, 0.0], [1.5, -0.5], [2.0, -1.0], [3.0, -0.5], [6.0, 1.0]])


def test_nothing_is_said_beyond_the_ends_nor_within_a_long_gap() -> None:
    reference = track([100, 200, 400], [[1.0], [2.0], [6.0]])
    found = reference.at(np.array([99, 401, 250, 200, 400]), longest_gap_ns=150)[:, 0]
    np.testing.assert_array_equal(np.isnan(found), [True, True, True, False, False])
    assert (found[3], found[4]) == (2.0, 6.0)


def test_stamps_of_today_lose_no_nanosecond() -> None:
    now = 1_795_000_000 * SECOND
    reference = track([now, now + 10], [[0.0], [10.0]])
    np.testing.assert_allclose(reference.at(now + np.arange(11), 100)[:, 0], np.arange(11.0))


@pytest.mark.parametrize(
    ("stamps", "values", "sentence"),
    [
        ([200, 100], [[1.0], [2.0]], "stamp 100 ns follows 200 ns; expected stamps that increase."),
        ([100, 100], [[1.0], [2.0]], "stamp 100 ns follows 100 ns; expected stamps that increase."),
        ([100, 200], [[1.0], [np.inf]], "the value at 200 ns is not finite; expected numbers."),
    ],
)
def test_track_that_cannot_be_interpolated_is_refused(
    stamps: list[int], values: list[list[float]], sentence: str
) -> None:
    with pytest.raises(TrackError) as caught:
        track(stamps, values)
    assert str(caught.value) == f"bag, topic /reference: {sentence}"


def test_quantity_that_the_reference_lacks_is_not_interpolated_and_is_no_dwell() -> None:
    reference = track([100, 200, 300, 400], [[0.0, 1.0], [np.nan, 1.0], [0.0, 1.0], [0.0, 1.0]])
    found = reference.at(np.array([150, 200, 350]), 1000)
    np.testing.assert_array_equal(found, [[np.nan, 1.0], [np.nan, 1.0], [0.0, 1.0]])
    with pytest.raises(TrackError, match=r"^bag, topic /reference: the value at 200 ns is not whole; expected every"):
        dwells(reference, still=0.1, least_ns=100)
    with pytest.raises(TrackError, match=r"^bag, topic /reference: the value at 200 ns is not finite; expected"):
        track([100, 200], [[0.0, 1.0], [np.nan, np.nan]])


def test_track_without_values_is_refused() -> None:
    with pytest.raises(TrackError, match=r"^bag: holds no values\.$"):
        Track(np.empty(0, dtype=np.int64), np.empty((0, 1)), np.zeros(1), "bag")


def test_dwells_are_where_the_reference_stands_still_long_enough() -> None:
    reference = stepped((0.0, 10), (0.5, 1), (1.0, 20), (1.5, 2), (2.0, 10))
    found = dwells(reference, still=0.01, least_ns=500_000_000)
    assert [dwell.value[0] for dwell in found] == [0.0, 1.0, 2.0]
    assert [dwell.samples for dwell in found] == [10, 20, 10]
    assert (found[1].begin_ns, found[1].end_ns) == (1_200_000_000, 3_100_000_000)
    assert [dwell.value[0] for dwell in dwells(reference, still=0.01, least_ns=1_500_000_000)] == [1.0]


def test_slow_motion_is_no_dwell() -> None:
    values = [[1e-3 * n] for n in range(100)]
    reference = track([100_000_000 * (n + 1) for n in range(100)], values)
    assert dwells(reference, still=1.5e-3, least_ns=500_000_000) == []


def test_beginning_of_a_dwell_is_left_out_while_it_settles() -> None:
    reference = stepped((0.0, 10), (1.004, 3), (1.0, 17))
    (found,) = dwells(reference, still=0.01, least_ns=1_000_000_000, settle_ns=300_000_000)
    assert (found.value[0], found.spread[0], found.samples) == (1.0, 0.0, 17)


def test_spread_of_a_dwell_is_that_of_its_values(rng: np.random.Generator) -> None:
    values = 1.0 + 1e-3 * rng.normal(size=(50, 2))
    reference = track([100 * (n + 1) for n in range(50)], values.tolist())
    (found,) = dwells(reference, still=0.1, least_ns=1000)
    np.testing.assert_allclose(found.value, values.mean(axis=0))
    np.testing.assert_allclose(found.spread, values.std(axis=0, ddof=1))
    assert found.holds(np.array([99, 100, 5000, 5001])).tolist() == [False, True, True, False]
