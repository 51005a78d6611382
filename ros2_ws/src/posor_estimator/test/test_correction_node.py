# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""correction_node between a planner and a robot whose joints are beyond their encoders, over DDS."""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration, Time
from posor.chain.arm_file import load_arm_file
from posor.correction.joint_path import JointPath
from posor.correction.nominal_robot import NominalRobot
from posor.numerics.array_types import FloatArray
from posor.numerics.stamps import NS
from posor_estimator.correction_node import Plan, PlanPace
from posor_estimator.trajectory_action import ACTION, REPLACED, TrajectoryAction
from posor_lab.harness.graph import LOSSLESS, Graph, values_of
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import EndpointState
from posor_ros.qos import RELIABLE_QOS
from posor_ros.ros_arguments import ros_arguments
from rclpy.action.client import ActionClient
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = pytest.mark.usefixtures("ros_domain")

ARM = load_arm_file("six_axis")
START = np.array([0.3, -0.6, 0.9, 0.4, 0.7, 0.5])  # not singular
WRONG = 1e-4 * np.array([3.0, -2.0, 4.0, 5.0, -1.0, 2.0])  # errors of the joints [rad]
STATUS = "/correction_node: correction"
SPEED = 0.05  # [rad/s]
SLOW_S = 60.0
STILL_S = 0.3
FAR = 2e-3  # more than offsets [rad]


class Robot:
    """A robot that is where it was commanded, and its planner; the endpoint is where its joints really are."""

    def __init__(self, graph: Graph, node: Program) -> None:
        self.graph, self.node, self.nominal = graph, node, NominalRobot(ARM.chain())
        graph.watch_diagnostics()
        self.commands: list[tuple[float, FloatArray]] = []
        graph.node.create_subscription(JointTrajectory, "trajectory/corrected", self._on_command, RELIABLE_QOS)
        self.planner = graph.publisher(JointTrajectory, "trajectory", RELIABLE_QOS)
        self.states = graph.publisher(EndpointState, "endpoint/state", RELIABLE_QOS)
        self.encoders = graph.publisher(JointState, "encoders", RELIABLE_QOS)
        self.angles = self.read = START  # where its motors are, and what their encoders read
        self.readings: deque[tuple[int, FloatArray]] = deque()  # that are still on their way
        self.reset()

    def reset(self) -> None:
        """End all faults."""
        self.state: dict[str, Any] = {
            "state": EndpointState.STATE_OK,
            "identity": "a" * 64,
            "child_frame_id": ARM.endpoint_frame,
        }
        self.moved = np.zeros(3)  # what the POSORs see beyond the truth
        self.frozen, self.reads, self.stamp_ns = False, True, lambda now_ns: now_ns
        self.late_ns = 0  # time that a reading of the encoders needs to the node

    def _on_command(self, message: Any) -> None:
        self.angles = np.array(message.points[0].positions)
        self.commands.append((time.monotonic(), self.angles))

    def report(self) -> None:
        """Publish encoders and endpoint."""
        now_ns = time.time_ns()
        self.read = self.read if self.frozen else self.angles
        self.readings.append((now_ns, self.read))
        read_ns, angles = self.readings[0]
        while now_ns - self.readings[0][0] >= max(self.late_ns, 1):
            read_ns, angles = self.readings.popleft()
        read = JointState(name=list(self.nominal.joints), position=angles.tolist())
        pose = self.nominal.endpoint(self.angles + WRONG)
        state = EndpointState(**self.state)
        state.header.frame_id = self.nominal.base_frame
        x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pin.SE3(pose.rotation, pose.translation + self.moved)).tolist()
        state.pose.position.x, state.pose.position.y, state.pose.position.z = x, y, z
        state.pose.orientation.x, state.pose.orientation.y = qx, qy
        state.pose.orientation.z, state.pose.orientation.w = qz, qw
        for message, publisher, stamp_ns in (
            (read, self.encoders, read_ns),
            (state, self.states, self.stamp_ns(now_ns)),
        )[not self.reads :]:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
            publisher.publish(message)

    def plan(self, *rows: FloatArray, duration_s: float = SLOW_S, **fields: Any) -> None:
        """Send a trajectory through some angles."""
        message = JointTrajectory(**{"joint_names": list(self.nominal.joints), **fields})
        for n, row in enumerate(rows):
            point = JointTrajectoryPoint(positions=row.tolist())
            point.time_from_start.sec = round(n * duration_s / max(1, len(rows) - 1))
            message.points.append(point)
        self.planner.publish(message)

    def run_until(self, condition: Callable[[], bool], what: str) -> None:
        """Report until a condition holds; plan again where a busy host has not sent an endpoint in time."""

        def report_and_plan() -> None:
            self.report()
            if self.statuses(b"\x01", b"\x02"):
                self.graph.diagnostics.clear()
                here = self.angles if np.abs(self.angles - self.rows[0]).max() > FAR else self.rows[0]
                self.plan(*(row + here - self.rows[0] for row in self.rows))

        self.graph.wait_until(condition, what, report_and_plan)

    def follow(self, *rows: FloatArray) -> None:
        """Begin a new plan where the robot stands, and run it until its offsets are there."""
        self.commands.clear()
        self.graph.diagnostics.clear()
        self.rows = rows
        self.plan(*rows)
        self.run_until(lambda: bool(self.commands), "a command")

    def distance(self, angles: FloatArray) -> float:
        """Return the largest distance of a joint from some angles [rad]."""
        return float(np.abs(self.angles - angles).max())

    def statuses(self, *levels: bytes) -> list[Any]:
        """Return the received statuses of the correction with some levels."""
        return [each for each in self.graph.diagnostics if each.name == STATUS and each.level in levels]

    def wait_for_level(self, level: bytes, report: Callable[[], None] | None = None) -> Any:
        """Return the next status of the correction with a level."""
        self.graph.diagnostics.clear()
        self.graph.wait_until(lambda: bool(self.statuses(level)), f"level {level!r}", report or self.report)
        return self.statuses(level)[0]

    def wait_until_sound(self) -> Any:
        """Return the next status of a correction that goes on."""
        self.graph.diagnostics.clear()
        self.run_until(lambda: bool(self.statuses(b"\x00")), "a sound status")
        return self.statuses(b"\x00")[0]

    def wait_for_standstill(self) -> float:
        """Return when the last command came (steady clock) [s]; there is no other for ``STILL_S``."""
        still = lambda: time.monotonic() - self.commands[-1][0] > STILL_S  # noqa: E731
        self.graph.wait_until(still, "standstill", self.report)
        return self.commands[-1][0]


