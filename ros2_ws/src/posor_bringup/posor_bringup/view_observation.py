# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The state of an arm by the newest messages: endpoint, measured joints, and whether each of them can be trusted.

Silence is a fault: a joint or an endpoint without new messages is reported as silent, with its last numbers left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.chain.commissioning_record import load_record
from posor.chain.identity import NOT_STATED, ArmIdentity, file_sha256
from posor.errors import TopicError
from posor.estimation.settings import residual_limit
from posor.messages.joint_position import joint_position
from posor.model.fault import USABLE_STATES, State
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE, ENDPOINT_STATE_TOPIC
from posor_msgs.msg import EndpointState

from posor_bringup.view_events import NOTE, WARNING, Cause, causes_of_state, merge_causes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray

    from posor_bringup.view_messages import ArmTopics, Message, MessageStore

SILENCE_S = 0.3  # time without a message after which a topic is silent; below 10 Hz, three median periods
PERIODS = 5
"""Number of last periods whose median is used, so that an earlier pause does not count; before, ``SILENCE_S`` holds."""
FIRST_MESSAGE_S = 1.0  # time in which a running joint must be heard of for the first time; discovery takes a part of it
DIAGNOSTICS_SILENCE_S = 3.0  # the same for the diagnostics of a node, which come once a second
STATES = {**{int(state): state.name for state in State}, int(EndpointState.STATE_STALE): "STALE"}
SILENT, NO_MESSAGE, NO_STATE = "SILENT", "NO MESSAGE", "NO STATE"
"""Further states, which follow from the absence of messages; the last one: a bag without ``endpoint/state``."""
LAG_S = 2.0  # time after which a report is a warning of its own: a report may be that on a fault that is over
SILENT_NODE = " has ended or hangs: no diagnostics for "  # in the sentence on a node that is silent
USABLE = tuple(state.name for state in USABLE_STATES)  # states of a joint whose pose may be used
GOOD = (State.OK.name, NO_MESSAGE)  # states of a joint that need no cause
_POSE = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True)
class EndpointView:
    """The newest endpoint."""

    stamp_ns: int  # of its scan [ns]
    received_ns: int  # when it was received or recorded (system clock) [ns]
    latency_s: float  # from the stamp to the reception of the message [s]; NaN: the stamp is invalid
    age_s: float  # from the stamp to the publication [s]; NaN: not known
    frame: str  # in which the pose is
    pose: FloatArray  # (7,): x, y, z [m], unit quaternion x, y, z, w
    covariance: FloatArray  # (6, 6), the sum of both parts; NaN: not known
    protection_level: FloatArray  # (6,) [m], [rad]; NaN: not known
    protection_causes: tuple[str, ...] = ()  # joint and cause that set each level; empty: not known


@dataclass(frozen=True)
class ArmScan:
    """The joints at the newest stamp of which all joints that are heard of have a transform."""

    stamp_ns: int  # [ns]
    poses: FloatArray  # (j, 7), as ``EndpointEstimator.poses``; NaN: not usable
    covariances_random: FloatArray  # (j, 6, 6)
    covariances_systematic: FloatArray  # (j, 6, 6)
    thetas: FloatArray  # (j,) [rad]
    residuals: FloatArray  # chi-square of each joint divided by its limit, (j,); NaN without redundancy
    encoders: FloatArray  # angle of each joint by its encoder [rad], (j,); NaN without


@dataclass(frozen=True)
class Observation:
    """All that the page shows at one time."""

    time_ns: int  # of the observation, of the clock of ``EndpointView.received_ns`` [ns]
    is_fresh: bool  # whether messages about the endpoint arrive; otherwise nothing else is fresh
    state: str  # of the endpoint
    causes: tuple[Cause, ...] = ()  # for which the endpoint is not OK, by its state or by its silence
    reports: tuple[Cause, ...] = ()  # further warnings, and what the page lacks
    details: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # sentences of each joint's nodes
    endpoint: EndpointView | None = None  # None: there is no message yet
    scan: ArmScan | None = None  # None: there is no such stamp, or it is too old
    joints: Mapping[str, str] = field(default_factory=dict)  # state of each joint


