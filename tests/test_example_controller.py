# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The example controller: its commands, its refusals, and its effect on the simulated five-axis arm."""

from __future__ import annotations

import itertools
import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS, tick_stamp_ns
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.supervisor import Parameter
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.arm_study.arm_record import Dropouts
from posor_lab.harness.graph import LOSSLESS, Graph, values_of, wait_for_value
from posor_lab.harness.message_conversion import is_usable, pose_message, stamp_ns
from posor_lab.harness.program import Program, script
from posor_msgs.msg import JointTransform
from posor_ros.ros_arguments import ros_arguments
from rosgraph_msgs.msg import Clock

pytestmark = pytest.mark.usefixtures("ros_domain")

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "endpoint_controller"
CONTROL = "/arm/endpoint_controller: control"


def controller(namespace: str, **parameters: object) -> Program:
    return Program([*script(EXAMPLE / "endpoint_controller.py"), *ros_arguments(parameters, namespace)])


def status_message(graph: Graph, name: str) -> str:
    return getattr(graph.latest(name), "message", "")


def point_of(message: Any) -> FloatArray:
    return np.array([message.x, message.y, message.z])


# Alone, on the wall clock, with inputs from the test.


@dataclass
class Scan:
    measured: pin.SE3 = field(default_factory=lambda: pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.9])), np.ones(3)))
    target: FloatArray = field(default_factory=lambda: np.array([1.0001, 1.0002, 0.9999]))
    stage: FloatArray = field(default_factory=lambda: np.array([1e-4, -5e-5, 2e-5]))
    sigma: float = 1e-5
    base: str = "base"
    frame: str = "endpoint"
    stamps_ns: tuple[int, int, int] = (0, 0, 0)
    """Of measured pose, target and stage, relative to now."""

    @property
    def wanted(self) -> FloatArray:
        return np.asarray(self.measured.rotation.T @ (self.target - self.measured.translation) + self.stage)


class ControllerInputs:
    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.commands: list[Any] = graph.collect(Vector3Stamped, "/arm/stage/command")
        graph.watch_diagnostics()
        self._measured = graph.publisher(PoseWithCovarianceStamped, "/arm/endpoint/pose_with_covariance")
        self._target = graph.publisher(PoseStamped, "/arm/target/endpoint")
        self._stage = graph.publisher(Vector3Stamped, "/arm/stage/position")
        wait_for_value(graph, "/arm/endpoint_controller: listeners", "stage/command", "1")

    def send(self, scan: Scan, *, measured: bool = True) -> int:
        now_ns = int(self.graph.node.get_clock().now().nanoseconds)
        pose, target, stage = PoseWithCovarianceStamped(), PoseStamped(), Vector3Stamped()
        for message, frame, offset_ns in zip(
            (pose, target, stage), (scan.base, "base", scan.frame), scan.stamps_ns, strict=True
        ):
            message.header.frame_id = frame
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns + offset_ns, NS)
        pose.pose.pose = pose_message(scan.measured)
        pose.pose.covariance = (scan.sigma**2 * np.eye(6)).ravel()
        target.pose = pose_message(pin.SE3(np.eye(3), scan.target))
        stage.vector.x, stage.vector.y, stage.vector.z = scan.stage.tolist()
        self._target.publish(target)
        self._stage.publish(stage)
        if measured:
            self._measured.publish(pose)
        return now_ns

    def wait_for_commands(self, count: int) -> None:
        self.graph.wait_until(lambda: len(self.commands) == count, f"command {count}")

    def status(self, text: str) -> dict[str, str]:
        return values_of(self.graph.wait_for_status(CONTROL, text))


@contextmanager
def running_controller(**parameters: object) -> Iterator[ControllerInputs]:
    with controller("/arm", **parameters) as program, Graph() as graph:
        yield ControllerInputs(graph)
        assert program.end() == 0


def test_command_is_the_position_without_error() -> None:
    scan = Scan()
    with running_controller(time_constant=0.0) as inputs:
        now_ns = inputs.send(scan)
        inputs.status("following")
        inputs.wait_for_commands(1)
        [command] = inputs.commands
        assert (stamp_ns(command), command.header.frame_id) == (now_ns, "endpoint")
        assert point_of(command.vector) == pytest.approx(scan.wanted, abs=1e-15)
        # The command does not depend on the position of the stage: the error falls as the position rises.
        moved = np.array([2e-4, 1e-4, -1e-4])
        there = pin.SE3(scan.measured.rotation, scan.measured.translation + scan.measured.rotation @ moved)
        inputs.send(replace(scan, measured=there, stage=scan.stage + moved))
        inputs.wait_for_commands(2)
        assert point_of(inputs.commands[1].vector) == pytest.approx(scan.wanted, abs=1e-15)


