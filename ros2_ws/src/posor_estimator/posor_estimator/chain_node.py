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
from threading import RLock
from typing import TYPE_CHECKING, Annotated, Any, Literal

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_msgs.msg import JointTransform
from pydantic import Field
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from posor_estimator.bulk.layout import LEAD
from posor_estimator.core.chain import load_chain
from posor_estimator.core.chain_records import ChainRecords
from posor_estimator.core.fault import State
from posor_estimator.core.joining import MOST_OPEN, ScanJoiner
from posor_estimator.core.kernels.stamps import NO_TIME
from posor_estimator.errors import TopicError
from posor_estimator.ros.cdr import STAMP
from posor_estimator.ros.cdr_endpoint import EndpointWriter
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM, TransformKind, stamp_ns_of
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.listeners import Listeners
from posor_estimator.ros.main import run
from posor_estimator.ros.messages import why_unusable
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
from posor_estimator.ros.wire import Inlet

if TYPE_CHECKING:
    from posor_estimator.core.chain_lane import ChainLane
    from posor_estimator.core.robot_model import FreeJoint
    from posor_estimator.core.types import FloatArray
    from posor_estimator.ros.diagnostics import Value, Words
    from posor_estimator.ros.wire import Outlet


LOOK_S = 0.5
"""Longest time between two looks for joints that are late; each takes Python's lock from the thread of the scans."""


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
    """Computes the endpoint of an arm from the transforms of its joints.

    Transforms may come in other threads than timer and service calls: what they share is only used under a lock.
    """

    NAME = "chain_node"
    Parameters = ChainParameters

    _lane: ChainLane
    _joiner: ScanJoiner[bytes]
    _kinds: dict[str, TransformKind]
    _home: FloatArray | None
    _last: FloatArray | None
    _told: object

    def __init__(self, **options: Any) -> None:
        """Create the node; ``options`` go to rclpy."""
        super().__init__(**options)
        self._lock = RLock()
        self._status = self.diagnostics.add("endpoint", logged=True)
        self._listeners = Listeners(self)
        self._inlets: list[Inlet] = []
        self._poses = self._scans_refused = self._scans_incomplete = 0
        self._told = None
        self.diagnostics.before_each(self._refresh)

    def configure(self) -> None:
        """Read the URDF and open the topics."""
        path, beams = Path(self.parameters.urdf), self.parameters.beams
        chain = load_chain(path, self.parameters.endpoint_frame, Path(beams) if beams else None)
        self._lane = chain.lane(self.parameters.acceleration_window)
        names = self._lane.joints
        # Where everything is kept, one joint may be ahead of another by a whole replay.
        most_open = MOST_OPEN if self.parameters.qos_depth else math.inf
        self._joiner = ScanJoiner(names, most_open, self.parameters.max_wait)
        self._kinds = {joint.name: TransformKind(joint.parent, joint.child) for joint in chain.joints}
        self._records = ChainRecords(self._lane, [self._kinds[name].columns for name in names])
        self._room = [
            (name, self._kinds[name].size, row[LEAD : LEAD + self._kinds[name].size].data)
            for name, row in zip(names, self._records.rows, strict=True)
        ]
        self._home = self._last = self._told = None
        self._poses = self._scans_refused = self._scans_incomplete = 0
        self._status.report(
            Level.STALE, "no complete scan yet", {"joints": ", ".join(names), "urdf": str(path), "beams": beams}
        )
        self._relative = self.parameters.reference == "home"
        frame = f"{self.parameters.endpoint_frame}_home" if self._relative else chain.base_frame
        self._writer = EndpointWriter(self._lane, frame, relative=self._relative)
        self._pose = self._outlet(PoseStamped, ENDPOINT_TOPIC)
        self._full_pose = self._outlet(PoseWithCovarianceStamped, ENDPOINT_COVARIANCE_TOPIC)
        self._joint_states = self._outlet(JointState, JOINT_STATES_TOPIC)
        self.when_cleaned_up(self._fall_silent)
        qos = sensor_qos(self.parameters)
        for joint in chain.joints:
            take = partial(self._take, joint, self._kinds[joint.name])
            self._inlets.append(Inlet(self, JointTransform, f"{joint.name}/{TRANSFORM_TOPIC}", qos, take))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(min(self.parameters.max_wait, LOOK_S), self._give_up_late, clock=steady)
        self.when_cleaned_up(self.destroy_timer, timer)
        service = self.create_service(Trigger, "~/set_home", self._set_home)
        self.when_cleaned_up(self.destroy_service, service)

    def _outlet(self, message_type: type[Any], topic: str) -> Outlet:
        return self._listeners.outlet(message_type, topic, result_qos(self.parameters))

    def _fall_silent(self) -> None:
        """Say no more of joints, once a transform that is being answered has been."""
        with self._lock:
            self._inlets = []

    def _refresh(self) -> None:
        """Bring the counts up to date, and say which joints nobody measures, once a second."""
        silent = [inlet.topic_name for inlet in self._inlets if not inlet.has_publisher()]
        with self._lock:
            if self._inlets:
                self._status.update(self._counts())
            if silent:
                self._say_no(f"nobody publishes {', '.join(silent)}")

    def _take(self, joint: FreeJoint, kind: TransformKind, data: bytes) -> None:
        """Take one joint's transform."""
        with self._lock:
            if not self.may_publish:
                return
            if not kind.takes(data) and not (data := self._normal(joint, data)):
                return
            stamp_ns = stamp_ns_of(data[STAMP])
            if stamp_ns == 0:  # to the joiner it would be time that has gone back
                self._scans_refused += 1
                self._say_no(f"{joint.name}: the stamp of a transform {NO_TIME}; expected the time of exposure")
                return
            scan = self._joiner.add(joint.name, stamp_ns, data, time.monotonic())
            if self._joiner.given_up:
                self._report_given_up()
            if scan is not None:
                self._fuse(scan, stamp_ns)

    def _normal(self, joint: FreeJoint, data: bytes) -> bytes:
        """Return a transform in plain CDR; nothing where it is not this joint's, which is said."""
        try:
            data = JOINT_TRANSFORM.normal(data)
            values = JOINT_TRANSFORM.values(data)
        except TopicError as error:
            self._scans_refused += 1
            self._say_no(f"{joint.name}: {error}")
            return b""
        frames = (str(values["header.frame_id"]), str(values["child_frame_id"]))
        if frames != (joint.parent, joint.child):
            self._scans_refused += 1
            self._say_no(
                f"{joint.name}: transforms from '{frames[0]}' to '{frames[1]}' arrive; "
                f"expected '{joint.parent}' to '{joint.child}', as in the URDF"
            )
            return b""
        return data

    def _give_up_late(self) -> None:
        """Give up scans that have waited long enough for a late joint."""
        with self._lock:
            self._joiner.give_up_before(time.monotonic() - self.parameters.max_wait)
            self._report_given_up()

    def _report_given_up(self) -> None:
        for missing in self._joiner.take_given_up().values():
            self._scans_incomplete += 1
            if self._told != (told := ("missing", missing)):
                self._say_no(f"{', '.join(missing)}: transform missing from a scan that the other joints sent", told)

    def _fuse(self, scan: dict[str, bytes], stamp_ns: int) -> None:
        """Publish the endpoint of one complete scan, unless a joint's pose may not be used."""
        for name, size, row in self._room:
            data = scan[name]
            row[:] = data if len(data) == size else data[:size]
        worst = self._records.run(stamp_ns)
        if worst < 0:
            self._refuse(scan)
            return
        lane = self._lane
        if self._relative:
            self._last = lane.pose.copy()
            self._home = self._last if self._home is None else self._home
            lane.find_relative_to(self._home)
        stamp, writer = data[STAMP], self._writer
        self._pose.publish(writer.pose.write(stamp))
        if self._full_pose.is_wanted:
            self._full_pose.publish(writer.pose_with_covariance.write(stamp))
        if self._joint_states.is_wanted:
            self._joint_states.publish(writer.joint_states.write(stamp))
        self.timing.note(stamp_ns)
        self._poses += 1
        degraded = () if worst == State.OK else tuple(name for name, verdict in self._verdicts(scan) if verdict[0])
        if self._told != (told := ("sound", degraded)):
            level, text = (Level.WARN, f"degraded: {', '.join(degraded)}") if degraded else (Level.OK, "ok")
            self._status.report(level, text, self._counts())
            self._told = told

    def _verdicts(self, scan: dict[str, bytes]) -> list[tuple[str, tuple[int, int]]]:
        """Return what the joints say of their poses, state and faults, by their names in the chain's order."""
        return [(name, self._kinds[name].verdict(scan[name])) for name in self._lane.joints]

    def _refuse(self, scan: dict[str, bytes]) -> None:
        """Say why a complete scan gives no pose, where that is news."""
        self._scans_refused += 1
        if self._told != (told := ("unusable", self._verdicts(scan), self._lane.faults.tolist())):
            self._told = told
            self._status.report_news(Level.ERROR, partial(_why_not, {**scan}, self._lane.joints, self._counts()))

    def _say_no(self, reason: str, told: object = None) -> None:
        """Report why there is no pose; ``told`` stands for the reason, so that it need not be put into words again."""
        self._status.report(Level.ERROR, _no_pose(reason), self._counts())
        self._told = told

    def _counts(self) -> dict[str, Value]:
        return {"poses": self._poses, "scans_refused": self._scans_refused, "scans_incomplete": self._scans_incomplete}

    def _set_home(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take the last pose as home."""
        if not self._relative:
            response.message = "reference is 'absolute'; start the node with reference:=home to publish relative poses"
        elif self._last is None:
            response.message = "there is no pose yet to take as home"
        else:
            self._home = self._last
            response.success, response.message = True, "home is the endpoint's last pose"
        return response


def _why_not(scan: dict[str, bytes], joints: tuple[str, ...], counts: dict[str, Value]) -> Words:
    """Say which joints of a complete scan have no usable pose, and why."""
    said = [(name, why_unusable(deserialize_message(scan[name], JointTransform))) for name in joints]
    return _no_pose("; ".join(f"{name} {why}" for name, why in said if why)), counts


def _no_pose(reason: str) -> str:
    return f"no pose: {reason}"


def main() -> int:
    """Run the node as a program."""
    return run(ChainNode)
