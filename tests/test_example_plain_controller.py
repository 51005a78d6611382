# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The controller that needs ROS packages only, on the simulated arm: the endpoint at its target, and a stop in time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.supervisor import ProgramCommand
from posor_lab.faults.fault_table import ArmName, write_fault_arm
from posor_lab.harness.graph import Graph
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.harness.program import Program, script
from posor_ros.ros_arguments import ros_arguments

pytestmark = pytest.mark.usefixtures("ros_domain")

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "plain_controller" / "plain_controller.py"
MAX_LINES = 62  # with copyright and licence
ALLOWED = ("signal", "geometry_msgs", "posor_msgs", "rclpy")
ARM: ArmName = "five_axis"
KILLED = "elbow/driver_node"
CYCLE_S, SEED, WAYPOINT_S = 60, 4, 5.0
JUDGED = 100  # poses of the true endpoint before and after, 2 s each
WINDOWS = 10  # a loaded host delays commands, so that single windows are worse
MAX_STOP_S = 0.2
SILENT = "stopped: no message on endpoint/state"


def command_of(program: ProgramCommand) -> Program:
    return Program(program.command())


class Errors:
    """Distances of the true endpoint from its target [m], by stamp."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._truths: list[Any] = graph.collect(PoseStamped, f"/{ARM}/truth/endpoint")
        self._targets: list[Any] = graph.collect(PoseStamped, f"/{ARM}/target/endpoint")

    def next_rms(self) -> float:
        """Return the rms of the next ones."""
        self._truths.clear()
        self._targets.clear()
        self._graph.wait_until(lambda: len(self._truths) > JUDGED and len(self._targets) > JUDGED, "the true endpoint")
        targets = {stamp_ns(target): target.pose.position for target in self._targets}
        pairs = [(t.pose.position, targets[stamp_ns(t)]) for t in self._truths if stamp_ns(t) in targets]
        miss = np.array([[one.x - other.x, one.y - other.y, one.z - other.z] for one, other in pairs])
        return float(np.sqrt(np.mean(np.sum(miss**2, axis=1))))


def test_the_example_is_short_and_needs_ros_packages_only() -> None:
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_LINES
    modules = {line.split()[1].partition(".")[0] for line in lines if line.startswith(("import ", "from "))}
    assert modules == set(ALLOWED)


def test_the_endpoint_reaches_its_target_and_a_killed_driver_stops_the_controller(tmp_path: Path) -> None:
    programs = arm_programs(write_fault_arm(ARM, tmp_path / "arm", CYCLE_S, SEED, waypoint_s=WAYPOINT_S))
    (driver,) = (program for program in programs if program.name == KILLED)
    (others,) = group_programs([program for program in programs if program is not driver], "composed", tmp_path)
    command = [*script(EXAMPLE), *ros_arguments({}, f"/{ARM}")]
    arrivals: list[float] = []
    with command_of(others) as nodes, command_of(driver) as killed, Graph() as graph:
        errors = Errors(graph)
        before = errors.next_rms()
        with Program(command) as controller:
            kept: Any = graph.node.create_subscription(
                Vector3Stamped, f"/{ARM}/stage/command", lambda _: arrivals.append(time.monotonic()), 10
            )
            graph.wait_until(lambda: len(arrivals) > JUDGED, "commands")
            for _ in range(WINDOWS):
                after = errors.next_rms()
                if before > 10.0 * after:
                    break
            print(f"endpoint to target, rms: {1e6 * before:.1f} um without, {1e6 * after:.1f} um with the controller")
            before_stop = len(controller.stderr)  # a loaded host may have kept it without messages for a while
            killed.process.kill()
            killed_s = time.monotonic()

            def reason_found() -> bool:
                return any("stopped: " in line and SILENT not in line for line in controller.stderr[before_stop:])

            graph.wait_until(reason_found, "a stop for what the state says")
            graph.wait_until(lambda: time.monotonic() > killed_s + 5.0 * MAX_STOP_S, "late commands")
            assert kept.topic_name.endswith("stage/command")
            nodes.process.kill()
            before_end = len(controller.stderr)
            graph.wait_until(
                lambda: any(SILENT in line for line in controller.stderr[before_end:]), "the sentence of silence"
            )
            assert controller.end() == 0, controller.stderr
    assert before > 10.0 * after
    assert arrivals[-1] < killed_s + MAX_STOP_S
