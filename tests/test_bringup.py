# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""bringup with real nodes: their end, a killed node, a node that refuses, recorded scans, wrong options."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from posor_bringup.bringup import main
from posor_lab.harness.graph import BEST_EFFORT, Graph
from posor_lab.harness.program import Program, installed
from posor_lab.replay_1985.comparison import STEPS
from posor_msgs.msg import RawScan

from tests.composed_rig import filled

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(filled("rig_arm.yaml"), encoding="utf-8")
    return path


@pytest.fixture
def pids() -> Iterator[list[int]]:
    """Return a list for processes that must have ended after the test."""
    numbers: list[int] = []
    yield numbers
    assert numbers
    left = [number for number in numbers if Path(f"/proc/{number}").exists()]
    for number in left:
        os.kill(number, signal.SIGKILL)
    assert left == []


def start(tmp_path: Path, *arguments: object) -> Program:
    return Program([*installed("posor_bringup", "bringup"), *map(str, arguments), "--output", str(tmp_path / "out")])


def processes(program: Program, count: int) -> dict[str, int]:
    assert f" {count} nodes started, " in program.wait_for_line("nodes started")
    found = (re.fullmatch(r"(\S+): process (\d+)", line) for line in program.stdout)
    return {match[1]: int(match[2]) for match in found if match}


@pytest.mark.long
def test_all_nodes_end_on_sigterm(tmp_path: Path, rig: Path, pids: list[int]) -> None:
    with start(tmp_path, rig, "--no-driver") as program, Graph() as graph:
        started = processes(program, 2)
        assert list(started) == ["chain_node", "joint1/posor_node"]
        pids += started.values()
        graph.watch_diagnostics()
        for name in started:
            graph.wait_for_status(f"/rig/{name}: lifecycle", "active")
        assert program.end(signal.SIGTERM) == 0
        assert program.stdout[-1] == "rig: all nodes have ended"
        assert program.stderr == []
    assert sorted(path.name for path in (tmp_path / "out" / "rig" / "logs").iterdir()) == [
        "chain_node.log",
        "joint1.posor_node.log",
    ]


def test_killed_node_is_named_and_the_others_end(tmp_path: Path, rig: Path, pids: list[int]) -> None:
    with start(tmp_path, rig, "--no-driver") as program, Graph() as graph:
        started = processes(program, 2)
        pids += started.values()
        graph.watch_diagnostics()
        for name in started:
            graph.wait_for_status(f"/rig/{name}: lifecycle", "active")
        os.kill(started["joint1/posor_node"], signal.SIGKILL)
        assert program.wait() == 1
        (sentence,) = program.stderr
        assert sentence.startswith("joint1/posor_node: was ended by SIGKILL; log: ")


@pytest.mark.long
def test_arm_with_recorded_scans_plays_them_to_the_end(tmp_path: Path, rig: Path, pids: list[int]) -> None:
    with Graph() as graph:
        poses = graph.collect(PoseStamped, "/rig/endpoint/pose")
        with start(tmp_path, rig, "-p", "wait_for_subscribers:=2") as program:
            pids += processes(program, 3).values()
            graph.watch_diagnostics()
            graph.wait_for_status("/rig/chain_node: listeners", "endpoint/pose 1")
            graph.wait_for_status("/rig/joint1/posor_node: listeners", "transform 1")
            scans = graph.collect(RawScan, "/rig/joint1/raw", BEST_EFFORT)  # the driver waits for two
            # Sensor topics are best effort: a busy host may lose scans.
            graph.wait_until(lambda: bool(scans and poses), "scans and poses")
            program.wait_for_line("joint1/driver_node: has ended; all scans are played, or it was stopped")
            assert len(poses) <= STEPS["ymo"]
            assert {pose.header.frame_id for pose in poses} == {"machining_centre"}
            assert not program.ended
            assert program.end(signal.SIGINT) == 0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["six_fingers"],
            r"arm 'six_fingers': no such arm; expected the path of an arm file, or one of .*five_axis.*\.",
        ),
        ([], r"bringup: the following arguments are required: ARM; expected .* 'posor bringup --help' lists them\."),
        (["five_axis", "-p", "rate=2"], r"bringup: argument -p: 'rate=2' is not a parameter, name:=value; expected .*"),
        (
            ["five_axis", "-p", "bag.speed:=2.0"],
            r"option -p bag\.speed: node driver_node, parameter 'bag\.speed': .*\.",
        ),
        (["five_axis", "-p", "a:={b: c}"], r"bringup: argument -p: 'a:=\{b: c\}' is not a parameter, .*\."),
    ],
)
def test_wrong_option_is_refused_with_one_sentence(
    tmp_path: Path, arguments: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["bringup", *arguments, "--output", str(tmp_path / "out")]) == 2
    printed, error = capfd.readouterr()
    assert printed == ""
    assert re.fullmatch(sentence + "\n", error)
    assert not (tmp_path / "out").exists()