def correction_node(name: str, on_stop: str, **others: Any) -> Program:
    """Start a correction_node of a name."""
    parameters = {"urdf": str(ARM.urdf), "endpoint_frame": ARM.endpoint_frame, "on_stop": on_stop, **others}
    return Program([*installed("posor_estimator", "correction_node"), *ros_arguments(parameters, name=name)])


@contextmanager
def running_node(on_stop: str, **others: Any) -> Iterator[Robot]:
    """Run a correction_node and its robot."""
    with correction_node("correction_node", on_stop, **others) as node, Graph() as graph:
        yield Robot(graph, node)
        assert node.end() == 0


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with running_node("stop") as robot:
        yield robot


def position_error(robot: Robot) -> float:
    """Return the distance of the true endpoint from the plan, while it stands at START [m]."""
    true = robot.nominal.endpoint(robot.angles + WRONG).translation
    return float(np.linalg.norm(true - robot.nominal.endpoint(START).translation))


@pytest.mark.parametrize("late_s", [0.0, 0.03])
def test_the_endpoint_comes_onto_the_plan_though_encoders_are_later_than_scans(robot: Robot, late_s: float) -> None:
    robot.reset()
    robot.late_ns = round(late_s * NS)
    robot.angles = robot.read = START
    uncorrected = position_error(robot)
    robot.follow(START, START)
    robot.run_until(lambda: position_error(robot) < 0.05 * uncorrected, "the corrected endpoint")
    assert robot.wait_until_sound().message == "following"


@pytest.mark.parametrize("step_s", [0.004, 0.03, 0.25])
def test_a_plan_slows_down_on_the_same_path_however_late_its_commands_are(step_s: float) -> None:
    plan = Plan(JointPath(("only",), np.array([0.0, 10.0]), np.array([[0.0], [10.0]])), 0)
    plan.advance(1.0)
    while plan.speed > 0.0:
        plan.advance(step_s, slowing_s=0.1)
    assert plan.angles() == pytest.approx(1.05, abs=1e-12)


