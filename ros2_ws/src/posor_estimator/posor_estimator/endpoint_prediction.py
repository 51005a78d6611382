# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of chain_node: readings of encoders in, the endpoint at their stamps and a lead time later out."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from nav_msgs.msg import Odometry
from posor.chain.encoder_filter import DISAGREES, USED, WAITS
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.chain.joint_measurements import FAULT_TEXTS
from posor.errors import TopicError
from posor.messages.endpoint_messages import COVARIANCE_POSE, EndpointStateWriter, EndpointVerdict, MessageWriter
from posor.messages.joint_transform import JointTransformFormat, stamp_ns_of, stamp_of
from posor.messages.message_table import LEAD
from posor.model.fault import USABLE_STATES, State
from posor.numerics.stamps import NO_TIME, NS
from posor.ros_names import ODOMETRY, PREDICTED_AHEAD_TOPIC, PREDICTED_STATE_TOPIC, PREDICTED_TOPIC
from posor_msgs.msg import EndpointState
from posor_ros.diagnostics import Level
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.qos import input_qos, result_qos
from sensor_msgs.msg import JointState

from posor_estimator.endpoint_verdict import SOUND, JointStatus, degraded_by, degraded_verdict, joined_reasons
from posor_estimator.position_reader import PositionReader

if TYPE_CHECKING:
    from collections.abc import Callable
    from threading import RLock

    from posor.chain.encoder_filter import Twists
    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import ChainParameters
    from posor.numerics.array_types import FloatArray
    from posor_ros.diagnostics import Status, Value
    from posor_ros.freshness import StampLimits
    from posor_ros.lifecycle_node import PosorNode

JointMessage: TypeAlias = tuple[JointTransformFormat, bytes]
MOST_WAITING = 256  # transforms of a joint that wait for readings of its encoder; then the oldest are dropped
UNUSABLE_STATES = {int(each): f" (the newest is {each.name})" for each in State if each not in USABLE_STATES}


