# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from posor.errors import PosorError
from posor.numerics.stamps import NS, tick_stamp_ns
from posor_lab.benchmark.tick_statistics import (
    COUNTERS,
    MeasuredRun,
    NothingReceivedError,
    TickWindow,
    evaluate_window,
    paired_p99_ratio,
    run_figures,
)

RATE = 2000
FIRST = 1_800_000_000 * RATE
TICKS = np.arange(FIRST, FIRST + 1000)
WINDOW = TickWindow(tick_stamp_ns(FIRST, RATE), tick_stamp_ns(FIRST + 1000, RATE), RATE)


def received(ticks: npt.NDArray[np.int64], numbers: npt.ArrayLike | None = None) -> npt.NDArray[np.int64]:
    """Return the rows of ticks whose poses are published 100 us and received 150 us after their stamps."""
    stamps = tick_stamp_ns(ticks, RATE)
    numbers = np.arange(len(stamps)) if numbers is None else numbers
    return np.column_stack([stamps, stamps + 100_000, stamps + 150_000, numbers]).astype(np.int64)


def evaluate(rows: npt.NDArray[np.int64]) -> MeasuredRun:
    return evaluate_window(rows, WINDOW, dict.fromkeys(COUNTERS, 0), {"all": 0.5}, {"all": 100.0})


def test_only_ticks_of_the_window_count() -> None:
    figures = run_figures([evaluate(received(np.arange(FIRST - 50, FIRST + 1050)))])
    assert [figures[key] for key in ("expected", "received", "lost", "not_received")] == [1000, 1000, 0, 0]
    assert [figures[key] for key in ("p50_us", "p99_us", "p999_us", "max_us")] == [150.0] * 4
    assert figures["published_p50_us"] == 100.0


@pytest.mark.parametrize("rate", [3, 7, 2000, 9999])
def test_adjacent_windows_hold_every_tick_once(rate: int) -> None:
    begin, middle, end = (1_800_000_000 * NS + part for part in (123_456_789, 400_000_000, 999_999_999))
    parts = [TickWindow(begin, middle, rate).stamps_ns, TickWindow(middle, end, rate).stamps_ns]
    assert np.array_equal(np.concatenate(parts), TickWindow(begin, end, rate).stamps_ns)
    edge = tick_stamp_ns(1_800_000_000 * rate + 1, rate)
    assert TickWindow(edge, edge + 1, rate).stamps_ns.tolist() == [edge]
    assert TickWindow(edge + 1, edge + 2, rate).stamps_ns.tolist() == []


def test_lost_ticks_are_split_by_whether_their_pose_was_published() -> None:
    ticks = np.delete(TICKS, [10, 11, 500])
    numbers = np.arange(len(ticks))
    numbers[400:] += 2  # two of the three lost poses were published
    figures = run_figures([evaluate(received(ticks, numbers))])
    assert [figures[key] for key in ("lost", "not_received", "not_published")] == [3, 2, 1]
    assert figures["expected"] == figures["received"] + figures["lost"]


def test_runs_are_combined() -> None:
    slow = received(TICKS)
    slow[:, 2] += 1_000_000
    figures = run_figures([evaluate(received(TICKS)), evaluate(slow)])
    assert [figures[key] for key in ("p99_us", "p50_us", "expected", "cpu_cores")] == [1150.0, 650.0, 2000, 0.5]
    assert figures["processes"] == {"all": {"cpu_cores": 0.5, "memory_mb": 100.0}}


def test_runs_are_compared_in_pairs() -> None:
    more_ns, other = (100_000, 10_000, 20_000, 30_000, 40_000, 900_000), np.full(1000, 100_000)
    pairs = [(np.repeat([100_000, 100_000 + more], [980, 20]), other) for more in more_ns]
    assert paired_p99_ratio(pairs) == pytest.approx({"median": 1.35, "low": 1.1, "high": 10.0})
    assert paired_p99_ratio([(other, other)] * 5) == {"median": 1.0, "low": None, "high": None}


def test_impossible_poses_are_refused() -> None:
    rows = received(TICKS)
    message = r"^endpoint/pose: no pose came in the measured time; expected 1000\.$"
    with pytest.raises(NothingReceivedError, match=message):
        evaluate(rows[:0])
    with pytest.raises(PosorError, match="two poses have the same stamp"):
        evaluate(np.concatenate([rows, rows[:1]]))
    rows[3, 0] += 1
    with pytest.raises(PosorError, match=f"stamp {rows[3, 0]} ns; expected a tick of 2000 Hz"):
        evaluate(rows)
