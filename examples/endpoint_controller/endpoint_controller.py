"""endpoint_controller: keeps an arm's endpoint where it was told to be, by what the POSORs see.

The arm follows its encoders and so misses its target by what no encoder sees: bending, runout, backlash. A small fast
stage between the arm and the endpoint makes up for that. The three inputs of one scan, joined by their stamp t,

    d(t) = R_endpoint(t)^T (p_target(t) - p_measured(t)) + u(t)          [m], axes of the endpoint,

tell where the stage should have stood at t for no error at all, u(t) being where it did stand. That is the command.

Why a delay does no harm: when the stage moves by x, p_measured moves by R_endpoint x, so the first term falls by x and
the second one rises by x. d is what the arm alone does wrong, whatever the stage does. Nothing goes around through the
delay of exposure, estimation, network and stage; there is no loop gain to tune, and nothing that could oscillate. A
delay T only leaves what d changes by during T.

    python endpoint_controller.py --ros-args -r __ns:=/five_axis
"""

from __future__ import annotations

import math
import sys
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3Stamped
from posor_estimator.core.joining import ScanJoiner
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.messages import pose_from_message, stamp_ns
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import ENDPOINT_COVARIANCE_TOPIC, RELIABLE_QOS
from pydantic import Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import serialize_message

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

TARGET_TOPIC = "target/endpoint"
POSITION_TOPIC = "stage/position"
COMMAND_TOPIC = "stage/command"
INPUTS = {
    ENDPOINT_COVARIANCE_TOPIC: PoseWithCovarianceStamped,
    TARGET_TOPIC: PoseStamped,
    POSITION_TOPIC: Vector3Stamped,
}
LOOKS = 4
"""How many times in ``max_age`` the node looks whether its inputs still come."""


class ControllerParameters(NodeParameters):
    """Parameters of endpoint_controller."""

    endpoint_frame: str = Field(default="endpoint", description="link that the stage moves, along its own axes")
    stroke: Annotated[float, Field(gt=0.0)] = Field(
        default=5e-4, description="how far the stage goes from its middle, to either side of each axis [m]"
    )
    time_constant: Annotated[float, Field(ge=0.0)] = Field(
        default=0.01, description="of the first-order low-pass that takes noise out of the command [s]; 0: none"
    )
    max_age: Annotated[float, Field(gt=0.0)] = Field(
        default=0.1, description="how old a scan may be that is acted upon [s]"
    )
    max_uncertainty: Annotated[float, Field(gt=0.0)] = Field(
        default=1e-4, description="how uncertain the endpoint's position may be along any axis, one sigma [m]"
    )


class LowPass:
    """First-order low-pass of a vector that comes at uneven times; starts over after a gap."""

    def __init__(self, time_constant: float, longest_gap: float) -> None:
        """Smooth with a time constant [s]; forget what was before a gap [s]."""
        self._time_constant, self._longest_gap = time_constant, longest_gap
        self._last_ns = 0
        self._smooth: FloatArray = np.zeros(3)

    def next(self, time_ns: int, value: FloatArray) -> FloatArray:
        """Return the smoothed value at a time [ns]."""
        step = 1e-9 * (time_ns - self._last_ns)
        known = self._time_constant > 0.0 and 0.0 < step <= self._longest_gap
        weight = -math.expm1(-step / self._time_constant) if known else 1.0
        self._smooth = self._smooth + weight * (value - self._smooth)
        self._last_ns = time_ns
        return self._smooth


