"""The benchmark's arithmetic and its page: what was received, lateness, growth, the highest rate, the tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.simulator.ticks import stamp_of
from posor_estimator.errors import ParameterError, PosorError

from tests.benchmarks.accounts import COUNTERS, NothingReceived, Run, Window, account, figures
from tests.benchmarks.alone import lateness
from tests.benchmarks.bench import ROOT
from tests.benchmarks.growth import figure, line, series
from tests.benchmarks.page import PLACE, filled
from tests.benchmarks.sections import LADDER, highest_rate, least_lost
from tests.benchmarks.tables import aims_of

if TYPE_CHECKING:
    import numpy.typing as npt

SECOND = 1_000_000_000
RATE = 2000
FIRST = 1_800_000_000 * RATE
WINDOW = Window(stamp_of(FIRST, RATE), stamp_of(FIRST + 1000, RATE), RATE)
NONE = dict.fromkeys(COUNTERS, 0)


def noted(ticks: npt.ArrayLike, numbers: npt.ArrayLike | None = None) -> npt.NDArray[np.int64]:
    """Poses of ticks, each published 100 us and received 150 us after its stamp."""
    stamps = np.array([stamp_of(tick, RATE) for tick in np.asarray(ticks).tolist()], dtype=np.int64)
    numbers = np.arange(len(stamps)) if numbers is None else numbers
    return np.column_stack([stamps, stamps + 100_000, stamps + 150_000, numbers]).astype(np.int64)


def accounted(rows: npt.NDArray[np.int64], window: Window = WINDOW) -> Run:
    return account(rows, window, NONE, {"all": 0.5}, {"all": 100.0})


def test_ticks_of_the_window_are_counted_and_no_others() -> None:
    told = figures([accounted(noted(np.arange(FIRST - 50, FIRST + 1050)))])
    assert (told["expected"], told["received"], told["lost"], told["not_received"]) == (1000, 1000, 0, 0)
    assert (told["p50_us"], told["p99_us"], told["p999_us"], told["max_us"]) == (150.0, 150.0, 150.0, 150.0)
    assert told["published_p50_us"] == 100.0


@pytest.mark.parametrize("rate", [3, 7, 2000, 9999])
def test_window_holds_every_tick_once(rate: int) -> None:
    begin, middle, end = (1_800_000_000 * SECOND + part for part in (123_456_789, 400_000_000, 999_999_999))
    parts = [Window(begin, middle, rate).stamps, Window(middle, end, rate).stamps]
    assert np.array_equal(np.concatenate(parts), Window(begin, end, rate).stamps)
    edge = stamp_of(1_800_000_000 * rate + 1, rate)
    assert Window(edge, edge + 1, rate).stamps.tolist() == [edge]
    assert Window(edge + 1, edge + 2, rate).stamps.tolist() == []


def test_lost_ticks_are_told_apart_by_whether_their_pose_was_published() -> None:
    ticks = np.delete(np.arange(FIRST, FIRST + 1000), [10, 11, 500])
    numbers = np.arange(len(ticks))
    numbers[400:] += 2  # of the three lost poses two had been published: their numbers are gone
    told = figures([accounted(noted(ticks, numbers))])
    assert (told["lost"], told["not_received"], told["not_published"]) == (3, 2, 1)
    assert told["expected"] == told["received"] + told["lost"]


def test_latencies_of_several_runs_are_taken_together() -> None:
    slow = noted(np.arange(FIRST, FIRST + 1000))
    slow[:, 2] += 1_000_000
    told = figures([accounted(noted(np.arange(FIRST, FIRST + 1000))), accounted(slow)])
    assert (told["p99_us"], told["p50_us"], told["expected"]) == (1150.0, 650.0, 2000)
    assert told["cpu_cores"] == 0.5
    assert told["processes"] == {"all": {"cpu_cores": 0.5, "memory_mb": 100.0}}


def test_poses_that_cannot_be_are_refused() -> None:
    good = noted(np.arange(FIRST, FIRST + 1000))
    with pytest.raises(NothingReceived, match=r"^endpoint/pose: no pose came in the measured time; expected 1000\.$"):
        accounted(good[:0])
    with pytest.raises(PosorError, match="two poses have the same stamp"):
        accounted(np.concatenate([good, good[:1]]))
    stray = good.copy()
    stray[3, 0] += 1
    with pytest.raises(PosorError, match=f"stamp {stray[3, 0]} ns; expected a tick of 2000 Hz"):
        accounted(stray)


class LateClock:
    """Stands in for a WallTime that comes to each tick 100 us late, and to one of them by two and a half more."""

    def __init__(self) -> None:
        self.now_ns = stamp_of(FIRST, RATE)
        self.waits = 0

    def wait(self, time_ns: int) -> None:
        self.waits += 1
        self.now_ns = time_ns + (1_350_000 if self.waits == 4 else 100_000)


def test_machine_alone_misses_what_a_driver_would_miss() -> None:
    clock = LateClock()
    found = lateness(RATE, clock, lambda: clock.waits == 10)  # type: ignore[arg-type]
    assert (found["expected"], found["missed"]) == (12, 2)
    assert found["p50_us"] == 100.0
    assert found["max_us"] == 350.0


def point(joints: int, rate: int, cores: float, lost: int = 0) -> dict[str, Any]:
    return {"joints": joints, "rate": rate, "cpu_cores": cores, "lost": lost, "expected": 1000}


def test_line_goes_through_the_points_that_hold() -> None:
    points = [point(16, 500, 0.9, lost=300), *(point(joints, 500, 0.02 + 0.03 * joints) for joints in (4, 1, 2))]
    fit = line(series([*points, point(1, 4000, 0.7)], "joints", 500), "joints")
    assert fit is not None
    assert fit.at == [1.0, 2.0, 4.0]
    assert (fit.cores, fit.slope) == pytest.approx((0.02, 0.03))
    assert fit.residuals == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert line(points[:2], "joints") is None
    picture = figure([*points, point(6, 500, 0.2), point(6, 2000, 0.5)], 6, 500)
    assert picture.startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("holds_to", "share", "found"),
    [(2600, 0.0, 2500), (499, 0.0, None), (500, 0.0, 500), (1e5, 0.0, 10_000), (1, 0.2, 10_000)],
)
def test_highest_rate_is_found_in_few_steps(holds_to: float, share: float, found: int | None) -> None:
    tried: list[int] = []

    def lost(rate: int) -> float:
        tried.append(rate)
        return 0.1 if rate > holds_to else 0.0

    assert highest_rate(lost, share) == found
    assert len(tried) <= 4
    assert set(tried) <= set(LADDER)


@pytest.mark.parametrize(
    ("given", "share", "found", "tries"),
    [([0.0, 9.0], 0.0, 0.0, 1), ([0.3, 0.0], 0.0, 0.0, 2), ([0.3, 0.2, 0.0], 0.1, 0.2, 2), ([0.05, 0.0], 0.1, 0.05, 1)],
)
def test_a_rate_is_tried_twice_before_it_counts_as_lost(
    given: list[float], share: float, found: float, tries: int
) -> None:
    left, tried = iter(given), dict[int, list[float]]()
    for _ in range(2):  # what was found stays
        assert least_lost(lambda _: next(left), 500, share, tried) == found
    assert tried == {500: given[:tries]}


def run_with(lost: int, p50_us: float, scans_per_s: float) -> dict[str, Any]:
    """Return the figures of a run that is long enough."""
    return {
        "graph_6x2000": {"expected": 120_100, "lost": lost, "p99_us": 900.0, "p50_us": p50_us},
        "floor_6x2000": {"p50_us": 100.0},
        "offline_scans": 3_600_000,
        "offline_scans_per_s": scans_per_s,
        "plain_loop_scans_per_s": 2e4,
        "offline_memory_mb": 400.0,
    }


def test_aims_are_judged_by_what_was_measured_in_all_runs() -> None:
    slow, quick = run_with(1, 151.0, 4e5), run_with(0, 150.0, 6e5)
    shown = aims_of([quick, slow, quick])
    assert shown is not None
    assert shown.header == ("", "wanted", "run 1", "run 2", "run 3", "holds")
    assert shown.rows == [
        ("six joints at 2 kHz: ticks lost", "at most 0", "0.00", "1.00", "0.00", "in 2 of 3"),
        ("p99, us", "at most 1,000", "900.00", "900.00", "900.00", "yes"),
        ("p50, graph to floor", "at most 1.5", "1.50", "1.51", "1.50", "in 2 of 3"),
        ("reprocessing, scans/s per core", "at least 500,000", "600,000", "400,000", "600,000", "in 2 of 3"),
        (
            "reprocessing to the plain message loop, whose results are the same",
            "at least 20",
            *("30.00", "20.00", "30.00", "yes"),
        ),
        ("reprocessing, memory, MB", "at most 500", "400.00", "400.00", "400.00", "yes"),
    ]
    alone = aims_of([slow])
    assert alone is not None
    assert alone.header == ("", "wanted", "found", "holds")
    assert alone.rows[0] == ("six joints at 2 kHz: ticks lost", "at most 0", "1.00", "no")


def test_nothing_is_said_of_aims_where_less_was_measured() -> None:
    brief = {**run_with(0, 100.0, 6e5), "offline_scans": 120_000}
    brief["graph_6x2000"]["expected"] = 12_000
    assert aims_of([brief]) is None
    assert aims_of([{"graph_2x200": {}}]) is None


def test_page_gets_the_figures_and_keeps_what_was_not_measured() -> None:
    page = (
        "Text.\n<!-- machine -->\nold\n<!-- end -->\n<!-- graph -->\n<!-- end -->\n<!-- growth -->\nold\n<!-- end -->\n"
    )
    told = figures([accounted(noted(np.arange(FIRST, FIRST + 1000)))])
    told_machine = {
        "cores": 2,
        "processor": "P",
        "kernel": "6",
        "python": "3",
        "rmw": "r",
        "compiled": True,
        "load": 0.1,
    }
    results = {"machine": told_machine, "graph_6x2000": told, "floor_6x2000": told}
    result = filled(page, [results])
    assert result.startswith(
        "Text.\n<!-- machine -->\n2 cores (P), Linux 6, Python 3, r, kernels compiled.\n<!-- end -->\n"
    )
    assert "| graph | 150 | 150 | 150 | 150 | 0 of 1000 | 0.50 | 100 |\n" in result
    assert result.endswith("<!-- growth -->\nold\n<!-- end -->\n")
    assert filled(result, [results]) == result
    others = [{**results, "graph_6x2000": {**told, "p50_us": latency}} for latency in (1.0, 170.0, 160.0)]
    assert "| graph | 160 | 150 |" in filled(page, others)
    with pytest.raises(ParameterError, match="'<!-- grpah -->' is no place"):
        filled("<!-- grpah -->\n<!-- end -->\n", [results])


def test_every_place_of_the_page_is_known() -> None:
    assert PLACE.findall((ROOT / "docs/performance.md").read_text()) == [
        "machine",
        "aims",
        "graph",
        "alone",
        "waiting",
        "layouts",
        "profile",
        "growth",
        "single",
    ]