def test_no_point_asks_for_more_than_a_period_and_delays_beyond_it_make_the_plan_late() -> None:
    random, period_s, begin_s = np.random.default_rng(3), 0.004, 5.0
    ticks_s = begin_s + period_s * np.arange(1000) + random.uniform(0.0, 0.99 * period_s, 1000)
    pace = PlanPace(period_s, begin_s)
    steps_s = np.array([pace.advance(now_s) for now_s in ticks_s])
    assert pace.late_s == pytest.approx(0.0, abs=1e-12)  # jitter is made up for
    steps_s = np.append(steps_s, [pace.advance(now_s + 0.085) for now_s in ticks_s + 1000 * period_s])  # a pause
    assert steps_s.min() >= 0.0
    assert steps_s.max() <= period_s * (1.0 + 1e-9)
    assert pace.late_s == pytest.approx(0.085, abs=2.0 * period_s)
    elapsed_s = ticks_s[-1] + 1000 * period_s + 0.085 - begin_s
    assert steps_s.sum() + pace.late_s == pytest.approx(elapsed_s, abs=period_s)


def test_a_paused_process_makes_the_plan_late_and_the_robot_does_not_jump() -> None:
    """The step of a point is 0.2 mrad; the robot would have moved by 15 mrad during the pause."""
    with running_node("hold", **{"offsets.max_age": 1.0}) as robot:
        points = robot.graph.collect(JointTrajectory, "trajectory/corrected", LOSSLESS)
        robot.follow(START, START + SPEED * SLOW_S * np.eye(6)[0])
        robot.run_until(lambda: robot.distance(START) > FAR, "motion")
        robot.node.process.send_signal(signal.SIGSTOP)
        robot.wait_for_standstill()
        last = len(points) - 1
        robot.node.process.send_signal(signal.SIGCONT)

        def late_s() -> float:
            own = [values_of(each) for each in robot.graph.diagnostics if each.name == STATUS]
            return max((float(each.get("plan_late [s]", 0.0)) for each in own), default=0.0)

        robot.graph.wait_until(lambda: late_s() > 0.9 * STILL_S, "the delay in the diagnostics", robot.report)
        robot.graph.wait_until(lambda: len(points) > last + 5, "points after the pause", robot.report)
        steps = np.abs(np.diff([each.points[0].positions[0] for each in points[last:]]))
        assert steps.max() < FAR


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "lost": ({"state": EndpointState.STATE_LOST, "reason": "elbow is lost"}, ": elbow is lost"),
    "degraded": ({"state": EndpointState.STATE_DEGRADED, "reason": "degraded: elbow"}, ": degraded: elbow"),
    "changed arm": ({"identity": "b" * 64}, "the arm has changed: identity aaaaaaaa became bbbbbbbb"),
    "uncertain": ({"covariance_random": np.eye(6).ravel() * 1e-6}, "uncertain by 0.001 m; expected at most 0.0001 m"),
    "other frame": ({"child_frame_id": "tool"}, "that of tool in base; expected endpoint in base"),
    "no endpoint": ({}, "no usable endpoint for 0."),
    "no encoders": ({}, ": no angles on encoders as new as the endpoint"),
    "frozen encoders": ({}, "needs an offset of "),
    "moved endpoint": ({}, "needs an offset of "),
    "old endpoint": ({}, " s old; expected at most 0.1 s"),
    "repeated stamp": ({}, "no usable endpoint for 0."),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("max_s", [5.0, pytest.param(0.35, marks=pytest.mark.long)])
def test_a_fault_in_motion_stops_the_robot_on_its_path(robot: Robot, fault: str, max_s: float) -> None:
    """On a quiet machine the offsets stand after 0.1 s, and the robot 0.1 s later."""
    robot.reset()
    begin = robot.angles
    robot.follow(begin, begin + SPEED * SLOW_S * np.eye(6)[0])
    robot.run_until(lambda: robot.distance(begin) > 0.005, "motion")
    begin_s, (change, text) = time.monotonic(), FAULTS[fault]
    robot.state = {**robot.state, **change}
    robot.reads = fault != "no encoders"
    robot.frozen = fault == "frozen encoders"
    robot.moved = np.array([0.0, 0.02, 0.0]) * (fault == "moved endpoint")
    last_ns = time.time_ns()
    stamps: dict[str, Callable[[int], int]] = {
        "old endpoint": lambda now_ns: now_ns - NS // 5,
        "repeated stamp": lambda _: last_ns,
    }
    robot.stamp_ns = stamps.get(fault, robot.stamp_ns)
    status = robot.wait_for_level(b"\x02", lambda: None if fault == "no endpoint" else robot.report())
    assert status.message.startswith("stopped, the robot slows down and stands: ")
    assert text in status.message
    robot.reset()
    arrivals = robot.wait_for_standstill()
    print(f"{fault}: the robot stood after {arrivals - begin_s:.2f} s")
    assert arrivals - begin_s < max_s
    last_s, last = robot.commands[-1]
    speeds = [np.abs(last - row).max() / (last_s - arrived_s) for arrived_s, row in robot.commands[-12:-6]]
    assert min(speeds) < 0.5 * SPEED  # it has slowed down; late commands make single speeds too large


