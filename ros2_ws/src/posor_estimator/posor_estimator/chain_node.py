"""chain_node: joins the transforms of all joints of an arm and publishes where its endpoint is.

Subscribes ``<joint>/transform`` (posor_msgs/JointTransform) for every floating joint of the URDF; publishes
``endpoint/pose``, ``endpoint/pose_with_covariance`` and ``joint_states``, the angles about the joints' nominal axes.
Only transforms of the same stamp are joined; where one is missing, too late or not usable there is no pose, and the
diagnostics say which joint, and why.
"""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_msgs.msg import JointTransform
from pydantic import Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from posor_estimator.core.beam_motion import MovingChain
from posor_estimator.core.chain import Chain, Endpoint, load_chain
from posor_estimator.core.fault import State
from posor_estimator.core.joining import MOST_OPEN, ScanJoiner
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.messages import measured_joint, pose_from_message, pose_message, stamp_ns, why_unusable
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATES_TOPIC,
    TRANSFORM_TOPIC,
    result_qos,
    sensor_qos,
)

if TYPE_CHECKING:
    from posor_estimator.core.robot_model import FreeJoint

LOOKS_FOR_LATE = 4
"""How many times in ``max_wait`` the node looks for transforms that are late."""


class ChainParameters(NodeParameters):
    """Parameters of chain_node."""

    urdf: str = Field(description="path of the arm's URDF; its floating joints are the POSORs")
    endpoint_frame: str = Field(default="endpoint", description="link of the URDF whose pose is published")
    beams: str = Field(
        default="",
        description="path of the beams file: uncertainties and sag of the measuring beams; empty: straight and exact",
    )
    acceleration_window: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.0,
        description="motion [s] from which the beams' accelerations are found, for their sag; 0: as if at rest",
    )
    max_wait: Annotated[float, Field(gt=0.0, le=60.0)] = Field(
        default=0.1,
        description="how long the first transform of a scan waits for the others [s]; then there is no pose",
    )
    reference: Literal["absolute", "home"] = Field(
        default="absolute",
        description="publish the endpoint in the URDF's base frame, or relative to where it was at home: at the first "
        "pose, or at the last call of ~/set_home",
    )


