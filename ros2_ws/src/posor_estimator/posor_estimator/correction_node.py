# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""correction_node: between planner and robot, adds joint offsets that bring the measured endpoint onto the plan.

Subscribes to ``trajectory`` (trajectory_msgs/JointTrajectory), ``endpoint/state`` and the robot's ``encoders``
(sensor_msgs/JointState). Publishes ``trajectory/corrected`` at the rate of the robot's interface: one point, due one
period later. Whatever is not OK stops the correction: the offsets stand still, and by ``on_stop`` the robot slows down
on its path and stands, or goes on. Only a new trajectory starts the correction again. Where control_msgs is installed,
trajectories are also goals of the action ``follow_joint_trajectory``.
"""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from posor.chain.kinematic_chain import load_chain
from posor.correction.joint_correction import AngleHistory, CorrectionLimits, JointCorrection
from posor.correction.joint_path import JointPath
from posor.correction.nominal_robot import LeastSquares, NominalRobot
from posor.errors import PosorError, TopicError
from posor.messages.joint_transform import stamp_ns_of
from posor.node_parameters import NodeParameters
from posor.numerics.stamps import NS, time_ns
from posor.ros_names import ENDPOINT_STATE_TOPIC
from posor_msgs.msg import EndpointState
from posor_ros.diagnostics import Level
from posor_ros.freshness import InputMonitor
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.node_program import run_node
from posor_ros.qos import RELIABLE_QOS, input_qos, result_qos
from pydantic import Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from posor_estimator.position_reader import PositionReader
from posor_estimator.trajectory_action import REPLACED, TrajectoryAction

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor.numerics.array_types import FloatArray
    from posor_ros.diagnostics import Value
    from rclpy.waitable import Waitable

ENDED = "the planner has ended its trajectory"
FEEDBACK_S = 0.1  # between two messages of feedback
PLANNED_TOPIC, CORRECTED_TOPIC = "trajectory", "trajectory/corrected"
MOST_PENDING = 256  # endpoints that wait for the angles of their time
_POSE = (*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw"))


class CorrectionParameters(NodeParameters):
    """Parameters of correction_node."""

    urdf: str = Field(description="path of the arm's URDF, as of chain_node")
    endpoint_frame: str = Field(default="endpoint", description="link of the URDF that is the endpoint")
    frame_prefix: str = Field(default="", description="prefix of the frames that chain_node publishes")
    period: Annotated[float, Field(ge=0.001, le=0.1)] = Field(
        default=0.004, description="time between two commands, that of the robot's interface [s]"
    )
    encoders: str = Field(
        default="encoders",
        description="topic of the robot's joint angles (sensor_msgs/JointState), stamped when they were read; empty: "
        "none, then the robot is taken to be where it was commanded 'dead_time' before",
    )
    dead_time: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0,
        description="time from a command to the motion of the robot [s], of a robot without encoders; the time "
        "constant of the offsets must be longer than its error",
    )
    max_uncertainty: Annotated[float, Field(gt=0.0)] = Field(
        default=1e-4, description="largest standard uncertainty of the endpoint's position along an axis [m]"
    )
    max_start: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.01, description="largest distance of a joint from the begin of a new trajectory [rad]"
    )
    on_stop: Literal["stop", "hold"] = Field(
        default="stop",
        description="where the correction stops: 'stop', the robot slows down on its path and stands; 'hold', it "
        "goes on with the offsets as they are",
    )
    stop_time: Annotated[float, Field(gt=0.0, le=10.0)] = Field(
        default=0.1, description="time in which it slows down [s]"
    )
    least_squares: LeastSquares = LeastSquares()
    offsets: CorrectionLimits = CorrectionLimits()


class Plan:
    """A trajectory of the planner, and how far it has been run."""

    def __init__(self, path: JointPath, begin_ns: int) -> None:
        """``begin_ns``: when it begins (ROS time)."""
        self.begin_ns, self.speed, self.has_begun, self.is_ending = begin_ns, 1.0, False, False
        self._sample, self._duration_s, self._elapsed_s = path.sampler(), path.duration_s, 0.0

    def advance(self, seconds: float, *, slowing_s: float = 0.0) -> None:
        """Go on; ``slowing_s``: time in which the robot slows down from full speed, 0: it does not."""
        seconds = min(seconds, self.speed * slowing_s) if slowing_s else seconds  # then it stands
        slower = max(0.0, self.speed - seconds / slowing_s) if slowing_s else self.speed
        self._elapsed_s = min(self._elapsed_s + 0.5 * (self.speed + slower) * seconds, self._duration_s)
        self.speed = slower

    @property
    def is_complete(self) -> bool:
        """Whether its end is reached."""
        return self._elapsed_s >= self._duration_s

    def angles(self, ahead_s: float = 0.0) -> FloatArray:
        """Return the planned angles some time ahead at the present speed, (j,)."""
        return self._sample(self._elapsed_s + self.speed * ahead_s)


class PlanPace:
    """The time by which a plan goes on with each point: never more than until the point is due, one period.

    The robot stands while no point comes, so a plan whose points are late runs later; a point that made up for the
    delay would be a jump. Only jitter is made up for: a point that comes early goes on by what the one before was late.

    Attributes:
        late_s: Time by which the plan runs later, as points were more than a period late [s].

    """

    def __init__(self, period_s: float, begin_s: float) -> None:
        """``begin_s``: steady time at which the plan begins [s]."""
        self._period_s, self._time_s, self.late_s = period_s, begin_s, 0.0

    def advance(self, now_s: float) -> float:
        """Return the time by which the plan goes on with a point of now (steady clock) [s]."""
        before_s, reached_s = self._time_s, min(now_s, self._time_s + self._period_s)
        self._time_s = max(reached_s, now_s - self._period_s)
        self.late_s += self._time_s - reached_s
        return reached_s - before_s


class CorrectionNode(PosorNode[CorrectionParameters]):
    """Corrects the trajectories of a robot by the measured endpoint of its arm."""

    NAME = "correction_node"
    Parameters = CorrectionParameters

    _robot: NominalRobot
    _law: JointCorrection
    _encoders: AngleHistory
    _commands: AngleHistory
    _pending: deque[tuple[int, pin.SE3]]

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._lock = RLock()
        self._status = self.diagnostics.add_status("correction")
        self._inputs = InputMonitor(self)
        self._plan: Plan | None = None
        self._action: TrajectoryAction | None = None
        if TrajectoryAction.is_installed():
            self._action = TrajectoryAction(self, self._begin, self._slow_down, self._refuse)
        self._refused = self._used = 0
        self.diagnostics.add_refresh(self._refresh_status)

    @property
    def waitables(self) -> Iterator[Waitable]:
        """The action server, which stays as long as the node: a waitable must not be removed from its executor."""
        return iter(() if self._action is None else (self._action.server,))

    def destroy_node(self) -> None:
        """Destroy the action server and the node."""
        if self._action is not None:
            self._action.close()
        super().destroy_node()

    def configure(self) -> None:
        """Read the URDF and open the topics."""
        parameters = self.parameters
        self._robot = NominalRobot(
            load_chain(Path(parameters.urdf), parameters.endpoint_frame), parameters.least_squares
        )
        self._law = JointCorrection(self._robot, parameters.offsets)
        self._reader = PositionReader(self._robot.joints)
        self._encoders, self._commands = AngleHistory(), AngleHistory()
        self._plan, self._pending, self._identity, self._newest_ns = None, deque(maxlen=MOST_PENDING), "", 0
        self._refused = self._used = 0
        self._pace = PlanPace(parameters.period, time.monotonic())
        self._status.report(Level.STALE, "no trajectory received yet")
        self._output = IntraProcessPublisher(self, JointTrajectory, CORRECTED_TOPIC, result_qos(parameters))
        states = IntraProcessSubscription(
            self, EndpointState, ENDPOINT_STATE_TOPIC, input_qos(parameters), self._on_state
        )
        self._inputs.add(states)
        self._inputs.add_output(self._output.topic_name)
        self.add_cleanup(self._inputs.clear)
        planned = self.create_subscription(JointTrajectory, PLANNED_TOPIC, self._on_trajectory, RELIABLE_QOS)
        self.add_cleanup(self.destroy_subscription, planned)
        if parameters.encoders:
            read = (JointState, parameters.encoders, input_qos(parameters), self._on_encoders)
            self._inputs.add(IntraProcessSubscription(self, *read))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.add_cleanup(self.destroy_timer, self.create_timer(parameters.period, self._command, clock=steady))

    def activate(self) -> None:
        """Expect endpoints from now on."""
        self._inputs.start()

    def deactivate(self) -> None:
        """Command nothing; the next trajectory starts again."""
        self._inputs.stop()
        with self._lock:
            self._plan = None
            self._pending.clear()
            self._law.stop("the node is inactive")
            self._end_goal("the node is inactive")

    def _on_trajectory(self, message: JointTrajectory) -> None:
        if message.points:
            self._begin(message)
        else:
            self._slow_down()

    def _slow_down(self) -> None:
        """Slow down on the present plan and stand."""
        with self._lock:
            if self._plan is not None:
                self._plan.is_ending = True

    def _begin(self, message: JointTrajectory) -> bool:
        """Begin a trajectory; return whether it is accepted."""
        with self._lock:
            if not self.may_publish:
                return False
            if several := self._inputs.several:
                self._refuse(several)
                return False
            try:
                plan = self._start(message)
            except PosorError as error:
                self._refuse(str(error))
                return False
            self._end_goal(REPLACED, "INVALID_GOAL")
            self._plan = plan
            self._newest_ns, self._command_s, self._is_reported = 0, time.monotonic(), False
            self._feedback_s = self._command_s
            self._pace = PlanPace(self.parameters.period, self._command_s)
            self._pending.clear()
            self._law.start(self._command_s)
            wait_s = (plan.begin_ns - self.timing.now_ns()) / NS
            self._status.report(Level.OK, f"begins in {wait_s:.1f} s" if wait_s > 0.0 else "following", self._counts())
            return True

    def _refuse(self, reason: str) -> None:
        """Count and report a trajectory that is refused."""
        self._refused += 1
        self.get_logger().error(f"trajectory refused: {reason}")
        if self._plan is None:
            self._status.report(Level.WARN, f"trajectory refused: {reason}", self._counts())

    def _end_goal(self, *failed: str) -> None:
        """End the goal of the action, if there is one; ``failed``: reason and error code."""
        if self._action is not None:
            self._action.finish(*failed)

    def _start(self, message: JointTrajectory) -> Plan:
        """Return the plan of a trajectory that begins where the robot is."""
        joints, now_ns = self._robot.joints, self.timing.now_ns()
        times_s = np.array([each.time_from_start.sec + each.time_from_start.nanosec / NS for each in message.points])
        stated, count = bool(message.points[0].velocities), len(message.joint_names)
        for n, each in enumerate(message.points):
            if len(each.positions) != count or len(each.velocities) != count * stated:
                what = f"point {n + 1} has {len(each.positions)} positions and {len(each.velocities)} velocities"
                expected = f"{count} and {count * stated}, as joint_names and the first point"
                raise TopicError(what, expected=expected)
        if times_s[0] < 0.0:
            raise TopicError(f"time_from_start of point 1 is {times_s[0]:g} s", expected="0 s or later")
        angles = np.array([each.positions for each in message.points])
        velocities = np.array([each.velocities for each in message.points]) if stated else None
        source = f"topic {PLANNED_TOPIC}"
        path = JointPath(tuple(message.joint_names), times_s, angles, velocities, source).of_joints(joints)
        present = self._present_angles(now_ns)
        if times_s[0] > 0.0:
            if present is None:
                expected = "a first point at 0 s, or encoders"
                raise TopicError(f"begins at {times_s[0]:g} s, and where the robot is is not known", expected=expected)
            path = JointPath(
                joints,
                np.append(0.0, path.times_s),
                np.vstack([present, path.angles]),
                None if path.velocities is None else np.vstack([np.zeros(len(joints)), path.velocities]),
                source,
            )
        if present is not None and (far := np.abs(path.angles[0] - present)).max() > self.parameters.max_start:
            worst = int(np.argmax(far))
            what = f"begins {far[worst]:.3g} rad from where joint {joints[worst]} is"
            raise TopicError(what, expected=f"at most {self.parameters.max_start:g} rad")
        begin_ns = time_ns(message.header.stamp.sec, message.header.stamp.nanosec) or now_ns
        if begin_ns < now_ns - NS * self.parameters.offsets.max_age:
            raise TopicError(f"begins {(now_ns - begin_ns) / NS:g} s ago", expected="a stamp of now or later, or zero")
        ahead_s = (begin_ns - now_ns) / NS
        if ahead_s > self.parameters.period and (plan := self._plan) and plan.has_begun and not plan.is_complete:
            raise TopicError(f"begins in {ahead_s:g} s while the robot moves", expected="a stamp of now, or zero")
        return Plan(path, begin_ns)

    def _present_angles(self, now_ns: int) -> FloatArray | None:
        """Return where the robot is without offsets, by its encoders or by the present plan; None: not known.

        Raises TopicError: the encoders have no angles of now.
        """
        if not (topic := self.parameters.encoders):
            return None if self._plan is None else self._plan.angles()
        angles, limit_s = self._encoders.at(self._encoders.newest_ns), self.parameters.offsets.max_age
        if angles is None or (now_ns - self._encoders.newest_ns) / NS > limit_s:
            what = f"where the robot is is not known: no angles on {topic} in the last {limit_s:g} s"
            raise TopicError(what, expected="readings of all joints")
        return angles - self._law.offsets

    def _on_encoders(self, data: bytes) -> None:
        try:
            stamp, angles = self._reader.read(data)
        except TopicError as error:
            self._inputs.note("encoders", f"{self.parameters.encoders}: {error}")
            return
        stamp_ns = stamp_ns_of(stamp)
        missing = [name for name, angle in zip(self._robot.joints, angles, strict=True) if np.isnan(angle)]
        fault = f"no position of joint {missing[0]}" if missing else self._inputs.stamp_limits.fault(stamp_ns)
        if fault:
            self._inputs.note("encoders", f"{self.parameters.encoders}: {fault}")
            return
        with self._lock:
            self._encoders.add(stamp_ns, angles)
            self._use_pending()

    def _on_state(self, data: bytes) -> None:
        try:
            schema = schema_of_class(EndpointState)
            values = schema.values(schema.normal(data))
        except TopicError as error:
            self._inputs.note("endpoint", f"{ENDPOINT_STATE_TOPIC}: {error}")
            return
        with self._lock:
            before, identity = self._identity, values["identity"] or self._identity
            if before and identity != before:
                self._law.stop(f"the arm has changed: identity {before[:8]} became {identity[:8]}")
            self._identity = identity
            if reason := self._reason_to_refuse(values):
                self._law.refuse_endpoint(reason)
                return
            stamp_ns = self._newest_ns = time_ns(values["header.stamp.sec"], values["header.stamp.nanosec"])
            self._pending.append((stamp_ns, pin.XYZQUATToSE3(np.array([values[name] for name in _POSE]))))
            self._use_pending()

    def _reason_to_refuse(self, values: Mapping[str, Any]) -> str:
        """Return why an endpoint is not used; empty if it is."""
        frames = values["header.frame_id"], values["child_frame_id"]
        prefix = self.parameters.frame_prefix
        expected = prefix + self._robot.base_frame, prefix + self.parameters.endpoint_frame
        if frames != expected:
            return f"the endpoint is that of {frames[1]} in {frames[0]}; expected {expected[1]} in {expected[0]}"
        if values["state"] != EndpointState.STATE_OK:
            return values["reason"] or "the endpoint is not OK"
        total = np.add(values["covariance_random"], values["covariance_systematic"]).reshape(6, 6)
        sigma = float(np.sqrt(np.max(np.diag(total)[:3])))
        if not (sigma <= self.parameters.max_uncertainty and np.isfinite([values[name] for name in _POSE]).all()):
            return f"the endpoint is uncertain by {sigma:.3g} m; expected at most {self.parameters.max_uncertainty:g} m"
        stamp_ns = time_ns(values["header.stamp.sec"], values["header.stamp.nanosec"])
        if (age_s := (self.timing.now_ns() - stamp_ns) / NS) > self.parameters.offsets.max_age:
            return f"the endpoint is {age_s:.2f} s old; expected at most {self.parameters.offsets.max_age:g} s"
        if stamp_ns <= self._newest_ns:
            return "the stamp of the endpoint does not advance"
        return self._inputs.refusal(stamp_ns)

    def _use_pending(self) -> None:
        """Use each endpoint once it is known where the controller had the robot then; encoders may be later."""
        topic, history, dead_ns = self.parameters.encoders, self._encoders, 0
        if not topic:
            topic, history, dead_ns = CORRECTED_TOPIC, self._commands, round(NS * self.parameters.dead_time)
        while self._pending:
            stamp_ns, pose = self._pending[0]
            if stamp_ns - dead_ns > history.newest_ns:
                self._law.refuse_endpoint(f"no angles on {topic} as new as the endpoint")
                return
            self._pending.popleft()
            if (angles := history.at(stamp_ns - dead_ns)) is None:
                self._law.refuse_endpoint(f"no angles on {topic} as old as the endpoint")
                continue
            self._used += 1
            self._law.add_endpoint(time.monotonic(), angles, pose)

    def _command(self) -> None:
        """Publish the next point."""
        with self._lock:
            plan, now_s, parameters = self._plan, time.monotonic(), self.parameters
            if plan is None or not self.may_publish:
                return
            elapsed_s, self._command_s = now_s - self._command_s, now_s
            if plan.is_ending and not plan.has_begun:
                self._end_goal(ENDED)
                self._plan = None
                self._status.report(Level.OK, ENDED, self._counts())
                return
            if not plan.has_begun:  # later the clock may go back, but the robot moves
                if self.timing.now_ns() < plan.begin_ns:
                    return
                plan.has_begun, self._pace = True, PlanPace(parameters.period, now_s)
                self._status.report(Level.OK, "following", self._counts())
            self._check_commands(plan, elapsed_s)
            step_s = self._pace.advance(now_s)
            offsets, stopped = self._law.step(now_s, step_s), self._law.stopped
            is_ending = plan.is_ending or (bool(stopped) and parameters.on_stop == "stop")
            plan.advance(step_s, slowing_s=parameters.stop_time if is_ending else 0.0)
            angles = plan.angles(parameters.period) + offsets
            point = JointTrajectoryPoint(positions=angles.tolist())
            point.time_from_start.nanosec = round(NS * parameters.period)
            message = JointTrajectory(joint_names=list(self._robot.joints), points=[point])
            self._output.publish(schema_of_class(JointTrajectory).serialize(message))
            self._commands.add(self.timing.now_ns() + round(NS * parameters.period), angles)
            if stopped and not self._is_reported:
                self._is_reported = True
                doing = "the robot slows down and stands" if is_ending else "the offsets stay"
                self._status.report(Level.ERROR, f"stopped, {doing}: {stopped}", self._counts())
                self.get_logger().error(f"correction stopped, {doing}: {stopped}")
            if plan.is_complete or plan.speed == 0.0:
                self._end_goal(stopped or ("" if plan.is_complete else ENDED))
            elif self._action is not None and now_s - self._feedback_s >= FEEDBACK_S:
                self._feedback_s = now_s
                self._action.publish_feedback(self._robot.joints, angles, self._encoders.at(self._encoders.newest_ns))
            if plan.speed == 0.0:
                self._plan = None
                if not stopped:
                    self._status.report(Level.OK, ENDED, self._counts())

    def _check_commands(self, plan: Plan, elapsed_s: float) -> None:
        """Stop where no command came for too long, or another node commands the robot too."""
        if elapsed_s > self.parameters.offsets.max_age:
            self._law.stop(f"no command for {elapsed_s:.2f} s, the process was late")
        if fault := self._inputs.output_fault:
            self._law.stop(fault)
            plan.is_ending = True  # also with 'hold': the robot must not follow two nodes

    def _refresh_status(self) -> None:
        with self._lock:
            if self._plan is not None:
                self._status.update(self._counts())

    def _counts(self) -> dict[str, Value]:
        offsets = zip(self._robot.joints, self._law.offsets.tolist(), strict=True)
        return {
            "endpoints_used": self._used,
            "steps_limited": self._law.limited,
            "plan_late [s]": round(self._pace.late_s, 3),
            "trajectories_refused": self._refused,
            **{f"offset {name} [rad]": round(value, 9) for name, value in offsets},
        }


def main() -> int:
    """Run the node as a program."""
    return run_node(CorrectionNode)
