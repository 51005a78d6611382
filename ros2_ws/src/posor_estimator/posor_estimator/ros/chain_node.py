"""chain_node: computes the endpoint of an arm from the transforms of its joints.

Subscribes to ``<joint>/transform`` (posor_msgs/JointTransform) for every floating joint of the URDF. Publishes
``endpoint/pose``, ``endpoint/pose_with_covariance`` and ``joint_states``, the angles about the joints' nominal axes.
Transforms are joined by equal stamps. Without a usable transform of every joint in time there is no pose; the
diagnostics name the joint and the reason.
"""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_msgs.msg import JointTransform
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from posor_estimator.bags.cdr_schema import STAMP
from posor_estimator.bags.message_table import LEAD
from posor_estimator.chain.chain_parameters import CHAIN_NODE
from posor_estimator.chain.kinematic_chain import load_chain
from posor_estimator.chain.time_synchroniser import MAX_OPEN_SCANS, TimeSynchroniser
from posor_estimator.errors import TopicError
from posor_estimator.model.fault import State
from posor_estimator.node_parameters import ChainParameters
from posor_estimator.numerics.stamps import NO_TIME
from posor_estimator.ros.cdr_endpoint import EndpointWriter
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM, JointTransformFormat, stamp_ns_of
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_estimator.ros.lifecycle_node import PosorNode
from posor_estimator.ros.message_conversion import why_unusable
from posor_estimator.ros.node_program import run_node
from posor_estimator.ros.qos import result_qos, sensor_qos
from posor_estimator.ros_names import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_TOPIC, JOINT_STATES_TOPIC, TRANSFORM_TOPIC

if TYPE_CHECKING:
    from posor_estimator.chain.endpoint_estimator import EndpointEstimator
    from posor_estimator.chain.robot_model import FreeJoint
    from posor_estimator.numerics.array_types import FloatArray
    from posor_estimator.ros.diagnostics import StatusText, Value


LATE_CHECK_S = 0.5
"""Longest time between two checks for late joints; each takes the interpreter lock from the thread of the scans."""


