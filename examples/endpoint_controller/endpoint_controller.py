# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""endpoint_controller: moves a stage so that an arm's endpoint, as measured by the POSORs, stays at its target.

The arm follows its encoders and misses its target by errors that no encoder measures: bending, runout, backlash. A
small fast stage between the arm and the endpoint compensates them. Three messages with the same stamp t give

    d(t) = R_endpoint(t)^T (p_target(t) - p_measured(t)) + u(t)          [m], axes of the endpoint,

the position of the stage that would have removed the error at t; u(t) is its actual position. d is the command.

A delay does no harm: if the stage moves by x, p_measured moves by R_endpoint x, so the first term falls by x and the
second one rises by x. d is the error of the arm alone, whatever the stage does. There is no feedback through the delay
of exposure, estimation, network and stage, no loop gain to tune, and nothing that could oscillate. A delay T leaves
only the change of d during T.

    python endpoint_controller.py --ros-args -r __ns:=/five_axis
"""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pinocchio as pin
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor.chain.time_synchroniser import TimeSynchroniser
from posor.node_parameters import NodeParameters
from posor.numerics.stamps import time_ns
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC
from posor_ros.diagnostics import Level
from posor_ros.intra_process import IntraProcessPublisher
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.node_program import run_node
from posor_ros.qos import RELIABLE_QOS
from pydantic import Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

TARGET_TOPIC = "target/endpoint"
POSITION_TOPIC = "stage/position"
COMMAND_TOPIC = "stage/command"
INPUTS = {
    ENDPOINT_COVARIANCE_TOPIC: PoseWithCovarianceStamped,
    TARGET_TOPIC: PoseStamped,
    POSITION_TOPIC: Vector3Stamped,
}
CHECKS_PER_MAX_AGE = 4
"""Number of checks in ``max_age`` whether the inputs still come."""


class ControllerParameters(NodeParameters):
    """Parameters of endpoint_controller."""

    endpoint_frame: str = Field(default="endpoint", description="link that the stage moves, along its own axes")
    stroke: Annotated[float, Field(gt=0.0)] = Field(
        default=5e-4, description="travel of the stage from its middle in both directions of each axis [m]"
    )
    time_constant: Annotated[float, Field(ge=0.0)] = Field(
        default=0.01, description="time constant of the first-order low-pass of the command [s]; 0: none"
    )
    max_age: Annotated[float, Field(gt=0.0)] = Field(default=0.1, description="maximum age of a scan that is used [s]")
    max_uncertainty: Annotated[float, Field(gt=0.0)] = Field(
        default=1e-4, description="maximum standard uncertainty of the endpoint's position along any axis [m]"
    )


class LowPass:
    """First-order low-pass of a vector with uneven sample times; starts anew after a gap."""

    def __init__(self, time_constant: float, longest_gap: float) -> None:
        """Smooth with a time constant [s]; forget earlier values after a gap [s]."""
        self._time_constant, self._longest_gap = time_constant, longest_gap
        self._last_ns = 0
        self._filtered: FloatArray = np.zeros(3)

    def filter_sample(self, time_ns: int, value: FloatArray) -> FloatArray:
        """Return the filtered value at a time [ns]."""
        step = 1e-9 * (time_ns - self._last_ns)
        known = self._time_constant > 0.0 and 0.0 < step <= self._longest_gap
        weight = -math.expm1(-step / self._time_constant) if known else 1.0
        self._filtered = self._filtered + weight * (value - self._filtered)
        self._last_ns = time_ns
        return self._filtered


def stamp_ns(message: Any) -> int:
    """Return the header's stamp [ns]; 0 if the stamp is invalid."""
    return time_ns(message.header.stamp.sec, message.header.stamp.nanosec)


def pose_from_message(message: Pose) -> pin.SE3:
    """Return a pose message as a transform."""
    p, q = message.position, message.orientation
    return pin.XYZQUATToSE3(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))