class EndpointPrediction:
    """Publishes the predicted endpoint while chain_node is configured; the caller holds the lock but in callbacks."""

    def __init__(
        self,
        node: PosorNode[ChainParameters],
        chain: Chain,
        frames: tuple[str, str],
        lock: RLock,
        with_arm: Callable[[EndpointVerdict], EndpointVerdict],
        status: Status,
    ) -> None:
        """Open the topics.

        ``frames``: of the base and of the endpoint; ``with_arm``: adds
        what concerns the whole arm to a verdict; ``status``: line of the diagnostics. Raises ParameterError: a
        parameter does not fit the joints.
        """
        parameters = node.parameters
        self._node, self._lock, self._with_arm = node, lock, with_arm
        self._predictor = EndpointPredictor(chain, parameters.encoders)
        self._reader = PositionReader(self._predictor.names)
        names = self._predictor.joints
        self._formats: list[JointTransformFormat | None] = [None] * len(names)  # of the rows
        self._waiting: list[deque[tuple[int, JointMessage]]] = [deque(maxlen=MOST_WAITING) for _ in names]
        self._joints = [JointStatus(name, 0, 0) for name in names]
        self._newest_states = dict.fromkeys(names, 0)  # of the newest transform of each joint, usable or not
        self._stamp = bytes(8)
        self._verdict, self._used = SOUND, 0
        self._key: object = None
        self._limits: StampLimits | None = None
        self.counts: dict[str, Value] = dict.fromkeys(("predictions", "readings_refused", "transforms_refused"), 0)
        qos = result_qos(parameters)
        self._publisher, self._ahead_publisher = (
            IntraProcessPublisher(node, Odometry, topic, qos) for topic in (PREDICTED_TOPIC, PREDICTED_AHEAD_TOPIC)
        )
        self._state_publisher = IntraProcessPublisher(node, EndpointState, PREDICTED_STATE_TOPIC, qos)
        self._lead_ns = round(parameters.encoders.lead_time * NS)
        present, ahead = self._predictor.present, self._predictor.ahead
        self._covariances = np.zeros((2, 6, 6))
        self._writer, self._ahead_writer = (
            _odometry(frames, own, covariance, twist)
            for own, covariance, twist in (
                (present, self._covariances[0], self._predictor.twist),
                (ahead, self._covariances[1], self._predictor.twist_ahead),
            )
        )
        self._state_writer = EndpointStateWriter(present, *frames, relative=False)
        self._status = status
        self._status.report(Level.STALE, "no reading of the encoders yet", self.counts)
        subscription = IntraProcessSubscription(
            node, JointState, parameters.encoders.topic, input_qos(parameters), self._on_reading
        )
        self._subscription = subscription

    def restart(self, limits: StampLimits) -> None:
        """Expect readings within these limits from now on; those before do not count."""
        self._limits = limits
        self._subscription.watch.restart(time.monotonic())
        for waiting in self._waiting:
            waiting.clear()

    def add_transform(self, joint: int, stamp_ns: int, message: JointMessage) -> None:
        """Use a transform that is not refused, once the readings have reached its stamp."""
        waiting, (kind, data) = self._waiting[joint], message
        if waiting and stamp_ns < waiting[-1][0]:  # time went back
            waiting.clear()
        self._newest_states[self._joints[joint].name] = state = kind.read_state(data)[0]
        if state in USABLE_STATES:
            waiting.append((stamp_ns, message))
            self._use_waiting(joint)

    def use_scan(self, estimator: EndpointEstimator, identity: str) -> None:
        """Take shared terms, beams and their accelerations of a complete scan; ``identity``: of the arm."""
        self._predictor.use_arm_of(estimator)
        self._state_writer.identity = identity

    def _use_waiting(self, joint: int) -> None:
        waiting = self._waiting[joint]
        while waiting:
            stamp_ns, (kind, data) = waiting[0]
            if kind is not self._formats[joint]:
                self._formats[joint] = kind
                self._predictor.use_row_layout(joint, kind.row_layout)
            self._predictor.rows[joint, LEAD : LEAD + kind.size].data[:] = data[: kind.size]
            if (result := self._predictor.use_row(joint, stamp_ns)) == WAITS:
                return
            waiting.popleft()
            if result == USED:
                self._joints[joint] = JointStatus(self._joints[joint].name, *kind.read_state(data))
                self._used += 1
            elif result > 0:
                self._refuse("transforms_refused", f"{self._joints[joint].name} {FAULT_TEXTS[result]}")

    def _on_reading(self, data: bytes) -> None:
        """Predict the endpoint at a reading of the encoders."""
        with self._lock:
            if not self._node.may_publish or self._limits is None:
                return
            try:
                stamp, angles = self._reader.read(data)
            except TopicError as error:
                self._refuse("readings_refused", f"{self._subscription.topic_name}: {error}")
                return
            stamp_ns = stamp_ns_of(stamp)
            fault = f"the stamp of a reading {NO_TIME}" if stamp_ns == 0 else self._limits.fault(stamp_ns)
            if fault:
                self._refuse("readings_refused", f"{self._subscription.topic_name}: {fault}")
                return
            for joint in range(len(self._waiting)):
                self._use_waiting(joint)
            self._publish(stamp, stamp_ns, usable=self._predictor.read(stamp_ns, angles))

    def _publish(self, stamp: bytes, stamp_ns: int, *, usable: bool) -> None:
        self._stamp = stamp
        verdict = self._find_verdict(usable=usable)
        if verdict.has_pose:
            if self._publisher.has_subscriptions:
                own = self._predictor.present
                np.add(own.covariance_random, own.covariance_systematic, self._covariances[0])
                self._publisher.publish(self._writer.write(stamp))
            if self._lead_ns and self._ahead_publisher.has_subscriptions:
                own = self._predictor.ahead
                np.add(own.covariance_random, own.covariance_systematic, self._covariances[1])
                self._ahead_publisher.publish(self._ahead_writer.write(stamp_of(stamp_ns + self._lead_ns)))
            self.counts["predictions"] += 1  # type: ignore[operator]
        self._publish_state(stamp, stamp_ns, verdict)

    def _publish_state(self, stamp: bytes, stamp_ns: int, verdict: EndpointVerdict) -> None:
        if self._state_publisher.has_subscriptions:
            age_s = (self._node.timing.now_ns() - stamp_ns) / NS if stamp_ns else math.nan
            self._state_publisher.publish(self._state_writer.write(stamp, age_s, verdict))

    def _find_verdict(self, *, usable: bool) -> EndpointVerdict:
        """Return whether the last prediction may be used, and report a change."""
        predictor = self._predictor
        arm = self._with_arm(SOUND)
        disagrees = self._used if DISAGREES in predictor.faults else 0
        states = tuple(joint.state for joint in self._joints), tuple(self._newest_states.values())
        publishers = self._subscription.publishers
        key = predictor.faults.tobytes(), predictor.held.tobytes(), states, arm, disagrees, publishers
        if key != self._key:
            self._key = key
            self._verdict = self._with_arm(self._of_joints(usable=usable)) if arm.has_pose else arm
            level = Level.ERROR if not self._verdict.has_pose else Level.WARN if self._verdict.reason else Level.OK
            self._status.report(level, self._verdict.reason or "ok", self.counts)
        return self._verdict

    def _of_joints(self, *, usable: bool) -> EndpointVerdict:
        predictor = self._predictor
        if not usable:
            reasons = predictor.reasons()
            newest = {name: UNUSABLE_STATES.get(state, "") for name, state in self._newest_states.items()}
            text = joined_reasons((joint, f"{reason}{newest[joint]}") for joint, reason in reasons.items())
            if (count := self._subscription.publishers) > 1:  # of other joints, or the cause
                text += f"; {count} publishers on {self._subscription.topic_name}"
            return EndpointVerdict(EndpointState.STATE_LOST, 0, next(iter(reasons), ""), text)
        verdict = degraded_verdict(self._joints) if any(joint.state for joint in self._joints) else SOUND
        if held := predictor.held_joints:
            gap = self._node.parameters.encoders.gap
            text = f"{', '.join(held)}: carried on by encoders, no transform for more than {gap:g} s"
            verdict = degraded_by(verdict, text, held[0])
        return verdict

    def _refuse(self, what: str, text: str) -> None:
        self.counts[what] += 1  # type: ignore[operator]
        self._key = None
        self._status.report(Level.ERROR, text, self.counts)

    def check(self, now_s: float) -> None:
        """Report that no readings arrive; ``now_s``: steady time."""
        limit_s = self._node.parameters.freshness.max_silence
        if silent := self._subscription.watch.silence(now_s, limit_s):
            self._key = None
            self._status.report(Level.ERROR, f"no prediction: {silent}", self.counts)
            verdict = EndpointVerdict(EndpointState.STATE_STALE, 0, "", silent)
            self._publish_state(self._stamp, stamp_ns_of(self._stamp), verdict)

    def refresh(self) -> None:
        """Update the counts in the diagnostics."""
        self._status.update(self.counts)


def _odometry(
    frames: tuple[str, str], estimator: EndpointEstimator, covariance: FloatArray, twist: Twists
) -> MessageWriter:
    numbers = {
        COVARIANCE_POSE: estimator.pose,
        "pose.covariance": covariance,
        "twist.twist.linear.x": twist.twist,
        "twist.covariance": twist.covariance,
    }
    return MessageWriter(ODOMETRY, {"header.frame_id": frames[0], "child_frame_id": frames[1]}, numbers)
