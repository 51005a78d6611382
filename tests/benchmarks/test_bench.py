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
from typing import Any

import pytest
from posor_estimator.errors import ParameterError

from tests.benchmarks.bench import ROOT, main, parse
from tests.benchmarks.stopwatch import Stopwatches


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
            "argument --only: 'nothing' is no section; expected some of graph, faults, waiting, layouts",
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


@pytest.mark.timeout(300)
def test_small_run_gives_all_figures(tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    said = bench(output, "--only", "graph,faults,kernel,offline", "--profile", "--layout", "drivers_apart")
    results = json.loads(output.read_text())
    assert results["machine"]["cores"] >= 1
    check_graph(results)
    check_rest(results)
    for text in (
        "2x200 Hz: from a scan's stamp",
        "floor: nothing computed",
        "one scan in 100 of one joint bad",
        "us a tick",
        "estimator, scan by scan",
    ):
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
    faults = results["faults"]
    assert 0 < faults["not_published"] <= faults["lost"] < 0.1 * faults["expected"]
    assert 0 < faults["p50_us"] <= faults["max_us"]
    for share in ("p50", "p99"):
        expected = results["graph_2x200"][f"{share}_us"] / results["floor_2x200"][f"{share}_us"]
        assert results[f"ratio_{share}"] == expected


def check_rest(results: dict[str, Any]) -> None:
    """Check what a tick is made of, all nodes in one process, and what needs no graph."""
    stages = results["profile"]["stages"]
    assert stages["publish RawScan"]["calls"] == pytest.approx(2.0, abs=1.0)
    named = "posor_node: read, locate, write", "chain_node: read the transforms, endpoint", "publish PoseStamped"
    assert all(stages[name]["us"] > 0 for name in named)
    assert results["profile"]["last_scan_to_pose_us"]["p50"] > 0
    assert 0 < results["kernel_us"] < results["scan_us"]
    assert results["offline_scans_per_s"] > 0
    assert results["reading_messages_per_s"] > results["plain_loop_scans_per_s"] > 0
    assert results["offline_scans_per_s"] == max(results["offline_runs_scans_per_s"])
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
