# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""chain_node: computes the endpoint of an arm from the transforms of its joints.

Subscribes to ``<joint>/transform`` (posor_msgs/JointTransform) for every floating joint of the URDF. Publishes
``endpoint/pose``, ``endpoint/pose_with_covariance`` and ``joint_states``, the angles about the joints' nominal axes.
/tf has the frames of the arm with the stamp of each pose; /tf_static and ``robot_description`` have what is fixed.
It also subscribes to the thermometers of the beams file, at whose temperatures it keeps the beams, and to the
accelerometers, with which the beams vibrate. With the parameter ``encoders.topic`` it predicts the endpoint between
scans, see ``endpoint_prediction``.
Transforms are joined by equal stamps. Without a usable transform of every joint in time there is no pose.
``endpoint/state`` (posor_msgs/EndpointState) is published for every scan, for every transform that is refused, and
every 0.08 s during a silence of the input; it and the diagnostics name the joint and the reason. Those who watch have
``endpoint/state_throttle``: every change, and otherwise at most twenty a second.
"""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.chain.arm_file import CHAIN_NODE
from posor.chain.forward_kinematics import UNUSABLE
from posor.chain.kinematic_chain import load_chain
from posor.chain.time_synchroniser import MAX_OPEN_SCANS, TimeSynchroniser
from posor.errors import TopicError
from posor.messages.cdr_schema import LITTLE_ENDIAN, STAMP
from posor.messages.endpoint_messages import EndpointStateWriter, EndpointVerdict, EndpointWriter
from posor.messages.joint_transform import JointTransformFormat, TransformConstants, stamp_ns_of, stamp_of
from posor.model.fault import State
from posor.node_parameters import ChainParameters
from posor.numerics.stamps import NO_TIME, NS
from posor.ros_names import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_STATE_THROTTLE_TOPIC,
    ENDPOINT_STATE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATES_TOPIC,
    TRANSFORM_TOPIC,
)
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.delivery_round import DeliveryGroup
from posor_ros.diagnostics import Level
from posor_ros.freshness import InputMonitor
from posor_ros.intra_process import IntraProcessManager, IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.node_program import run_node
from posor_ros.qos import input_qos, result_qos
from posor_ros.throttled_publisher import ThrottledPublisher, may_be_due_next
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from sensor_msgs.msg import JointState

from posor_estimator.alarm_rate import AlarmRate
from posor_estimator.beam_inputs import BeamInputs
from posor_estimator.endpoint_prediction import EndpointPrediction, JointMessage
from posor_estimator.endpoint_verdict import SOUND, degraded_by, degraded_verdict, unusable_verdict
from posor_estimator.frame_publisher import FramePublisher
from posor_estimator.home_pose import HomePose
from posor_estimator.identity_check import IdentityCheck
from posor_estimator.scan_rows import ScanRows

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.robot_model import FreeJoint
    from posor.messages.arm_pass import ArmPass
    from posor_ros.delivery_round import Delivery
    from posor_ros.diagnostics import Status, Value
    from std_srvs.srv import Trigger

    from posor_estimator.prepared_scan import PreparedScan


OK = int(State.OK)
LATE_CHECK_S = 0.5
"""Longest time between two checks for late joints; each takes the interpreter lock from the thread of the scans."""


class ChainNode(PosorNode[ChainParameters]):
    """Computes the endpoint of an arm from the transforms of its joints.

    Transforms, timers and service calls may come in different threads; a lock protects their common state.
    """

    NAME = CHAIN_NODE
    Parameters = ChainParameters

    _estimator: EndpointEstimator
    _synchroniser: TimeSynchroniser[JointMessage]
    _beams: BeamInputs
    _formats: dict[str, JointTransformFormat]  # of the last transform of each joint
    _rows: ScanRows
    _transforms: dict[IntraProcessSubscription, int]  # with the number of the joint of each
    _joints: dict[str, tuple[int, FreeJoint]]  # number and joint of each topic of transforms
    _home: HomePose
    _worst: int  # state of the joints at the last pose
    _frames: FramePublisher | None
    _identity: IdentityCheck
    _pose_stamp: bytes  # of the last scan; empty: it has no pose
    _reported: object
    _alarms: AlarmRate
    _prediction: EndpointPrediction | None
    _prediction_status: Status | None

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._lock = IntraProcessManager.of(self.context).delivery_lock(self.get_namespace())
        self._status = self.diagnostics.add_status("endpoint", logged=True)
        self._inputs = InputMonitor(self, self._on_inputs_checked)
        self._poses = self._scans_refused = self._scans_incomplete = self._transforms_refused = 0
        self._refusals: dict[str, tuple[float, str]] = {}  # by joint: monotonic time [s] and reason of the latest
        self._reported = self._prediction = self._prediction_status = None
        self._last_stamp = bytes(8)
        self._published_verdict = SOUND
        self._state_published = self._has_alarm = False
        self.diagnostics.add_refresh(self._refresh_status)

    def configure(self) -> None:
        """Read the URDF and open the topics."""
        path, beams = Path(self.parameters.urdf), self.parameters.beams
        chain = load_chain(path, self.parameters.endpoint_frame, Path(beams) if beams else None)
        names = tuple(joint.name for joint in chain.joints)
        if chain.left_out:
            where = f"not on the way to {self.parameters.endpoint_frame}"
            self.get_logger().info(f"joints of the URDF that are {where}: {', '.join(chain.left_out)}")
        # With keep-all topics one joint may be ahead of another by a whole replay.
        max_open = math.inf if self.parameters.lossless else MAX_OPEN_SCANS
        self._synchroniser = TimeSynchroniser(names, max_open, self.parameters.max_wait)
        schema = schema_of_class(JointTransform)
        plain = {joint.name: TransformConstants(joint.parent, joint.child).encoded(schema) for joint in chain.joints}
        self._formats = {name: JointTransformFormat(example) for name, example in plain.items()}
        self._estimator = chain.estimator(self.parameters.acceleration_window)
        self._rows, self._transforms, self._reads_effects = ScanRows(self._estimator), {}, True
        self._home, self._worst, self._pose_stamp, self._reported = HomePose(), OK, b"", None
        self._poses = self._scans_refused = self._scans_incomplete = self._transforms_refused = 0
        self._refusals.clear()
        self._last_stamp, self._has_alarm = bytes(8), False
        false_alarm = 1.0 - (1.0 - self.parameters.false_alarm) ** len(names)
        self._alarms = AlarmRate(false_alarm, self.parameters.alarm_count)
        self._status.report(
            Level.STALE, "no complete scan yet", {"joints": ", ".join(names), "urdf": str(path), "beams": beams}
        )
        self._is_relative = self.parameters.reference == "home"
        endpoint = self.parameters.frame_prefix + self.parameters.endpoint_frame
        frame = f"{endpoint}_home" if self._is_relative else self.parameters.frame_prefix + chain.base_frame
        self._identity = IdentityCheck(self.parameters, names)
        self._writer = EndpointWriter(self._estimator, frame, relative=self._is_relative)
        self._state_writer = EndpointStateWriter(self._estimator, frame, endpoint, relative=self._is_relative)
        self._frames = FramePublisher(self, chain, self._estimator) if self.parameters.tf_rate else None
        self._pose = self._create_publisher(PoseStamped, ENDPOINT_TOPIC)
        self._pose_with_covariance = self._create_publisher(PoseWithCovarianceStamped, ENDPOINT_COVARIANCE_TOPIC)
        self._joint_states = self._create_publisher(JointState, JOINT_STATES_TOPIC)
        self._create_state_publishers()
        self._prediction = None
        if self.parameters.encoders.topic:
            frames = self.parameters.frame_prefix + chain.base_frame, endpoint
            status = self._prediction_status = self._prediction_status or self.diagnostics.add_status("prediction")
            self._prediction = EndpointPrediction(self, chain, frames, self._lock, self._with_arm, status)
        self.add_cleanup(self._inputs.clear)
        self._transforms_group = DeliveryGroup(self._on_transforms, self._lock, self._take_scans)
        self._joints = {}
        self._beams = BeamInputs(self, chain, self._estimator, self._lock)
        for number, joint in enumerate(chain.joints):
            self._subscribe(number, joint)
        steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        period_s = min(self.parameters.max_wait, LATE_CHECK_S)
        self.add_cleanup(self.destroy_timer, self.create_timer(period_s, self._close_late_scans, clock=steady_clock))
        self.add_change_service("set_home", self._on_set_home)

    def _create_publisher(self, message_type: type[Any], topic: str) -> IntraProcessPublisher:
        return IntraProcessPublisher(self, message_type, topic, result_qos(self.parameters), count_listeners=True)

    def _create_state_publishers(self) -> None:
        qos = result_qos(self.parameters)
        self._endpoint_state = IntraProcessPublisher(self, EndpointState, ENDPOINT_STATE_TOPIC, qos)
        self._throttle = ThrottledPublisher(self, EndpointState, ENDPOINT_STATE_THROTTLE_TOPIC, qos)
        self._inputs.add_output(self._endpoint_state.topic_name)

    def _subscribe(self, number: int, joint: FreeJoint) -> None:
        topic, qos = f"{joint.name}/{TRANSFORM_TOPIC}", input_qos(self.parameters)
        subscription = IntraProcessSubscription(self, JointTransform, topic, qos, self._transforms_group)
        self._inputs.add(subscription)
        self._transforms[subscription] = number
        self._joints[subscription.topic_name] = number, joint

    def activate(self) -> None:
        """Expect transforms with present stamps, and new readings of the thermometers, from now on."""
        self._inputs.start()
        with self._lock:
            self._beams.restart()
            if self._prediction is not None:
                self._prediction.restart(self._inputs.stamp_limits)

    def deactivate(self) -> None:
        """Expect no transforms; the arm may move before the next."""
        self._inputs.stop()
        with self._lock:
            self._pose_stamp = b""

    def _refresh_status(self) -> None:
        with self._lock:
            self._status.update(self._counts())
            if self._prediction is not None:
                self._prediction.refresh()

    def _with_arm(self, verdict: EndpointVerdict) -> EndpointVerdict:
        """Return the verdict on a pose, with what concerns the whole arm."""
        if self._identity.refuses:
            return self._identity.verdict
        reasons = self._beams.reason, self._home.fault(self._identity.sha256)
        return degraded_by(self._identity.degraded(verdict), "; ".join(filter(None, reasons)))

    def _on_inputs_checked(self, is_new: bool) -> None:  # noqa: FBT001  a callback
        """Report that no transform arrives, and publish the state while there is no scan."""
        with self._lock:
            silent = self._inputs.silent
            if silent and is_new:
                self._report_no_pose(silent)
            if silent and not self._state_published:
                _, joint = self._joints[self._inputs.silent_names[0]]
                verdict = EndpointVerdict(EndpointState.STATE_STALE, 0, joint.name, silent)
                self._publish_state(self._last_stamp, stamp_ns_of(self._last_stamp), verdict)
            self._state_published = False
            if self._prediction is not None:
                self._prediction.check(time.monotonic())

    def _publish_state(self, stamp: bytes, stamp_ns: int, verdict: EndpointVerdict) -> None:
        """Publish the state of a scan; a stamp of zero: there is no scan yet."""
        if not self.may_publish:  # a queued call of the timer may come after the clean-up
            return
        self._state_published = True
        if not verdict.has_pose:
            self._pose_stamp = b""
        changed = verdict != self._published_verdict
        is_due = self._throttle.is_due(stamp_ns, changed=changed)
        self._published_verdict = verdict
        if is_due or self._endpoint_state.has_subscriptions:
            if verdict.has_pose:
                self._state_writer.bound_error()
            age_s = (self.timing.now_ns() - stamp_ns) / NS if stamp_ns else math.nan
            message = self._state_writer.write(stamp, age_s, verdict)
            self._endpoint_state.publish(message)
            if is_due:
                self._throttle.publish_due(stamp_ns, message)

    def _on_transforms(self, deliveries: list[Delivery]) -> None:
        """Add transforms of some joints to their scans; publish the endpoint once a scan is complete."""
        if not self.may_publish:
            return
        by_stamp: dict[bytes, dict[str, JointMessage]] = {}
        for subscription, data in deliveries:
            number, joint = self._joints[subscription.topic_name]
            if (message := self._read_transform(number, joint, data)) is not None:
                by_stamp.setdefault(message[1][STAMP], {})[joint.name] = message
        for stamp, messages in by_stamp.items():
            stamp_ns = stamp_ns_of(stamp)
            scan = self._synchroniser.add_together(stamp_ns, messages, time.monotonic())
            if self._synchroniser.incomplete:
                self._report_incomplete_scans()
            if scan is not None:
                if constants := self._rows.fill(scan):
                    self._identity.update([each.calibration for each in constants])
                    self._state_writer.identity = self._identity.sha256
                self._estimate_endpoint(stamp, stamp_ns)

    def _read_transform(self, number: int, joint: FreeJoint, data: bytes) -> JointMessage | None:
        """Return a transform in plain CDR and its format; None: it is refused."""
        if not self._formats[joint.name].matches(data) and not (data := self._use_format_of(joint, data)):
            return None
        message = self._formats[joint.name], data
        stamp_ns = stamp_ns_of(data[STAMP])
        if stamp_ns == 0:  # the synchroniser would take it for a time that has gone back
            reason = f"the stamp of a transform {NO_TIME}; expected the time of exposure"
            self._refuse_transform(joint, reason, data[STAMP])
            return None
        if self._prediction is not None and not self._inputs.refusal(stamp_ns):
            self._prediction.add_transform(number, stamp_ns, message)
        return message

    def _use_format_of(self, joint: FreeJoint, data: bytes) -> bytes:
        """Take the format of a transform and return it in plain CDR; refuse an invalid one and return empty bytes."""
        try:
            data = schema_of_class(JointTransform).normal(data)
            found = JointTransformFormat(data)
        except TopicError as error:
            self._refuse_transform(joint, str(error), bytes(8))
            return b""
        parent, child, *_ = found.constants
        if (parent, child) != (joint.parent, joint.child):
            reason = (
                f"transforms from '{parent}' to '{child}' arrive; "
                f"expected '{joint.parent}' to '{joint.child}', as in the URDF"
            )
            self._refuse_transform(joint, reason, data[STAMP])
            return b""
        if found.constants != self._formats[joint.name].constants:  # not only other padding
            self._formats[joint.name] = found
        return data

    def _refuse_transform(self, joint: FreeJoint, reason: str, stamp: bytes) -> None:
        """Report a refused transform. If its stamp is invalid, the state has the stamp of the last complete scan."""
        self._transforms_refused += 1
        text = f"{joint.name}: {reason}"
        self._refusals[joint.name] = time.monotonic(), text
        stamp = stamp if stamp_ns_of(stamp) else self._last_stamp
        self._publish_state(stamp, stamp_ns_of(stamp), EndpointVerdict(EndpointState.STATE_LOST, 0, joint.name, text))
        self._report_no_pose(text)

    def _close_late_scans(self) -> None:
        with self._lock:
            self._synchroniser.close_before(time.monotonic() - self.parameters.max_wait)
            self._report_incomplete_scans()

    def _why_missing(self, joints: tuple[str, ...]) -> str:
        oldest_s = time.monotonic() - self.parameters.max_wait - LATE_CHECK_S
        recent = {name: text for name, (refused_s, text) in self._refusals.items() if refused_s > oldest_s}
        reasons = [recent[name] for name in joints if name in recent]
        if absent := ", ".join(name for name in joints if name not in recent):
            reasons.append(f"{absent}: transform missing from a scan that the other joints sent")
        return "; ".join(reasons)

    def _report_incomplete_scans(self) -> None:
        for stamp_ns, missing in self._synchroniser.take_incomplete().items():
            self._scans_incomplete += 1
            reason = self._why_missing(missing)
            if too_old := self._inputs.stamp_limits.fault(stamp_ns):
                reason = f"{reason}; {too_old}"
            verdict = EndpointVerdict(EndpointState.STATE_LOST, 0, missing[0], reason)
            self._publish_state(stamp_of(stamp_ns), stamp_ns, verdict)
            if not self._inputs.silent:
                self._report_refused_scan(verdict)

    def _expect_effects(self, stamp_ns: int, last_ns: int) -> None:
        """Read the fault effects of the next scan, or not: only a published state needs them.

        ``stamp_ns``: of this scan; ``last_ns``: of the one before it.
        """
        is_due = self._endpoint_state.has_subscriptions or (
            self._throttle.has_subscriptions and may_be_due_next(stamp_ns, last_ns)
        )
        if is_due != self._reads_effects:
            self._reads_effects = is_due
            for subscription in self._transforms:
                subscription.reads_whole = is_due

    def _take_scans(self, scans: Sequence[PreparedScan]) -> Callable[[], bool] | None:
        """Return how to estimate prepared scans and their endpoint in one call, see ``DeliveryGroup.take``.

        None: they are not one scan of each joint with one accepted stamp, an older scan is open, accelerometers need
        the scan, or there is no pass for their transforms.
        """
        header = scans[0].data[: STAMP.stop]
        for scan in scans:
            if scan.data[: STAMP.stop] != header or scan.taker is None or scan.taker.closed:
                return None
        stamp = header[STAMP]
        stamp_ns = stamp_ns_of(stamp)
        if (
            len(scans) != len(self._transforms)
            or not (self.may_publish and stamp_ns and header.startswith(LITTLE_ENDIAN))
            or self._beams.vibrates
            or not self._synchroniser.is_complete_at_once(stamp_ns)
            or not self._inputs.accepts(stamp_ns)
            or (found := self._rows.find_pass(scans, self._transforms)) is None
        ):
            return None
        self._beams.update(stamp_ns)
        return partial(self._estimate_taken, found, stamp, stamp_ns)

    def _estimate_taken(self, arm_pass: ArmPass, stamp: bytes, stamp_ns: int) -> bool:
        """Estimate prepared scans and the endpoint, and publish it; return False where the messages are needed.

        Nothing may raise before the scans are estimated.
        """
        if (worst := arm_pass.run(stamp_ns)) is None:
            return False
        if self._prediction is not None:
            for number, message in enumerate(self._rows.messages()):
                self._prediction.add_transform(number, stamp_ns, message)
        self._end_scan(stamp, stamp_ns, worst)
        self._synchroniser.close_complete(stamp_ns)
        now_s = time.monotonic()
        for subscription in self._transforms:
            subscription.watch.record(now_s)
        return True

    def _estimate_endpoint(self, stamp: bytes, stamp_ns: int) -> None:
        """Estimate the endpoint of the rows, unless the stamp is refused, and publish it."""
        refusal = "" if self._inputs.accepts(stamp_ns) else self._inputs.refusal(stamp_ns)
        worst = UNUSABLE
        if not refusal:
            self._beams.update(stamp_ns)
            worst = self._estimator.estimate_rows(stamp_ns)
        self._end_scan(stamp, stamp_ns, worst, refusal)

    def _end_scan(self, stamp: bytes, stamp_ns: int, worst: int, refusal: str = "") -> None:
        """Publish the endpoint of a complete scan, or why there is none.

        ``worst``: result of ``EndpointEstimator.estimate_rows``; ``refusal``: why the scan must not be used.
        """
        last_ns = stamp_ns_of(self._last_stamp)
        self._last_stamp = stamp
        if refusal:
            self._refuse_scan(stamp, stamp_ns, EndpointVerdict(EndpointState.STATE_LOST, 0, "", refusal))
        elif worst < 0:
            self._refuse_scan(stamp, stamp_ns, unusable_verdict(self._rows.statuses()))
        elif self._identity.refuses:
            self._refuse_scan(stamp, stamp_ns, self._identity.verdict)
        else:
            self._publish_endpoint(stamp, stamp_ns, worst)
        self._expect_effects(stamp_ns, last_ns)

    def _publish_endpoint(self, stamp: bytes, stamp_ns: int, worst: int) -> None:
        identity = self._identity
        if self._prediction is not None:
            self._prediction.use_scan(self._estimator, identity.sha256)
        self._worst = worst
        self._publish_pose(stamp)
        verdict = self._verdict_of_pose()
        self._publish_state(stamp, stamp_ns, verdict)
        self.timing.record(stamp_ns)
        self._poses += 1
        excess = self._alarms.excess(self._scan_number()) if self._has_alarm else ""
        if self._reported != (key := (verdict, excess)):
            text = verdict.reason or "ok"
            level = Level.ERROR if excess else Level.WARN if verdict.reason else Level.OK
            self._status.report(level, f"{text}; {excess}" if excess else text, self._counts())
            self._reported, self._has_alarm = key, bool(excess)

    def _publish_pose(self, stamp: bytes) -> None:
        self._pose_stamp = stamp
        if self._is_relative:
            if self._home.pose is None:
                self._take_home()
            self._home.relate(self._estimator)
        writer = self._writer
        self._pose.publish(writer.pose.write(stamp))
        if self._pose_with_covariance.has_subscriptions:
            self._pose_with_covariance.publish(writer.write_pose_with_covariance(stamp))
        if self._joint_states.has_subscriptions:
            self._joint_states.publish(writer.joint_states.write(stamp))
        if self._frames is not None and self._frames.publisher.has_subscriptions:
            self._frames.publish(stamp)

    def _take_home(self) -> EndpointVerdict:
        """Take the last pose as home, and return the verdict on it."""
        self._home.forget()
        verdict = self._verdict_of_pose()
        self._home.take(self._estimator.pose, verdict.reason, self._identity.sha256)
        return verdict

    def _verdict_of_pose(self) -> EndpointVerdict:
        """Return the verdict on the last scan, which has a pose."""
        identity, is_ok = self._identity, self._worst == OK
        is_sound = is_ok and identity.verdict is SOUND and not self._home.fault(identity.sha256)
        if is_sound and not self._beams.reason:
            return SOUND
        return self._with_arm(SOUND if is_ok else degraded_verdict(self._rows.statuses()))

    def _refuse_scan(self, stamp: bytes, stamp_ns: int, verdict: EndpointVerdict) -> None:
        self._scans_refused += 1
        self._publish_state(stamp, stamp_ns, verdict)
        self._report_refused_scan(verdict)

    def _scan_number(self) -> int:
        return self._poses + self._scans_refused + self._scans_incomplete

    def _report_refused_scan(self, verdict: EndpointVerdict) -> None:
        """Report a scan without a pose if the reason has changed: as an error if false alarms do not explain it."""
        number = self._scan_number()
        if verdict.is_waiting:
            self._alarms.forget()
        self._has_alarm = not verdict.is_waiting and self._alarms.add(number)
        if self._reported != (key := (verdict, self._has_alarm)):
            self._reported = key
            excess = self._alarms.excess(number)
            text = f"no pose: {verdict.reason}" + (f"; {excess}" if excess else "")
            self._status.report(Level.ERROR if self._has_alarm else Level.WARN, text, self._counts())

    def _report_no_pose(self, reason: str) -> None:
        self._status.report(Level.ERROR, f"no pose: {reason}", self._counts())
        self._reported = None

    def _counts(self) -> dict[str, Value]:
        present, names = self._beams.temperatures.kelvins, self._beams.temperatures.names
        kelvins = {f"temperature {name} [K]": round(present.get(name, math.nan), 3) for name in names}
        scans = {"scans_refused": self._scans_refused, "scans_incomplete": self._scans_incomplete}
        return {"poses": self._poses, **scans, "transforms_refused": self._transforms_refused, **kelvins}

    def _on_set_home(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            if not self._is_relative:
                response.message = "reference is 'absolute'; start the node with reference:=home for relative poses"
            elif not self._pose_stamp:
                response.message = "there is no pose now to take as home"
            else:
                reason = self._take_home().reason
                response.success, response.message = True, "home is the endpoint's last pose"
                if reason:
                    response.message += f", which is not OK ({reason}): poses relative to it are DEGRADED"
        return response


def main() -> int:
    """Run the node as a program."""
    return run_node(ChainNode)