class EndpointController(PosorNode[ControllerParameters]):
    """Commands a stage so that it compensates the errors of the arm; holds it where these are unknown."""

    NAME = "endpoint_controller"
    Parameters = ControllerParameters

    _synchroniser: TimeSynchroniser[Any]
    _low_pass: LowPass

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._status = self.diagnostics.add_status("control")

    def configure(self) -> None:
        """Open the topics."""
        self._synchroniser = TimeSynchroniser(tuple(INPUTS))
        self._low_pass = LowPass(self.parameters.time_constant, self.parameters.max_age)
        self._newest_ns = dict.fromkeys(INPUTS, 0)
        self._commands = self._incomplete = 0
        self._status.report(Level.STALE, "no scan received yet")
        self._output = IntraProcessPublisher(self, Vector3Stamped, COMMAND_TOPIC, RELIABLE_QOS, count_listeners=True)
        for topic, kind in INPUTS.items():
            subscription = self.create_subscription(kind, topic, partial(self._on_message, topic), RELIABLE_QOS)
            self.add_cleanup(self.destroy_subscription, subscription)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # it runs on when the ROS clock is set back or stops
        check = self.create_timer(self.parameters.max_age / CHECKS_PER_MAX_AGE, self._check_inputs, clock=steady)
        self.add_cleanup(self.destroy_timer, check)

    def _on_message(self, topic: str, message: Any) -> None:
        self._newest_ns[topic] = stamp_ns(message)
        scan = self._synchroniser.add(topic, stamp_ns(message), message, 0.0)
        self._incomplete += len(self._synchroniser.take_incomplete())
        if scan is not None and self.may_publish:
            self._control(*(scan[name] for name in INPUTS))

    def _check_inputs(self) -> None:
        """Hold the stage if an input is late."""
        if self.may_publish and (reason := self._late_inputs()):
            self._hold(reason)

    def _late_inputs(self) -> str:
        """Return the late inputs as a text; age is measured by the ROS clock, so replays may have any speed."""
        now_ns, age_ns = self.get_clock().now().nanoseconds, 1e9 * self.parameters.max_age
        late = [topic for topic, newest_ns in self._newest_ns.items() if abs(now_ns - newest_ns) > age_ns]
        return f"no {', no '.join(late)} within {self.parameters.max_age:g} s of now" if late else ""

    def _control(self, measured: PoseWithCovarianceStamped, target: PoseStamped, stage: Vector3Stamped) -> None:
        """Command the stage from one scan, unless the scan must not be used."""
        if reason := self._late_inputs() or self._reason_to_refuse(measured, target, stage):
            self._hold(reason)
            return
        endpoint, target_pose = pose_from_message(measured.pose.pose), pose_from_message(target.pose)
        miss = endpoint.rotation.T @ (target_pose.translation - endpoint.translation)
        disturbance = miss + np.array([stage.vector.x, stage.vector.y, stage.vector.z])
        goal = self._low_pass.filter_sample(stamp_ns(measured), disturbance)
        if np.any(np.abs(goal) > self.parameters.stroke):
            self._hold(f"the endpoint is further from its target than the stage's {self.parameters.stroke:g} m")
            return
        command = Vector3Stamped(header=stage.header)
        command.vector.x, command.vector.y, command.vector.z = goal.tolist()
        self._output.publish(schema_of_class(Vector3Stamped).serialize(command))
        self._commands += 1
        self._status.report(Level.OK, "following", {**self._counts(), "miss": float(np.linalg.norm(miss))})

    def _reason_to_refuse(self, measured: PoseWithCovarianceStamped, target: PoseStamped, stage: Vector3Stamped) -> str:
        """Return why a scan must not be used; empty if it may."""
        base, frame = target.header.frame_id, self.parameters.endpoint_frame
        if measured.header.frame_id != base:
            return f"the endpoint is measured in '{measured.header.frame_id}', its target is in '{base}'"
        if stage.header.frame_id != frame:
            return f"the stage moves in '{stage.header.frame_id}'; expected '{frame}'"
        q = measured.pose.pose.orientation
        points = (measured.pose.pose.position, target.pose.position, stage.vector)
        if not np.isfinite([q.x, q.y, q.z, q.w, *(x for p in points for x in (p.x, p.y, p.z))]).all():
            return "a pose or the stage's position is not finite"
        variances = np.diag(np.reshape(measured.pose.covariance, (6, 6)))[:3]
        if not np.all(variances <= self.parameters.max_uncertainty**2):
            return f"the endpoint's position is more uncertain than {self.parameters.max_uncertainty:g} m"
        return ""

    def _hold(self, reason: str) -> None:
        """Command nothing, so that the stage stays where it is, and report the reason."""
        if not self._status.message.endswith(reason):
            self.get_logger().warning(f"holding the stage: {reason}")
        self._status.report(Level.ERROR, f"holding: {reason}", self._counts())

    def _counts(self) -> dict[str, int]:
        return {"commands": self._commands, "scans_incomplete": self._incomplete}


if __name__ == "__main__":
    sys.exit(run_node(EndpointController))
