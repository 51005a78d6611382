"""make bench: it measures what it says, its accounts add up, what cannot be is refused. No figure is judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_drivers.simulator.ticks import stamp_of
from posor_estimator.errors import ParameterError, PosorError

from tests.benchmarks.accounts import COUNTERS, NothingReceived, Run, Window, account, figures
from tests.benchmarks.bench import ROOT, main, parse
from tests.benchmarks.growth import figure, line, series

if TYPE_CHECKING:
    from pathlib import Path

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
    ("arguments", "said"),
    [
        (["--joints", "0"], "make bench: --joints 0; expected 1 to 16."),
        (["--joints", "17"], "make bench: --joints 17; expected 1 to 16."),
        (["--rate", "20000"], "make bench: --rate 20000; expected 1 to 10000."),
        (["--seconds", "0.1"], "make bench: --seconds 0.1; expected 1 to 3600."),
        (["--seconds", "nan"], "make bench: --seconds nan; expected 1 to 3600."),
        (["--layout", "none"], "argument --layout: invalid choice: 'none'"),
        (["--only", "graph,nothing"], "argument --only: 'nothing' is no section; expected some of graph, layouts"),
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


def test_small_run_gives_all_figures(tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    arguments = ["--quick", "--joints", "2", "--rate", "200", "--seconds", "1", "--only", "graph,layouts,kernel"]
    command = [sys.executable, "-m", "tests.benchmarks.bench", *arguments, "--output", str(output)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    results = json.loads(output.read_text())
    assert {"machine", "graph_2x200", "floor_2x200", "ratio_p50", "ratio_p99", "layouts", "kernel_us"} <= set(results)
    assert list(results["layouts"]) == ["composed", "drivers_apart", "separate"]
    runs = [results["graph_2x200"], results["floor_2x200"], *results["layouts"].values()]
    for told in runs:
        assert 200 <= told["expected"] < 400
        assert told["lost"] == told["expected"] - told["received"] == told["not_received"] + told["not_published"]
        assert 0 < told["p50_us"] <= told["p99_us"] <= told["p999_us"] <= told["max_us"]
        assert 0 < told["published_p50_us"] < told["p50_us"]
        assert told["cpu_cores"] == pytest.approx(sum(part["cpu_cores"] for part in told["processes"].values()))
        assert told["memory_mb"] > 0
    assert [len(told["processes"]) for told in runs] == [1, 1, 1, 2, 5]
    assert results["ratio_p50"] == results["graph_2x200"]["p50_us"] / results["floor_2x200"]["p50_us"]
    assert 0 < results["kernel_us"] <= results["scan_us"]
    for text in ("2x200: from the stamp", "floor: same messages", "one process for each node", "kernel_us"):
        assert text in done.stdout
