"""make bench: it measures what it says, its accounts add up, what cannot be is refused. No figure is judged here."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from itertools import count
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.simulator.ticks import stamp_of
from posor_estimator.errors import ParameterError, PosorError

from tests.benchmarks.accounts import COUNTERS, NothingReceived, Run, Window, account, figures
from tests.benchmarks.alone import lateness
from tests.benchmarks.bench import ROOT, main, parse
from tests.benchmarks.growth import figure, line, series
from tests.benchmarks.page import PLACE, filled
from tests.benchmarks.sections import LADDER, highest_rate
from tests.benchmarks.stopwatch import Stopwatches

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
    ("arguments", "said"),
    [
        (["--joints", "0"], "make bench: --joints 0; expected 1 to 16."),
        (["--joints", "17"], "make bench: --joints 17; expected 1 to 16."),
        (["--rate", "20000"], "make bench: --rate 20000; expected 1 to 10000."),
        (["--seconds", "0.1"], "make bench: --seconds 0.1; expected 1 to 3600."),
        (["--seconds", "nan"], "make bench: --seconds nan; expected 1 to 3600."),
        (["--layout", "none"], "argument --layout: invalid choice: 'none'"),
        (
            ["--only", "graph,nothing"],
            "argument --only: 'nothing' is no section; expected some of graph, waiting, layouts",
        ),
        (["--fast"], "unrecognized arguments: --fast"),
    ],
)
def test_wrong_options_are_refused(arguments: list[str], said: str) -> None:
    with pytest.raises(ParameterError) as caught:
        parse(arguments)
    assert said in str(caught.value)


def test_output_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert main(["--output", str(tmp_path / "file" / "bench.json")]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err


def test_stopwatches_show_what_a_stage_takes_without_those_that_it_calls() -> None:
    watches = Stopwatches()
    inner = watches.timed(sleep, "inner")

    def work() -> None:
        sleep(0.02)
        inner(0.05)
        inner(0.05)

    watches.timed(work, lambda: "outer")()
    other = Thread(target=inner, args=(0.0,))
    other.start()
    other.join()
    found = watches.found()
    assert {name: calls for name, (calls, _) in found.items()} == {"inner": 2, "outer": 1}
    assert found["inner"][1] >= 99_000
    assert found["outer"][1] >= 19_000
    assert found["outer"][1] + found["inner"][1] >= 119_000
    watches.restart()
    assert watches.found() == {}


def test_cost_of_the_stopwatches_is_taken_off() -> None:
    watches = Stopwatches(count(step=40).__next__)  # each look at the clock takes 40 ns, and nothing else takes time
    nothing = watches.timed(lambda: None, "nothing")

    def call_it() -> None:
        for _ in range(1000):
            nothing()

    watches.timed(call_it, "caller")()
    found = watches.found()
    assert {name: calls for name, (calls, _) in found.items()} == {"nothing": 1000, "caller": 1}
    assert [took for _, took in found.values()] == pytest.approx([0.0, 0.0], abs=0.2)


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
    result = filled(page, results)
    assert result.startswith(
        "Text.\n<!-- machine -->\n2 cores (P), Linux 6, Python 3, r, kernels compiled.\n<!-- end -->\n"
    )
    assert "| graph | 150 | 150 | 150 | 150 | 0 of 1000 | 0.50 | 100 |\n" in result
    assert result.endswith("<!-- growth -->\nold\n<!-- end -->\n")
    assert filled(result, results) == result
    with pytest.raises(ParameterError, match="'<!-- grpah -->' is no place"):
        filled("<!-- grpah -->\n<!-- end -->\n", results)


def test_every_place_of_the_page_is_known() -> None:
    assert PLACE.findall((ROOT / "docs/performance.md").read_text()) == [
        "machine",
        "graph",
        "alone",
        "waiting",
        "layouts",
        "profile",
        "growth",
        "single",
    ]


@pytest.mark.timeout(300)
def test_small_run_gives_all_figures(tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    said = bench(output, "--only", "graph,kernel,offline", "--profile", "--layout", "drivers_apart")
    results = json.loads(output.read_text())
    assert results["machine"]["cores"] >= 1
    check_graph(results)
    check_rest(results)
    for text in ("2x200 Hz: from a scan's stamp", "floor: nothing computed", "us a tick", "estimator, scan by scan"):
        assert text in said


def started(output: Path, *options: str) -> subprocess.Popen[str]:
    """Start the program as make does."""
    command = [sys.executable, "-m", "tests.benchmarks.bench", "--output", str(output), *options]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def bench(output: Path, *options: str) -> str:
    """Run the program in so small a measure that it takes a few seconds; return what it printed."""
    program = started(output, "--quick", "--joints", "2", "--rate", "200", "--seconds", "1", *options)
    try:
        printed, complaints = program.communicate()
    except BaseException:
        program.send_signal(signal.SIGINT)  # it ends what it has started
        program.communicate()
        raise
    assert (program.returncode, complaints) == (0, "")
    return printed


def check_graph(results: dict[str, Any]) -> None:
    """Check what graph and floor are told to be, drivers and other nodes in a process each."""
    for told in (results["graph_2x200"], results["floor_2x200"]):
        assert 200 <= told["expected"] < 400
        assert told["lost"] == told["expected"] - told["received"] == told["not_received"] + told["not_published"]
        assert 0 < told["p50_us"] <= told["p99_us"] <= told["p999_us"] <= told["max_us"]
        assert 0 < told["published_p50_us"] < told["p50_us"]
        assert told["cpu_cores"] == pytest.approx(sum(part["cpu_cores"] for part in told["processes"].values()))
        assert told["memory_mb"] > 0
        assert list(told["processes"]) == ["nodes", "drivers"]
    for told in results["alone"].values():
        assert 200 <= told["expected"] < 400
        assert 0 <= told["missed"] <= told["expected"]
        assert 0 <= told["p50_us"] <= told["p99_us"] <= told["max_us"]
        assert told["stolen_s"] >= 0
    for share in ("p50", "p99"):
        expected = results["graph_2x200"][f"{share}_us"] / results["floor_2x200"][f"{share}_us"]
        assert results[f"ratio_{share}"] == expected


def check_rest(results: dict[str, Any]) -> None:
    """Check what a tick is made of, all nodes in one process, and what needs no graph."""
    stages = results["profile"]["stages"]
    assert stages["publish RawScan"]["calls"] == pytest.approx(2.0, abs=1.0)
    assert all(stages[name]["us"] > 0 for name in ("posor_node: locate", "chain_node: endpoint", "publish PoseStamped"))
    assert results["profile"]["last_scan_to_pose_us"]["p50"] > 0
    assert 0 < results["kernel_us"] < results["scan_us"]
    assert results["offline_scans_per_s"] > 0
    assert results["plain_loop_scans_per_s"] > 0
    assert results["offline_memory_mb"] > 0


def test_interrupted_run_leaves_nothing_behind(tmp_path: Path) -> None:
    program = started(tmp_path / "bench.json", "--joints", "1", "--only", "layouts")
    logs = tmp_path / "bench/runs/01_graph_composed_1x2000"
    deadline = monotonic() + 100.0
    while not (logs / "receiver.log").is_file() or "listening" not in (logs / "receiver.log").read_text():
        assert monotonic() < deadline
        assert program.poll() is None
        sleep(0.05)
    program.send_signal(signal.SIGINT)
    _, complaints = program.communicate()
    assert program.returncode == 1
    assert complaints == "make bench: interrupted.\n"
    left = [path for path in Path("/proc").glob("[0-9]*/cmdline") if str(tmp_path).encode() in path.read_bytes()]
    assert not left
    assert (tmp_path / "bench.json").read_text() == ""