class Observer:
    """Makes observations of one arm."""

    def __init__(self, topics: ArmTopics, store: MessageStore, joints: Sequence[str], arm: ArmFile) -> None:
        """Observe the arm of these topics; ``joints`` in the order of the chain; ``arm``: which the page draws.

        Raises CalibrationError: a file of the arm cannot be read, or its commissioning record is invalid.
        """
        self._topics, self._store, self._joints = topics, store, joints
        self._endpoint_frame = arm.endpoint_frame
        self._files = ArmIdentity({}, file_sha256(arm.urdf), file_sha256(arm.beams))
        self._record = "" if arm.commissioning is None else load_record(arm.commissioning).parts().record
        self._prefix = topics.endpoint.rpartition("/endpoint/")[0]
        self._reported: dict[tuple[str, str], float] = {}  # when each report of a node was seen first
        self._has_state = topics.types[topics.endpoint] == ENDPOINT_STATE

    def observe(self, now_s: float, time_ns: int) -> Observation:
        """Return the state of the arm at a time, by the clock that stamped the arrival of the messages, and in UTC."""
        topic = self._topics.endpoint
        messages = self._store.messages(topic)
        values = self._store.values(topic, messages[-1]) if messages else None
        if values is None:
            cause = Cause(NO_MESSAGE, self._store.refused or f"no message yet on {topic}")
            joints = dict.fromkeys(self._joints, NO_MESSAGE)
            return Observation(time_ns, is_fresh=False, state=NO_MESSAGE, causes=(cause,), joints=joints)
        endpoint = self._endpoint(values, messages[-1])
        if self._silence_s(topic, now_s) > 0.0:
            cause = Cause("STALE", f"no message on {topic}: chain_node has ended, hangs or is not active")
            joints = dict.fromkeys(self._joints, "STALE")
            return Observation(
                time_ns, is_fresh=False, state="STALE", causes=(cause,), endpoint=endpoint, joints=joints
            )
        joints = {name: self._joint(name, values, now_s) for name in self._joints}
        state = _state_name(values["state"]) if self._has_state else NO_STATE
        causes = self._causes(state, values, joints)
        details = {name: self._diagnostics(f"{self._prefix}/{name}", now_s) for name in self._joints}
        scan = self._scan(joints)
        reports = self._reports(state, causes, details, now_s, self._other_arm(values))
        if scan is not None and (
            without := [n for n, a in zip(self._joints, scan.encoders, strict=True) if np.isnan(a)]
        ):
            reports.append(Cause(NOTE, "no encoder: the nominal arm has the measured angle there", tuple(without)))
        return Observation(
            time_ns,
            is_fresh=True,
            state=state,
            causes=causes,
            reports=tuple(reports),
            details=details,
            endpoint=endpoint,
            scan=scan,
            joints=joints,
        )

    def state_of(self, values: Mapping[str, Any]) -> tuple[str, list[Cause]]:
        """Return name and causes of an ``endpoint/state``."""
        state = _state_name(values["state"])
        return state, causes_of_state(state, values["reason"], values["joint"], self._joints)

    def _causes(self, state: str, values: Mapping[str, Any], joints: Mapping[str, str]) -> tuple[Cause, ...]:
        """Return why the endpoint is not OK; a bag without states has only the joints'."""
        if state != NO_STATE:
            return tuple(self.state_of(values)[1])
        found = [Cause(each, "state of the joint", (name,)) for name, each in joints.items() if each not in GOOD]
        return tuple(merge_causes(found))

    def _reports(
        self, state: str, causes: Iterable[Cause], details: Mapping[str, Sequence[str]], now_s: float, other_arm: str
    ) -> list[Cause]:
        """Return reports of nodes that no cause explains, another arm, the refused message, and what a bag lacks."""
        explained = {name for cause in causes for name in cause.joints}
        found = [
            Cause(WARNING, text, (name,)) for name, texts in details.items() if name not in explained for text in texts
        ]
        if other_arm:
            found.append(Cause(WARNING, f"{other_arm}: the drawing and its deviation are not those of the arm"))
        if state in USABLE:
            found += [Cause(WARNING, text) for text in self._diagnostics(f"{self._prefix}/chain_node", now_s)]
        self._reported = {key: since_s for key, since_s in self._reported.items() if since_s <= now_s}
        self._reported = {cause.key: self._reported.get(cause.key, now_s) for cause in found}
        found = [cause for cause in found if now_s - self._reported[cause.key] >= LAG_S]
        if self._store.refused:
            found.append(Cause(WARNING, f"a message was refused: {self._store.refused}"))
        if state == NO_STATE:
            text = f"{self._topics.endpoint} says nothing about faults; {ENDPOINT_STATE_TOPIC} is not in the bag"
            found.append(Cause(NO_STATE, text))
        return merge_causes(found)

    def _other_arm(self, values: Mapping[str, Any]) -> str:
        """Return how the arm that runs differs from that of the page; empty: it does not, or does not state it."""
        if not self._has_state:
            return ""
        if (frame := values["child_frame_id"]) not in ("", self._endpoint_frame):
            return f"the endpoint of the arm is '{frame}', that of the page '{self._endpoint_frame}'"
        ids = {}
        for name in self._joints:
            topic = self._topics.transforms[name]
            messages = self._store.messages(topic)
            found = self._store.values(topic, messages[-1]) if messages else None
            ids[name] = NOT_STATED if found is None else found.get("calibration", NOT_STATED)
        stated = values.get("identity", "")
        if not stated or NOT_STATED in ids.values():
            return ""
        if self._files.with_calibrations(ids, self._record).sha256 == stated:
            return ""
        return "the arm runs with another URDF, beams file or commissioning record than the page"

    def _silence_s(self, topic: str, now_s: float) -> float:
        """Return for how long a topic with messages has been silent [s]; 0: it is not."""
        messages = self._store.messages(topic)
        arrivals_s = [each.arrival_s for each in messages][-PERIODS - 1 :]
        period_s = float(np.median(np.diff(arrivals_s))) if len(arrivals_s) > PERIODS else 0.0
        silence_s = now_s - messages[-1].arrival_s
        return silence_s if silence_s > max(SILENCE_S, 3.0 * period_s) else 0.0

    def _endpoint(self, values: Mapping[str, Any], message: Message) -> EndpointView:
        pose = "pose.pose" if "pose.pose.position.x" in values else "pose"
        parts = [values[name] for name in ("covariance_random", "covariance_systematic") if name in values]
        parts = parts or [values.get("pose.covariance", [np.nan] * 36)]
        return EndpointView(
            message.stamp_ns,
            message.received_ns,
            (message.received_ns - message.stamp_ns) / NS if message.stamp_ns else np.nan,
            values.get("age", np.nan) if message.stamp_ns else np.nan,
            values["header.frame_id"],
            np.array([values[f"{pose}.{part}"] for part in _POSE]),
            np.sum(parts, axis=0).reshape(6, 6),
            np.array(values.get("protection_level") or [np.nan] * 6),
            tuple(values.get("protection_causes", ())),
        )

    def _joint(self, name: str, endpoint: Mapping[str, Any], now_s: float) -> str:
        """Return the state of a joint from its transform and from the endpoint's state."""
        topic = self._topics.transforms[name]
        messages = self._store.messages(topic)
        values = self._store.values(topic, messages[-1]) if messages else None
        if values is None:
            since_s = self._store.since_s
            state = SILENT if since_s is not None and now_s - since_s > FIRST_MESSAGE_S else NO_MESSAGE
        else:
            state = SILENT if self._silence_s(topic, now_s) > 0.0 else _state_name(values["state"])
        if endpoint.get("joint") == name and endpoint["state"] > EndpointState.STATE_DEGRADED and state in USABLE:
            state = _state_name(endpoint["state"])
        return state

    def _diagnostics(self, prefix: str, now_s: float) -> tuple[str, ...]:
        """Return the names of silent nodes under a prefix, then the reports besides OK of the others."""
        found: dict[str, None] = {}  # a set that keeps its order
        for name, status in sorted(self._store.statuses.items()):
            if name.partition(":")[0] != prefix and not name.startswith(f"{prefix}/"):
                continue
            node = name.partition(":")[0].rpartition("/")[2]
            if now_s - status.arrival_s > DIAGNOSTICS_SILENCE_S:
                found[f"{node}{SILENT_NODE}{now_s - status.arrival_s:.0f} s"] = None
            elif status.level:
                found[f"{node}: {status.text}"] = None
        return tuple(sorted(found, key=lambda text: SILENT_NODE not in text))

    def _scan(self, states: Mapping[str, str]) -> ArmScan | None:
        """Return the newest scan of which every joint that is heard of has a transform."""
        by_stamp = [
            {}
            if states[name] in (SILENT, NO_MESSAGE)
            else {each.stamp_ns: each for each in self._store.messages(self._topics.transforms[name])}
            for name in self._joints
        ]
        heard = [set(stamps) for stamps in by_stamp if stamps]
        common = set.intersection(*heard) if heard else set()
        if not common:
            return None
        stamp_ns = max(common)
        joints = [
            self._store.values(self._topics.transforms[name], stamps[stamp_ns]) if stamps else None
            for name, stamps in zip(self._joints, by_stamp, strict=True)
        ]
        unknown = np.full((6, 6), np.nan)

        def covariances(part: str) -> FloatArray:
            return np.array([unknown if each is None else np.reshape(each[part], (6, 6)) for each in joints])

        return ArmScan(
            stamp_ns,
            np.array([_pose(values, states[name]) for name, values in zip(self._joints, joints, strict=True)]),
            covariances("covariance_random"),
            covariances("covariance_systematic"),
            np.array([np.nan if each is None else each["native"][5] for each in joints]),
            np.array([self._residual(name, each) for name, each in zip(self._joints, joints, strict=True)]),
            np.array([self._encoder(name, stamp_ns) for name in self._joints]),
        )

    def _residual(self, joint: str, values: Mapping[str, Any] | None) -> float:
        """Return chi-square of a transform divided by its limit; NaN without redundant readings."""
        if values is None or not values["redundancy"]:
            return np.nan
        return float(values["residual"] / residual_limit(values["redundancy"], self._topics.false_alarms[joint]))

    def _encoder(self, joint: str, stamp_ns: int) -> float:
        """Return the angle of a joint's encoder at a time [rad], between two messages if necessary; NaN without."""
        topic, name = self._topics.encoders[joint]
        messages = self._store.messages(topic)
        before = [each for each in messages if each.stamp_ns <= stamp_ns][-1:]
        after = [each for each in messages if each.stamp_ns >= stamp_ns][:1]
        if not (before and after):
            return np.nan
        ends = [self._store.values(topic, each) for each in (before[0], after[0])]
        first, last = (np.nan if values is None else _position(values, name) for values in ends)
        gap_ns = after[0].stamp_ns - before[0].stamp_ns
        return first + (last - first) * (stamp_ns - before[0].stamp_ns) / gap_ns if gap_ns else first


def _pose(values: Mapping[str, Any] | None, state: str) -> list[float]:
    """Return the pose of a transform; NaN if it must not be used, by the state of its joint or by its own."""
    if values is None or state not in USABLE or values["state"] > State.DEGRADED:
        return [np.nan] * len(_POSE)
    return [values[f"pose.{part}"] for part in _POSE]


def _state_name(state: int) -> str:
    return STATES.get(state, f"unknown state {state}")


def _position(values: Mapping[str, Any], name: str) -> float:
    """Return the position of a joint in a JointState [rad]; NaN: it has none."""
    try:
        return joint_position(list(values["name"]), list(values["position"]), name)
    except TopicError:
        return np.nan