class ChainNode(PosorNode[ChainParameters]):
    """Computes the endpoint of an arm from the transforms of its joints."""

    NAME = "chain_node"
    Parameters = ChainParameters

    _chain: Chain
    _moving: MovingChain
    _joiner: ScanJoiner[JointTransform]
    _home: Endpoint | None
    _last: Endpoint | None

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._status = self.diagnostics.add("endpoint")
        self._listeners = Listeners(self)
        self._transform_subscriptions: list[Any] = []
        self.diagnostics.before_each(self._report_unmeasured)

    def configure(self) -> None:
        """Read the URDF and open the topics."""
        path, beams = Path(self.parameters.urdf), self.parameters.beams
        self._chain = load_chain(path, self.parameters.endpoint_frame, Path(beams) if beams else None)
        self._moving = MovingChain(self._chain, self.parameters.acceleration_window)
        names = tuple(joint.name for joint in self._chain.joints)
        # Where everything is kept, one joint may be ahead of another by a whole replay.
        self._joiner = ScanJoiner(names, MOST_OPEN if self.parameters.qos_depth else math.inf)
        self._home = self._last = None
        self._poses = self._scans_refused = self._scans_incomplete = 0
        self._status.report(
            Level.STALE, "no complete scan yet", {"joints": ", ".join(names), "urdf": str(path), "beams": beams}
        )
        results = result_qos(self.parameters)
        self._pose_publisher = self._listeners.publisher(PoseStamped, ENDPOINT_TOPIC, results)
        self._covariance_publisher = self._listeners.publisher(
            PoseWithCovarianceStamped, ENDPOINT_COVARIANCE_TOPIC, results
        )
        self._joint_publisher = self._listeners.publisher(JointState, JOINT_STATES_TOPIC, results)
        qos = sensor_qos(self.parameters)
        self._transform_subscriptions = [
            self.create_subscription(JointTransform, f"{joint.name}/{TRANSFORM_TOPIC}", partial(self._take, joint), qos)
            for joint in self._chain.joints
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._late_timer = self.create_timer(
            self.parameters.max_wait / LOOKS_FOR_LATE, self._give_up_late, clock=steady
        )
        self._home_service = self.create_service(Trigger, "~/set_home", self._set_home)

    def cleanup(self) -> None:
        """Close the topics and forget the chain."""
        for subscription in self._transform_subscriptions:
            self.destroy_subscription(subscription)
        self._transform_subscriptions = []
        for publisher in (self._pose_publisher, self._covariance_publisher, self._joint_publisher):
            self.destroy_lifecycle_publisher(publisher)
        self.destroy_service(self._home_service)
        self.destroy_timer(self._late_timer)
        del self._chain, self._moving, self._joiner

    def _report_unmeasured(self) -> None:
        """Say which joints nobody measures, once a second."""
        topics = [subscription.topic_name for subscription in self._transform_subscriptions]
        silent = [topic for topic in topics if not self.count_publishers(topic)]
        if silent:
            self._say_no(f"nobody publishes {', '.join(silent)}")

    def _take(self, joint: FreeJoint, message: JointTransform) -> None:
        if not self._pose_publisher.is_activated:
            return
        named = (message.header.frame_id, message.child_frame_id)
        if named != (joint.parent, joint.child):
            self._scans_refused += 1
            self._say_no(
                f"{joint.name}: transforms from '{named[0]}' to '{named[1]}' arrive; "
                f"expected '{joint.parent}' to '{joint.child}', as in the URDF"
            )
            return
        scan = self._joiner.add(joint.name, stamp_ns(message), message, time.monotonic())
        self._report_given_up()
        if scan is not None:
            self._fuse(scan)

    def _give_up_late(self) -> None:
        """Give up scans that have waited long enough for a late joint."""
        self._joiner.give_up_before(time.monotonic() - self.parameters.max_wait)
        self._report_given_up()

    def _report_given_up(self) -> None:
        for missing in self._joiner.take_given_up().values():
            self._scans_incomplete += 1
            self._say_no(f"{', '.join(missing)}: transform missing from a scan that the other joints sent")

    def _fuse(self, scan: dict[str, JointTransform]) -> None:
        """Publish the endpoint of one complete scan, unless a joint's pose may not be used."""
        unusable = [f"{name} {why}" for name, message in scan.items() if (why := why_unusable(message))]
        if unusable:
            self._scans_refused += 1
            self._say_no("; ".join(unusable))
            return
        measured = {name: measured_joint(message) for name, message in scan.items()}
        self._last = self._moving.endpoint(stamp_ns(next(iter(scan.values()))), measured)
        endpoint, frame = self._last, self._chain.base_frame
        if self.parameters.reference == "home":
            self._home = self._home or self._last
            endpoint, frame = self._last.relative_to(self._home), f"{self.parameters.endpoint_frame}_home"
        self._publish(endpoint, frame, scan)
        self._poses += 1
        degraded = [name for name, message in scan.items() if message.state == State.DEGRADED]
        level, text = (Level.WARN, f"degraded: {', '.join(degraded)}") if degraded else (Level.OK, "ok")
        self._status.report(level, text, self._counts())

    def _publish(self, endpoint: Endpoint, frame: str, scan: dict[str, JointTransform]) -> None:
        stamp = next(iter(scan.values())).header.stamp
        pose = PoseStamped()
        pose.header.stamp, pose.header.frame_id = stamp, frame
        pose.pose = pose_message(endpoint.T_base_endpoint)
        self._pose_publisher.publish(pose)
        with_covariance = PoseWithCovarianceStamped(header=pose.header)
        with_covariance.pose.pose = pose.pose
        with_covariance.pose.covariance = endpoint.covariance.ravel()
        self._covariance_publisher.publish(with_covariance)
        joints = JointState()
        joints.header.stamp = stamp
        joints.name = [joint.name for joint in self._chain.joints]
        joints.position = [
            self._chain.joint_angle(name, pose_from_message(scan[name].pose), float(scan[name].native[5]))
            for name in joints.name
        ]
        self._joint_publisher.publish(joints)

    def _say_no(self, reason: str) -> None:
        """Report why there is no pose."""
        self._status.report(Level.ERROR, f"no pose: {reason}", self._counts())

    def _counts(self) -> dict[str, int]:
        return {"poses": self._poses, "scans_refused": self._scans_refused, "scans_incomplete": self._scans_incomplete}

    def _set_home(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take the last pose as home."""
        if self.parameters.reference != "home":
            response.message = "reference is 'absolute'; start the node with reference:=home to publish relative poses"
        elif self._last is None:
            response.message = "there is no pose yet to take as home"
        else:
            self._home = self._last
            response.success, response.message = True, "home is the endpoint's last pose"
        return response


def main() -> int:
    """Run the node as a program."""
    return run(ChainNode)
