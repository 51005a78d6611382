"""The example controller: what it commands and what it refuses, and what it does for the simulated five-axis arm."""

from __future__ import annotations

import itertools
import math
import re
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor_estimator.ros.messages import pose_message, stamp_ns
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.program import Program, ros_arguments, script
from posor_estimator.testing.stamped import status_with

from tests.stepped_arm import SteppedArm

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_estimator.core.types import FloatArray

pytestmark = pytest.mark.usefixtures("ros_domain")

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "endpoint_controller"
CONTROL = "/arm/endpoint_controller: control"
NS = 1_000_000_000


def controller(namespace: str, **parameters: object) -> Program:
    return Program([*script(EXAMPLE / "endpoint_controller.py"), *ros_arguments(parameters, namespace)])


def says(graph: Graph, name: str) -> str:
    """Return the newest message of a diagnostic status; nothing where there is none."""
    return getattr(graph.latest(name), "message", "")


def point_of(message: Any) -> FloatArray:
    return np.array([message.x, message.y, message.z])


# Alone, on the wall's clock, fed by the test.


@dataclass
class Scan:
    """What one scan tells the controller; as made, all is well."""

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
        """Where the stage should be."""
        return np.asarray(self.measured.rotation.T @ (self.target - self.measured.translation) + self.stage)


class Bench:
    """The controller and the topics that feed it."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.commands: list[Any] = graph.collect(Vector3Stamped, "/arm/stage/command")
        graph.watch_diagnostics()
        self._measured = graph.publisher(PoseWithCovarianceStamped, "/arm/endpoint/pose_with_covariance")
        self._target = graph.publisher(PoseStamped, "/arm/target/endpoint")
        self._stage = graph.publisher(Vector3Stamped, "/arm/stage/position")
        status_with(graph, "/arm/endpoint_controller: listeners", "stage/command", "1")

    def send(self, scan: Scan, *, measured: bool = True) -> int:
        """Publish a scan, with or without what was measured; return what "now" was [ns]."""
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
        """Wait until there are so many commands."""
        self.graph.wait_until(lambda: len(self.commands) == count, f"command {count}")

    def status(self, text: str) -> dict[str, str]:
        return values_of(self.graph.wait_for_status(CONTROL, text))


@contextmanager
def bench(**parameters: object) -> Iterator[Bench]:
    with controller("/arm", **parameters) as program, Graph() as graph:
        yield Bench(graph)
        assert program.end() == 0


def test_the_stage_goes_where_it_should_have_been() -> None:
    scan = Scan()
    with bench(time_constant=0.0) as fed:
        now_ns = fed.send(scan)
        fed.status("following")
        fed.wait_for_commands(1)
        [command] = fed.commands
        assert (stamp_ns(command), command.header.frame_id) == (now_ns, "endpoint")
        assert point_of(command.vector) == pytest.approx(scan.wanted, abs=1e-15)
        # Wherever the stage is, and whenever that was: the error falls as the stage's position rises.
        moved = np.array([2e-4, 1e-4, -1e-4])
        there = pin.SE3(scan.measured.rotation, scan.measured.translation + scan.measured.rotation @ moved)
        fed.send(replace(scan, measured=there, stage=scan.stage + moved))
        fed.wait_for_commands(2)
        assert point_of(fed.commands[1].vector) == pytest.approx(scan.wanted, abs=1e-15)


def test_the_low_pass_goes_by_the_stamps_and_what_is_not_of_one_scan_is_not_put_together() -> None:
    first, then = Scan(), Scan(target=np.array([0.9999, 1.0, 1.0001]))
    with bench(time_constant=0.02, max_age=30.0) as fed:
        stamps = [fed.send(first)]
        for _ in range(3):
            stamps.append(fed.send(then))
            fed.wait_for_commands(len(stamps))
        smooth = first.wanted
        for step_ns, command in zip(np.diff(stamps), fed.commands[1:], strict=True):
            smooth = smooth + (1.0 - math.exp(-1e-9 * step_ns / 0.02)) * (then.wanted - smooth)
            assert point_of(command.vector) == pytest.approx(smooth, rel=1e-9)
        fed.send(Scan(stamps_ns=(1, 2, 3)))
        fed.send(then)
        fed.wait_for_commands(5)
        assert values_of(status_with(fed.graph, CONTROL, "commands", "5"))["scans_incomplete"] == "3"


def test_it_holds_and_says_why() -> None:
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
    with bench(time_constant=0.0, max_age=1.0) as fed:
        for count, (why, scan) in enumerate(unfit.items()):
            fed.send(scan)
            fed.status(f"holding: {why}")
            assert len(fed.commands) == count
            fed.send(sound)
            fed.status("following")
            fed.wait_for_commands(count + 1)
        silent = "holding: no endpoint/pose_with_covariance within 1 s of now"
        fed.graph.wait_until(
            lambda: silent in says(fed.graph, CONTROL), silent, lambda: fed.send(sound, measured=False)
        )
        fed.status("holding: no endpoint/pose_with_covariance, no target/endpoint, no stage/position within 1 s of now")
        assert len(fed.commands) == len(unfit)


# On the arm.

ARM = "five_axis"
FIRST = 6000
"""A tick at which the scenario, of 2000 ticks, begins; the same ticks are run without and with the controller."""
SETTLED, END = FIRST + 40, FIRST + 400
"""Ticks that count, 0.2 s to 2 s: the arm rests, stretched out, then swings."""
README_ROW = re.compile(r"\| first 2 s \| ([\d.]+) um \| ([\d.]+) um \|")


def misses(arm: SteppedArm) -> FloatArray:
    """Return how far the endpoint truly is from its target [m] at the ticks that count."""
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


@pytest.mark.timeout(300)
def test_the_endpoint_of_the_arm_comes_to_its_target() -> None:
    with Graph() as graph, SteppedArm(graph, ARM) as arm:
        before = rms_um(misses(arm))
        with controller(arm.name, use_sim_time=True) as program:
            node = f"{arm.name}/endpoint_controller"
            status_with(graph, f"{node}: listeners", "stage/command", "2")
            arm.commanded = True
            after = rms_um(misses(arm))
            print(f"endpoint to target, rms: {before:.1f} um without, {after:.2f} um with the controller")
            assert 100.0 < before < 1000.0
            assert after < 12.0
            told = README_ROW.search((EXAMPLE / "README.md").read_text(encoding="utf-8"))
            assert told is not None
            assert [before, after] == pytest.approx([float(told[1]), float(told[2])], rel=0.1)

            arm.commanded = False
            arm.pull_plug("elbow")
            ticks = itertools.count(END)
            why = "no endpoint/pose_with_covariance within 0.1 s of now"
            while says(graph, f"{node}: control") != f"holding: {why}":
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