def test_low_pass_uses_the_stamps_and_incomplete_scans_are_not_used() -> None:
    first, then = Scan(), Scan(target=np.array([0.9999, 1.0, 1.0001]))
    with running_controller(time_constant=0.02, max_age=30.0) as inputs:
        stamps = [inputs.send(first)]
        for _ in range(3):
            stamps.append(inputs.send(then))
            inputs.wait_for_commands(len(stamps))
        smooth = first.wanted
        for step_ns, command in zip(np.diff(stamps), inputs.commands[1:], strict=True):
            smooth = smooth + (1.0 - math.exp(-1e-9 * step_ns / 0.02)) * (then.wanted - smooth)
            assert point_of(command.vector) == pytest.approx(smooth, rel=1e-9)
        inputs.send(Scan(stamps_ns=(1, 2, 3)))
        inputs.send(then)
        inputs.wait_for_commands(5)
        assert values_of(wait_for_value(inputs.graph, CONTROL, "commands", "5"))["scans_incomplete"] == "3"


def test_controller_holds_and_reports_the_reason() -> None:
    sound = Scan()
    nowhere = pin.SE3(np.eye(3), np.array([1.0, math.nan, 1.0]))
    late = -2 * NS
    unfit = {
        "no endpoint/pose_with_covariance, no target/endpoint, no stage/position within 1 s": Scan(
            stamps_ns=(late, late, late)
        ),
        "the endpoint is measured in 'base_home', its target is in 'base'": Scan(base="base_home"),
        "the stage moves in 'tool'; expected 'endpoint'": Scan(frame="tool"),
        "a pose or the stage's position is not finite": Scan(measured=nowhere),
        "the endpoint's position is more uncertain than 0.0001 m": Scan(sigma=1.1e-4),
        "the endpoint is further from its target than the stage's 0.0005 m": Scan(target=np.array([1.0006, 1.0, 1.0])),
    }
    with running_controller(time_constant=0.0, max_age=1.0) as inputs:
        for count, (why, scan) in enumerate(unfit.items()):
            inputs.send(scan)
            inputs.status(f"holding: {why}")
            assert len(inputs.commands) == count
            inputs.send(sound)
            inputs.status("following")
            inputs.wait_for_commands(count + 1)
        silent = "holding: no endpoint/pose_with_covariance within 1 s of now"
        inputs.graph.wait_until(
            lambda: silent in status_message(inputs.graph, CONTROL), silent, lambda: inputs.send(sound, measured=False)
        )
        inputs.status(
            "holding: no endpoint/pose_with_covariance, no target/endpoint, no stage/position within 1 s of now"
        )
        assert len(inputs.commands) == len(unfit)


# On the simulated arm, whose clock advances once everything of the last tick has come: the load has no effect.

PARAMETERS: dict[str, Parameter] = {"use_sim_time": True, "lossless": True, "freshness.max_silence": math.inf}
CHAIN_PARAMETERS: dict[str, Parameter] = {"max_wait": 60.0}
TOPICS = {
    "truth/endpoint": PoseStamped,
    "target/endpoint": PoseStamped,
    "stage/position": Vector3Stamped,
    "endpoint/pose": PoseStamped,
    "stage/command": Vector3Stamped,
}
FROM_DRIVER = ("truth/endpoint", "target/endpoint", "stage/position")
AFTER_NS = 3_500_000  # time of the clock after the stamp of a tick: all its scans have been sent, none of the next tick
REPEAT_S = 0.5  # the clock is published again while waiting; its topic is best effort