def test_a_robot_that_may_go_on_keeps_its_offsets() -> None:
    with running_node("hold") as robot:
        robot.follow(START, START)
        robot.run_until(lambda: robot.distance(START) > 1e-4, "offsets")
        assert robot.wait_for_level(b"\x02", lambda: None).message.startswith("stopped, the offsets stay: ")
        count = len(robot.commands)
        robot.graph.wait_until(lambda: len(robot.commands) > count + 50, "more commands", robot.report)
        assert robot.distance(START) > 1e-4
        assert robot.distance(robot.commands[-20][1]) == 0.0


def test_a_second_node_that_commands_the_robot_stops_the_first_and_no_trajectory_begins() -> None:
    fault = "2 publishers on /trajectory/corrected; expected one"
    with running_node("hold", **{"offsets.max_age": 1.0}) as robot:  # the start of the second node delays the first
        robot.follow(START, START + SPEED * SLOW_S * np.eye(6)[0])
        robot.run_until(lambda: robot.distance(START) > FAR, "motion")
        with correction_node("second", "hold") as second:
            stopped = robot.wait_for_level(b"\x02")
            assert stopped.message == f"stopped, the robot slows down and stands: {fault}"
            robot.wait_for_standstill()
            robot.graph.wait_for_status("/second: input", fault)
            subscribed = lambda: robot.planner.get_subscription_count() == 2  # noqa: E731
            robot.graph.wait_until(subscribed, "the second node", robot.report)
            count = len(robot.commands)
            robot.plan(robot.angles, robot.angles)
            for node in (second, robot.node):
                node.wait_for_line(f"trajectory refused: {fault}")
            assert len(robot.commands) == count
            assert second.end() == 0
        robot.follow(robot.angles, robot.angles)
        assert robot.wait_until_sound().message == "following"