class ChainNode(PosorNode[ChainParameters]):
    """Computes the endpoint of an arm from the transforms of its joints.

    Transforms, timers and service calls may come in different threads; a lock protects their common state.
    """

    NAME = CHAIN_NODE
    Parameters = ChainParameters

    _estimator: EndpointEstimator
    _synchroniser: TimeSynchroniser[bytes]
    _kinds: dict[str, JointTransformFormat]
    _home: FloatArray | None
    _last_pose: FloatArray | None
    _reported: object

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` are passed to rclpy."""
        super().__init__(**options)
        self._lock = RLock()
        self._status = self.diagnostics.add_status("endpoint", logged=True)
        self._subscriptions_of_joints: list[IntraProcessSubscription] = []
        self._poses = self._scans_refused = self._scans_incomplete = 0
        self._reported = None
        self.diagnostics.add_refresh(self._refresh_status)

    def configure(self) -> None:
        """Read the URDF and open the topics."""
        path, beams = Path(self.parameters.urdf), self.parameters.beams
        chain = load_chain(path, self.parameters.endpoint_frame, Path(beams) if beams else None)
        names = tuple(joint.name for joint in chain.joints)
        # With keep-all topics one joint may be ahead of another by a whole replay.
        max_open = MAX_OPEN_SCANS if self.parameters.qos_depth else math.inf
        self._synchroniser = TimeSynchroniser(names, max_open, self.parameters.max_wait)
        self._kinds = {joint.name: JointTransformFormat(joint.parent, joint.child) for joint in chain.joints}
        layouts = [self._kinds[name].row_layout for name in names]
        self._estimator = chain.estimator(self.parameters.acceleration_window, layouts)
        self._buffers = [
            (name, self._kinds[name].size, row[LEAD : LEAD + self._kinds[name].size].data)
            for name, row in zip(names, self._estimator.rows, strict=True)
        ]
        self._home = self._last_pose = self._reported = None
        self._poses = self._scans_refused = self._scans_incomplete = 0
        self._status.report(
            Level.STALE, "no complete scan yet", {"joints": ", ".join(names), "urdf": str(path), "beams": beams}
        )
        self._is_relative = self.parameters.reference == "home"
        frame = f"{self.parameters.endpoint_frame}_home" if self._is_relative else chain.base_frame
        self._writer = EndpointWriter(self._estimator, frame, relative=self._is_relative)
        self._pose = self._create_publisher(PoseStamped, ENDPOINT_TOPIC)
        self._pose_with_covariance = self._create_publisher(PoseWithCovarianceStamped, ENDPOINT_COVARIANCE_TOPIC)
        self._joint_states = self._create_publisher(JointState, JOINT_STATES_TOPIC)
        self.add_cleanup(self._forget_joints)
        for joint in chain.joints:
            callback = partial(self._on_transform, joint, self._kinds[joint.name])
            topic = f"{joint.name}/{TRANSFORM_TOPIC}"
            self._subscriptions_of_joints.append(
                IntraProcessSubscription(self, JointTransform, topic, sensor_qos(self.parameters), callback)
            )
        steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        period_s = min(self.parameters.max_wait, LATE_CHECK_S)
        self.add_cleanup(self.destroy_timer, self.create_timer(period_s, self._close_late_scans, clock=steady_clock))
        self.add_cleanup(self.destroy_service, self.create_service(Trigger, "~/set_home", self._on_set_home))

    def _create_publisher(self, message_type: type[Any], topic: str) -> IntraProcessPublisher:
        return IntraProcessPublisher(self, message_type, topic, result_qos(self.parameters), count_listeners=True)

    def _forget_joints(self) -> None:
        """Report no joints after the present transform."""
        with self._lock:
            self._subscriptions_of_joints = []

    def _refresh_status(self) -> None:
        """Update the counts and report joints without a publisher, once a second."""
        missing = [joint.topic_name for joint in self._subscriptions_of_joints if not joint.has_publisher()]
        with self._lock:
            if self._subscriptions_of_joints:
                self._status.update(self._counts())
            if missing:
                self._report_no_pose(f"nobody publishes {', '.join(missing)}")

    def _on_transform(self, joint: FreeJoint, kind: JointTransformFormat, data: bytes) -> None:
        """Add a transform of one joint to its scan; publish the endpoint once the scan is complete."""
        with self._lock:
            if not self.may_publish:
                return
            if not kind.matches(data) and not (data := self._normalise(joint, data)):
                return
            stamp_ns = stamp_ns_of(data[STAMP])
            if stamp_ns == 0:  # the synchroniser would take it for a time that has gone back
                self._scans_refused += 1
                self._report_no_pose(f"{joint.name}: the stamp of a transform {NO_TIME}; expected the time of exposure")
                return
            scan = self._synchroniser.add(joint.name, stamp_ns, data, time.monotonic())
            if self._synchroniser.incomplete:
                self._report_incomplete_scans()
            if scan is not None:
                self._publish_endpoint(scan, stamp_ns)

    def _normalise(self, joint: FreeJoint, data: bytes) -> bytes:
        """Return a transform in plain CDR; report an invalid transform or wrong frames and return empty bytes."""
        try:
            data = JOINT_TRANSFORM.normal(data)
            values = JOINT_TRANSFORM.values(data)
        except TopicError as error:
            reason = str(error)
        else:
            frames = (str(values["header.frame_id"]), str(values["child_frame_id"]))
            if frames == (joint.parent, joint.child):
                return data
            reason = (
                f"transforms from '{frames[0]}' to '{frames[1]}' arrive; "
                f"expected '{joint.parent}' to '{joint.child}', as in the URDF"
            )
        self._scans_refused += 1
        self._report_no_pose(f"{joint.name}: {reason}")
        return b""

    def _close_late_scans(self) -> None:
        """Close scans that have waited for longer than ``max_wait``."""
        with self._lock:
            self._synchroniser.close_before(time.monotonic() - self.parameters.max_wait)
            self._report_incomplete_scans()

    def _report_incomplete_scans(self) -> None:
        for missing in self._synchroniser.take_incomplete().values():
            self._scans_incomplete += 1
            if self._reported != (key := ("missing", missing)):
                reason = f"{', '.join(missing)}: transform missing from a scan that the other joints sent"
                self._report_no_pose(reason, key)

    def _publish_endpoint(self, scan: dict[str, bytes], stamp_ns: int) -> None:
        """Publish the endpoint of a complete scan, unless a transform is unusable."""
        for name, size, row in self._buffers:
            data = scan[name]
            row[:] = data if len(data) == size else data[:size]
        estimator = self._estimator
        worst = estimator.estimate_rows(stamp_ns)
        if worst < 0:
            self._refuse_scan(scan)
            return
        if self._is_relative:
            self._last_pose = estimator.pose.copy()
            self._home = self._last_pose if self._home is None else self._home
            estimator.estimate_relative_to(self._home)
        stamp, writer = data[STAMP], self._writer
        self._pose.publish(writer.pose.write(stamp))
        if self._pose_with_covariance.has_subscriptions:
            self._pose_with_covariance.publish(writer.pose_with_covariance.write(stamp))
        if self._joint_states.has_subscriptions:
            self._joint_states.publish(writer.joint_states.write(stamp))
        self.timing.record(stamp_ns)
        self._poses += 1
        degraded = () if worst == State.OK else tuple(name for name, (state, _) in self._states(scan) if state)
        if self._reported != (key := ("usable", degraded)):
            level, text = (Level.WARN, f"degraded: {', '.join(degraded)}") if degraded else (Level.OK, "ok")
            self._status.report(level, text, self._counts())
            self._reported = key

    def _states(self, scan: dict[str, bytes]) -> list[tuple[str, tuple[int, int]]]:
        """Return the name, state and faults of each joint, in the chain's order."""
        return [(name, self._kinds[name].read_state(scan[name])) for name in self._estimator.joints]

    def _refuse_scan(self, scan: dict[str, bytes]) -> None:
        """Count a complete scan without a pose; report the reason if it has changed."""
        self._scans_refused += 1
        if self._reported != (key := ("unusable", self._states(scan), self._estimator.faults.tolist())):
            self._reported = key
            formatter = partial(_format_refusal, {**scan}, self._estimator.joints, self._counts())
            self._status.report_status_change(Level.ERROR, formatter)

    def _report_no_pose(self, reason: str, key: object = None) -> None:
        """Report why there is no pose; ``key`` identifies the reason, so that the same text is not formatted again."""
        self._status.report(Level.ERROR, f"no pose: {reason}", self._counts())
        self._reported = key

    def _counts(self) -> dict[str, Value]:
        return {"poses": self._poses, "scans_refused": self._scans_refused, "scans_incomplete": self._scans_incomplete}

    def _on_set_home(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Use the last pose as home."""
        with self._lock:
            if not self._is_relative:
                response.message = "reference is 'absolute'; start the node with reference:=home for relative poses"
            elif self._last_pose is None:
                response.message = "there is no pose yet to take as home"
            else:
                self._home = self._last_pose
                response.success, response.message = True, "home is the endpoint's last pose"
        return response


def _format_refusal(scan: dict[str, bytes], joints: tuple[str, ...], counts: dict[str, Value]) -> StatusText:
    """Name the joints of a complete scan without a usable transform, and the reasons."""
    reasons = [(name, why_unusable(deserialize_message(scan[name], JointTransform))) for name in joints]
    return f"no pose: {'; '.join(f'{name} {reason}' for name, reason in reasons if reason)}", counts


def main() -> int:
    """Run the node as a program."""
    return run_node(ChainNode)