class SteppedArm:
    """The nodes of an arm, their clock, and the newest message of each topic."""

    def __init__(self, graph: Graph, name: str) -> None:
        """Subscribe; ``with`` starts the nodes."""
        self._arm = load_checked_arm(name)
        self.name = f"/{self._arm.name}"  # namespace of the arm
        self.commanded = False  # whether a command for the stage belongs to every pose
        self._graph = graph
        simulation = ArmSimulation(self._arm)
        self._dropouts = Dropouts(simulation)
        self._rate = simulation.scenario.ticks_per_second
        self._transforms = {joint: f"{joint}/transform" for joint in simulation.joints}
        self._without_pose = False
        kinds = {**TOPICS, **dict.fromkeys(self._transforms.values(), JointTransform)}
        # newest message of each topic below it
        self.newest: dict[str, Any] = {topic: kind() for topic, kind in kinds.items()}
        for topic, kind in kinds.items():
            keep = partial(self.newest.__setitem__, topic)
            graph.node.create_subscription(kind, f"{self.name}/{topic}", keep, LOSSLESS)
        self._stack = ExitStack()
        self._running: dict[str, Program] = {}
        self._clock: Any = None
        self._published = (0, 0.0)

    def __enter__(self) -> Self:
        """Start the nodes and wait for their connections; end them if that fails."""
        with ExitStack() as started:
            for program in arm_programs(self._arm, chain_parameters=CHAIN_PARAMETERS, parameters=PARAMETERS):
                self._running[program.name] = started.enter_context(Program(program.command()))
            self._graph.watch_diagnostics()
            for name in self._running:
                self._graph.wait_for_status(f"{self.name}/{name}: lifecycle", "active")
            self._clock = self._graph.publisher(Clock, "/clock", subscriptions=len(self._running))
            wait_for_value(self._graph, f"{self.name}/chain_node: listeners", "endpoint/pose", "1")
            for joint in self._transforms:
                wait_for_value(self._graph, f"{self.name}/{joint}/posor_node: listeners", "transform", "2")
                self._graph.wait_for_status(f"{self.name}/{joint}/driver_node: source", "running")
            self._stack = started.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def kill_posor_node(self, joint: str) -> None:
        self._running[f"{joint}/posor_node"].process.kill()
        del self._transforms[joint]
        self._without_pose = True

    def begin(self, tick: int) -> int:
        """Set the clock, forward or back, and return the first tick of which everything comes.

        A node that receives the clock late begins with a later tick.
        """
        self._publish_clock(tick - 1)
        for first in itertools.count(tick):
            self._publish_clock(first)
            is_complete = self._condition(first)
            deadline = time.monotonic() + 2.0 * REPEAT_S
            while time.monotonic() < deadline:
                if is_complete():
                    return first
                self._graph.receive()
        raise AssertionError

    def step(self, tick: int) -> None:
        """Advance the clock to a tick and wait until everything of the tick has come."""
        self._publish_clock(tick)
        self._graph.wait_until(self._condition(tick), f"tick {tick}", self._repeat_clock)

    def _publish_clock(self, tick: int) -> None:
        self._published = (tick, time.monotonic())
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(tick_stamp_ns(tick, self._rate) + AFTER_NS, NS)
        self._clock.publish(message)

    def _repeat_clock(self) -> None:
        tick, when = self._published
        if time.monotonic() > when + REPEAT_S:
            self._publish_clock(tick)

    def _condition(self, tick: int) -> Callable[[], bool]:
        """Return a function that checks whether everything of a tick has come."""
        stamp, dropped = tick_stamp_ns(tick, self._rate), self._dropouts.dropped_joints(tick)
        measured = [topic for joint, topic in self._transforms.items() if joint not in dropped]
        whole = not dropped and not self._without_pose
        after = ("endpoint/pose", "stage/command") if self.commanded else ("endpoint/pose",)

        def received(*topics: str) -> bool:
            return all(stamp_ns(self.newest[topic]) == stamp for topic in topics)

        def is_complete() -> bool:
            if not received(*FROM_DRIVER, *measured):
                return False
            return received(*after) or not (whole and all(is_usable(self.newest[topic]) for topic in measured))

        return is_complete


ARM = "five_axis"
FIRST = 6000  # first tick of a cycle of the scenario; the same ticks run without and with the controller
SETTLED, END = FIRST + 40, FIRST + 400  # judged ticks, 0.2 s to 2 s: the arm rests, extended, then swings
README_ROW = re.compile(r"\| first 2 s \| ([\d.]+) um \| ([\d.]+) um \|")


def target_distances(arm: SteppedArm) -> FloatArray:
    """Return the distance of the true endpoint from its target [m] at the judged ticks."""
    began = arm.begin(FIRST)
    assert began <= SETTLED
    found = []
    for tick in range(began + 1, END):
        arm.step(tick)
        if tick >= SETTLED:
            truth, target = (point_of(arm.newest[name].pose.position) for name in ("truth/endpoint", "target/endpoint"))
            found.append(np.linalg.norm(truth - target))
    return np.array(found)


def rms_um(lengths: FloatArray) -> float:
    return 1e6 * float(np.sqrt(np.mean(lengths**2)))


@pytest.mark.long
def test_endpoint_of_the_arm_reaches_its_target() -> None:
    with Graph() as graph, SteppedArm(graph, ARM) as arm:
        before = rms_um(target_distances(arm))
        with controller(arm.name, use_sim_time=True) as program:
            node = f"{arm.name}/endpoint_controller"
            wait_for_value(graph, f"{node}: listeners", "stage/command", "2")
            arm.commanded = True
            after = rms_um(target_distances(arm))
            print(f"endpoint to target, rms: {before:.1f} um without, {after:.2f} um with the controller")
            assert 100.0 < before < 1000.0
            assert after < 12.0
            row = README_ROW.search((EXAMPLE / "README.md").read_text(encoding="utf-8"))
            assert row is not None
            assert [before, after] == pytest.approx([float(row[1]), float(row[2])], rel=0.1)

            arm.commanded = False
            arm.kill_posor_node("elbow")
            ticks = itertools.count(END)
            why = "no endpoint/pose_with_covariance within 0.1 s of now"
            while status_message(graph, f"{node}: control") != f"holding: {why}":
                arm.step(next(ticks))
            program.wait_for_line(f"holding the stage: {why}")
            commands = values_of(graph.latest(f"{node}: control"))["commands"]
            place = point_of(arm.newest["stage/position"].vector)
            assert np.linalg.norm(place) > 1e-4
            for _ in range(20):
                arm.step(next(ticks))
            assert point_of(arm.newest["stage/position"].vector) == pytest.approx(place, abs=0.0)
            assert program.end() == 0
            graph.wait_until(lambda: not graph.node.count_publishers(f"{arm.name}/stage/command"), "the node's end")
            assert values_of(graph.latest(f"{node}: control"))["commands"] == commands