def test_a_clock_that_goes_back_stops_a_plan_that_has_begun() -> None:
    with running_node("stop", use_sim_time=True) as robot:
        clock = robot.graph.publisher(Clock, "/clock", RELIABLE_QOS)
        back_ns, report = [0], robot.report
        robot.stamp_ns = lambda now_ns: now_ns - back_ns[0]

        def report_by_the_clock() -> None:
            clock.publish(Clock(clock=Time(sec=(now_ns := time.time_ns() - back_ns[0]) // NS, nanosec=now_ns % NS)))
            report()

        robot.report = report_by_the_clock  # type: ignore[method-assign]
        robot.follow(START, START + SPEED * SLOW_S)
        robot.run_until(lambda: robot.distance(START) > FAR, "motion")
        back_ns[0] = 3600 * NS
        before = robot.angles
        robot.reads = False  # an endpoint of before comes no more
        assert robot.wait_for_level(b"\x02").message.startswith("stopped, the robot slows down and stands: ")
        robot.wait_for_standstill()
        assert robot.distance(before) > 0.0


def test_trajectories_that_cannot_be_corrected_are_refused(robot: Robot) -> None:
    robot.reset()
    robot.follow(robot.angles, robot.angles)
    before = int(values_of(robot.wait_until_sound())["trajectories_refused"])
    here, names = robot.angles, list(robot.nominal.joints)
    for rows, fields in (
        ((here + 0.1, here), {}),
        ((here, here), {"joint_names": [*names[1:], "knee"]}),
        ((here[1:], here[1:]), {}),
        ((here, here), {"duration_s": 0.0}),
        ((np.full(6, np.nan), here), {}),
        ((), {"points": [JointTrajectoryPoint(positions=here.tolist(), time_from_start=Duration(sec=-5))]}),
        ((here,), {"points": [JointTrajectoryPoint(positions=here.tolist(), velocities=[0.0] * 6)]}),
        ((here, here), {"header": Header(stamp=Time(sec=int(time.time()) + 5))}),  # while the robot moves
    ):
        robot.plan(*rows, **fields)

    def refused() -> int:
        own = [values_of(each) for each in robot.graph.diagnostics if each.name == STATUS]
        return max((int(each.get("trajectories_refused", 0)) for each in own), default=0)

    robot.run_until(lambda: refused() >= before + 8, "8 refused trajectories")
    count = len(robot.commands)
    robot.run_until(lambda: len(robot.commands) > count, "a command of the first trajectory")
    robot.planner.publish(JointTrajectory())
    assert robot.wait_for_level(b"\x00").message == "the planner has ended its trajectory"
    robot.wait_for_standstill()


def test_a_trajectory_that_is_ended_before_it_begins_does_not_move_the_robot(robot: Robot) -> None:
    robot.reset()
    robot.follow(robot.angles, robot.angles)
    robot.planner.publish(JointTrajectory())
    robot.wait_for_standstill()
    robot.commands.clear()
    robot.graph.diagnostics.clear()
    soon = Header(stamp=Time(sec=int(time.time()) + 3))
    robot.plan(robot.angles, robot.angles + SPEED * SLOW_S * np.eye(6)[0], header=soon)
    begins = lambda: any(each.message.startswith("begins in") for each in robot.graph.diagnostics)  # noqa: E731
    robot.graph.wait_until(begins, "the plan", robot.report)
    robot.planner.publish(JointTrajectory())
    robot.graph.wait_until(lambda: time.time() > soon.stamp.sec + 0.1, "its begin", robot.report)
    assert not robot.commands
    assert robot.wait_for_level(b"\x00").message == "the planner has ended its trajectory"


class Goal:
    """A goal of the action that a planner sends, and what becomes of the goal."""

    def __init__(self, client: Any, robot: Robot, angles: FloatArray, seconds: int, **fields: Any) -> None:
        self._type = import_module("control_msgs.action").FollowJointTrajectory
        goal = self._type.Goal(**fields)
        goal.trajectory.joint_names = list(robot.nominal.joints)
        goal.trajectory.points = [JointTrajectoryPoint(positions=each.tolist()) for each in (robot.angles, angles)]
        goal.trajectory.points[-1].time_from_start.sec = seconds
        self.feedback: list[Any] = []
        sent = client.send_goal_async(goal, feedback_callback=lambda each: self.feedback.append(each.feedback))
        robot.graph.wait_until(sent.done, "the answer to a goal", robot.report)
        self.handle = sent.result()
        self._robot = robot

    def result(self) -> Any:
        """Return status and result when the goal has ended."""
        future = self.handle.get_result_async()
        self._robot.graph.wait_until(future.done, "the result", self._robot.report)
        return future.result()


@pytest.mark.skipif(not TrajectoryAction.is_installed(), reason="control_msgs is not installed")
def test_goals_of_the_action_succeed_are_cancelled_stopped_and_refused(robot: Robot) -> None:
    robot.reset()
    kind = import_module("control_msgs.action").FollowJointTrajectory
    client = ActionClient(robot.graph.node, kind, ACTION)
    robot.graph.wait_until(client.server_is_ready, "the action server", robot.report)
    target = robot.angles + 0.01
    goal = Goal(client, robot, target, 1)
    found = goal.result()
    assert (found.status, found.result.error_code) == (GoalStatus.STATUS_SUCCEEDED, kind.Result.SUCCESSFUL)
    assert robot.distance(target) < FAR
    assert goal.feedback[-1].joint_names == list(robot.nominal.joints)
    np.testing.assert_allclose(goal.feedback[-1].error.positions, 0.0, atol=FAR)

    goal = Goal(client, robot, robot.angles + 1.0, round(SLOW_S))
    cancelled = goal.handle.cancel_goal_async()
    robot.graph.wait_until(cancelled.done, "the answer to the cancellation", robot.report)
    assert goal.result().status == GoalStatus.STATUS_CANCELED
    robot.wait_for_standstill()

    first = Goal(client, robot, robot.angles + 1.0, round(SLOW_S))
    second = Goal(client, robot, robot.angles + 1.0, round(SLOW_S))
    assert first.result().result.error_string == REPLACED
    robot.state = {**robot.state, "state": EndpointState.STATE_LOST, "reason": "elbow is lost"}
    found = second.result()
    assert (found.status, found.result.error_code) == (GoalStatus.STATUS_ABORTED, kind.Result.PATH_TOLERANCE_VIOLATED)
    assert "elbow is lost" in found.result.error_string
    robot.reset()

    tolerance = import_module("control_msgs.msg").JointTolerance(name=robot.nominal.joints[0], position=0.1)
    for angles, fields in ((robot.angles + 1.0, {"goal_tolerance": [tolerance]}), (np.full(6, np.nan), {})):
        assert not Goal(client, robot, angles, round(SLOW_S), **fields).handle.accepted
    client.destroy()
