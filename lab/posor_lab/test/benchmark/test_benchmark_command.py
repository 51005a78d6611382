# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""make bench: all figures are measured and consistent; wrong options are refused. No figure is judged here."""

from __future__ import annotations

import itertools
import json
import math
import signal
import subprocess
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import pytest
from posor.errors import ParameterError
from posor_lab.benchmark.benchmark_command import main, parse_options
from posor_lab.benchmark.benchmark_tables import result_tables
from posor_lab.harness.program import installed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--joints", "0"], "make bench: --joints 0; expected 1 to 16."),
        (["--joints", "17"], "make bench: --joints 17; expected 1 to 16."),
        (["--rate", "20000"], "make bench: --rate 20000; expected 1 to 10000."),
        (["--seconds", "0.1"], "make bench: --seconds 0.1; expected 1 to 3600."),
        (["--seconds", "nan"], "make bench: --seconds nan; expected 1 to 3600."),
        (["--layout", "none"], "argument --layout: invalid choice: 'none'"),
        (
            ["--only", "graph,nothing"],
            "make bench: --only: unknown section 'nothing'; expected some of start, graph, faults, waiting, page",
        ),
        (["--fast"], "unrecognized arguments: --fast"),
    ],
)
def test_wrong_options_are_refused(arguments: list[str], message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        parse_options(arguments)
    assert message in str(caught.value)


def test_output_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert main(["--output", str(tmp_path / "file" / "bench.json")]) == 2
    assert str(tmp_path / "file") in capsys.readouterr().err


@pytest.mark.long
def test_small_run_gives_all_figures(tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    printed = run_benchmark(
        output, "--only", "graph,faults,page,kernel,offline", "--profile", "--layout", "drivers_apart"
    )
    results = json.loads(output.read_text())
    assert results["host"]["cores"] >= 1
    check_graph(results)
    for priority in ("page", "page_priority"):
        check_page(results[priority])
    check_rest(results)
    graph_rows = [row[0] for row in result_tables(results)["graph"].rows]
    faulty = "graph, one scan in 100 of one joint faulty"
    assert graph_rows == ["graph", faulty, "pass-through: nothing computed"]
    # Long cells may be wrapped.
    for text in ("2x200 Hz: from a scan's stamp", "pass-through:", "faulty", "us per tick", "scan by scan"):
        assert text in printed


def start_benchmark(output: Path, *options: str) -> subprocess.Popen[str]:
    command = [*installed("posor_lab", "bench"), "--output", str(output), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run_benchmark(output: Path, *options: str) -> str:
    program = start_benchmark(output, "--quick", "--joints", "2", "--rate", "200", "--seconds", "1", *options)
    try:
        printed, complaints = program.communicate()
    except BaseException:
        program.send_signal(signal.SIGINT)  # it ends what it has started
        program.communicate()
        raise
    assert (program.returncode, complaints) == (0, "")
    return printed


def check_graph(results: dict[str, Any]) -> None:
    """Check the graphs: drivers in one process, all other nodes in another."""
    for graph in (results["graph_2x200"], results["pass_through_2x200"]):
        assert 200 <= graph["expected"] < 400
        assert graph["lost"] == graph["expected"] - graph["received"] == graph["not_received"] + graph["not_published"]
        assert 0 < graph["p50_us"] <= graph["p99_us"] <= graph["p999_us"] <= graph["max_us"]
        assert 0 < graph["published_p50_us"] < graph["p50_us"]
        assert graph["cpu_cores"] == pytest.approx(sum(part["cpu_cores"] for part in graph["processes"].values()))
        assert graph["memory_mb"] > 0
        assert list(graph["processes"]) == ["nodes", "drivers"]
    for loop in results["empty_loop"].values():
        assert 200 <= loop["expected"] < 400
        assert 0 <= loop["missed"] <= loop["expected"]
        assert 0 <= loop["p50_us"] <= loop["p99_us"] <= loop["max_us"]
        assert 0.0 <= loop["stolen_s"] < math.inf
    faults = results["faults"]
    assert 0 < faults["not_published"] <= faults["lost"] < 0.1 * faults["expected"]
    assert 0 < faults["p50_us"] <= faults["max_us"]
    for share in ("p50", "p99"):
        expected = results["graph_2x200"][f"{share}_us"] / results["pass_through_2x200"][f"{share}_us"]
        assert results[f"ratio_{share}"] == expected


def check_page(runs: dict[str, Any]) -> None:
    """Check the graph beside the live page: only a page that is shown is drawn."""
    assert ["view" in run["processes"] for run in runs.values()] == [False, True, True]
    at_rest, shown = (runs[use]["processes"]["view"]["cpu_cores"] for use in ("at rest", "shown"))
    assert 0 < at_rest < shown
    for run, key in itertools.product(runs.values(), ("p99", "published_p99")):
        ratio = pytest.approx(run[f"{key}_us"] / runs["absent"][f"{key}_us"])
        assert run[f"{key}_ratio"] == {"median": ratio, "low": None, "high": None}


def check_rest(results: dict[str, Any]) -> None:
    """Check the profile of a tick and the sections without a graph."""
    started, empty = results["start"]["posor_node"], results["start"]["empty_node"]
    assert all(started[name] > empty[name] > 0 for name in started)
    stages = results["profile"]["stages"]
    assert stages["publish RawScan"]["calls"] == pytest.approx(2.0, abs=1.0)
    named = "posor_node: estimate", "chain_node: read the transforms, endpoint", "publish PoseStamped"
    assert all(stages[name]["us"] > 0 for name in named)
    assert results["profile"]["last_scan_to_pose_us"]["p50"] > 0
    assert 0 < results["kernel_us"] < results["scan_us"]
    assert results["offline_scans_per_s"] > 0
    assert results["reading_messages_per_s"] > results["bulk_loop_scans_per_s"] > 0
    assert results["bulk_loop_scans_per_s"] > results["message_loop_scans_per_s"] > 0
    assert results["offline_scans_per_s"] == max(results["offline_runs_scans_per_s"])
    assert results["offline_memory_mb"] > 0


@pytest.mark.long
def test_interrupted_run_leaves_nothing_behind(tmp_path: Path) -> None:
    program = start_benchmark(tmp_path / "bench.json", "--joints", "1", "--only", "layouts")
    logs = tmp_path / "bench/runs/01_graph_composed_1x2000"
    deadline = monotonic() + 100.0
    while not (logs / "receiver.log").is_file() or "listening" not in (logs / "receiver.log").read_text():
        assert monotonic() < deadline
        assert program.poll() is None
        sleep(0.05)
    program.send_signal(signal.SIGINT)
    _, complaints = program.communicate()
    assert program.returncode == 130
    assert complaints == "make bench: interrupted.\n"
    left = [path for path in Path("/proc").glob("[0-9]*/cmdline") if str(tmp_path).encode() in path.read_bytes()]
    assert not left
    assert (tmp_path / "bench.json").read_text() == ""