class EndpointController(PosorNode[ControllerParameters]):
    """Commands a stage so that it makes up for what the arm does wrong; holds still where it cannot know that."""

    NAME = "endpoint_controller"
    Parameters = ControllerParameters

    _joiner: ScanJoiner[Any]
    _low_pass: LowPass

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._status = self.diagnostics.add("control")
        self._listeners = Listeners(self)

    def configure(self) -> None:
        """Open the topics."""
        self._joiner = ScanJoiner(tuple(INPUTS))
        self._low_pass = LowPass(self.parameters.time_constant, self.parameters.max_age)
        self._newest_ns = dict.fromkeys(INPUTS, 0)
        self._commands = self._incomplete = 0
        self._status.report(Level.STALE, "nothing to act upon yet")
        self._output = self._listeners.outlet(Vector3Stamped, COMMAND_TOPIC, RELIABLE_QOS)
        self.when_cleaned_up(self._output.destroy)
        for topic, kind in INPUTS.items():
            subscription = self.create_subscription(kind, topic, partial(self._take, topic), RELIABLE_QOS)
            self.when_cleaned_up(self.destroy_subscription, subscription)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # it goes on when the ROS clock is set back or halts
        lookout = self.create_timer(self.parameters.max_age / LOOKS, self._look_out, clock=steady)
        self.when_cleaned_up(self.destroy_timer, lookout)

    def _take(self, topic: str, message: Any) -> None:
        self._newest_ns[topic] = stamp_ns(message)
        scan = self._joiner.add(topic, stamp_ns(message), message, 0.0)
        self._incomplete += len(self._joiner.take_given_up())
        if scan is not None and self.may_publish:
            self._control(*(scan[name] for name in INPUTS))

    def _look_out(self) -> None:
        """Notice that something does not come any more."""
        if self.may_publish and (why := self._out_of_date()):
            self._hold(why)

    def _out_of_date(self) -> str:
        """Return what has not come lately; the ROS clock tells, so replays and simulations age at their own pace."""
        now_ns, age_ns = self.get_clock().now().nanoseconds, 1e9 * self.parameters.max_age
        late = [topic for topic, newest_ns in self._newest_ns.items() if abs(now_ns - newest_ns) > age_ns]
        return f"no {', no '.join(late)} within {self.parameters.max_age:g} s of now" if late else ""

    def _control(self, measured: PoseWithCovarianceStamped, target: PoseStamped, stage: Vector3Stamped) -> None:
        """Command the stage from one scan, unless there is a reason not to."""
        if why := self._out_of_date() or self._why_unfit(measured, target, stage):
            self._hold(why)
            return
        endpoint, wanted = pose_from_message(measured.pose.pose), pose_from_message(target.pose)
        miss = endpoint.rotation.T @ (wanted.translation - endpoint.translation)
        disturbance = miss + np.array([stage.vector.x, stage.vector.y, stage.vector.z])
        goal = self._low_pass.next(stamp_ns(measured), disturbance)
        if np.any(np.abs(goal) > self.parameters.stroke):
            self._hold(f"the endpoint is further from its target than the stage's {self.parameters.stroke:g} m")
            return
        command = Vector3Stamped(header=stage.header)
        command.vector.x, command.vector.y, command.vector.z = goal.tolist()
        self._output.publish(serialize_message(command))
        self._commands += 1
        self._status.report(Level.OK, "following", {**self._counts(), "miss": float(np.linalg.norm(miss))})

    def _why_unfit(self, measured: PoseWithCovarianceStamped, target: PoseStamped, stage: Vector3Stamped) -> str:
        """Return why a scan must not be acted upon, an empty string when it may."""
        base, frame = target.header.frame_id, self.parameters.endpoint_frame
        if measured.header.frame_id != base:
            return f"the endpoint is measured in '{measured.header.frame_id}', its target is in '{base}'"
        if stage.header.frame_id != frame:
            return f"the stage moves in '{stage.header.frame_id}'; expected '{frame}'"
        turn = measured.pose.pose.orientation
        points = (measured.pose.pose.position, target.pose.position, stage.vector)
        if not np.isfinite([turn.x, turn.y, turn.z, turn.w, *(x for p in points for x in (p.x, p.y, p.z))]).all():
            return "a pose or the stage's position is not finite"
        variances = np.diag(np.reshape(measured.pose.covariance, (6, 6)))[:3]
        if not np.all(variances <= self.parameters.max_uncertainty**2):
            return f"the endpoint's position is more uncertain than {self.parameters.max_uncertainty:g} m"
        return ""

    def _hold(self, why: str) -> None:
        """Command nothing, so that the stage stays where it is, and say why."""
        if not self._status.message.endswith(why):
            self.get_logger().warning(f"holding the stage: {why}")
        self._status.report(Level.ERROR, f"holding: {why}", self._counts())

    def _counts(self) -> dict[str, int]:
        return {"commands": self._commands, "scans_incomplete": self._incomplete}


if __name__ == "__main__":
    sys.exit(run(EndpointController))
