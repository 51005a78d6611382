"""Kernels that are not compiled, as after a plain colcon build: the program compiles them before its node is active."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_msgs.msg import JointTransform
from posor_ros.ros_arguments import ros_arguments

from .live_topics import POSOR, ScanSender

pytestmark = pytest.mark.usefixtures("ros_domain")

NODES = [
    [*installed("posor_estimator", "posor_node"), *ros_arguments({**POSOR, **HAND_FED, "lossless": True}, name)]
    for name in ("/joint1", "/joint2")
]
NOT_COMPILED, COMPILED = "kernels are not compiled yet", "kernels compiled in"
LONGEST_S = 5.0


def test_an_interrupt_ends_the_compilation(tmp_path: Path) -> None:
    with Program(NODES[0], {"NUMBA_CACHE_DIR": str(tmp_path)}) as node:
        assert str(tmp_path) in node.wait_for_line(NOT_COMPILED)
        begin_s = time.monotonic()
        assert node.end() == 0
        assert time.monotonic() - begin_s < LONGEST_S
        assert not any(COMPILED in line for line in node.stderr)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_nodes_compile_the_kernels_before_they_are_active(tmp_path: Path) -> None:
    with ExitStack() as stack, Graph() as graph:
        nodes = [stack.enter_context(Program(node, {"NUMBA_CACHE_DIR": str(tmp_path)})) for node in NODES]
        for node in nodes:
            while not any(COMPILED in line for line in node.stderr):
                assert not node.ended, node.stderr
                time.sleep(0.1)
        graph.watch_diagnostics()
        for name in ("/joint1", "/joint2"):
            graph.wait_for_status(f"{name}/posor_node: lifecycle", "active")
            transforms = graph.collect(JointTransform, f"{name}/transform")
            sender = ScanSender(graph, f"{name}/raw")
            sender.send_for(LONGEST_S)
            assert transforms
        (mark,) = tmp_path.glob("*/complete-*")
        marked_ns = mark.stat().st_mtime_ns
        assert not [file for file in tmp_path.rglob("*.nbi") if file.stat().st_mtime_ns > marked_ns]
