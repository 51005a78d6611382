"""The state of an arm by the newest messages: endpoint, measured joints, and whether each of them can be trusted.

Silence is a fault: a joint or an endpoint without new messages is reported as silent, with its last numbers left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.model.fault import USABLE_STATES, Fault, State
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE_TOPIC
from posor_msgs.msg import EndpointState

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
USABLE = tuple(state.name for state in USABLE_STATES)  # states of a joint whose pose may be used
_POSE = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True)
class Health:
    """State of a joint or of the endpoint, and the sentences on its faults."""

    state: str
    sentences: tuple[str, ...] = ()


@dataclass(frozen=True)
class EndpointView:
    """The newest endpoint."""

    stamp_ns: int  # of its scan [ns]
    latency_s: float  # from the stamp to the reception of the message [s]
    age_s: float  # from the stamp to the publication [s]; NaN: not known
    frame: str  # in which the pose is
    pose: FloatArray  # (7,): x, y, z [m], unit quaternion x, y, z, w
    covariance: FloatArray  # (6, 6), the sum of both parts; NaN: not known
    protection_level: FloatArray  # (6,) [m], [rad]; NaN: not known
    protection_causes: tuple[str, ...] = ()  # joint and cause that set each level; empty: not known


@dataclass(frozen=True)
class ArmScan:
    """The joints at the newest stamp of which all have a transform."""

    stamp_ns: int  # [ns]
    poses: FloatArray  # (j, 7), as ``EndpointEstimator.poses``; NaN: not usable
    covariances_random: FloatArray  # (j, 6, 6)
    covariances_systematic: FloatArray  # (j, 6, 6)
    thetas: FloatArray  # (j,) [rad]
    residuals: FloatArray  # chi-square of each joint divided by its redundancy, (j,); zero without redundancy
    encoders: FloatArray  # angle of each joint by its encoder [rad], (j,); NaN without


@dataclass(frozen=True)
class Observation:
    """All that the page shows at one time."""

    is_fresh: bool  # whether messages about the endpoint arrive; otherwise nothing else is fresh
    overall: Health  # health of the endpoint
    endpoint: EndpointView | None = None  # None: there is no message yet
    scan: ArmScan | None = None  # None: there is no stamp with a transform of every joint, or it is too old
    joints: Mapping[str, Health] = field(default_factory=dict)  # of each joint


class Observer:
    """Makes observations of one arm."""

    def __init__(self, topics: ArmTopics, store: MessageStore, joints: Sequence[str]) -> None:
        """Observe the arm of these topics; ``joints`` in the order of the chain."""
        self._topics, self._store, self._joints = topics, store, joints
        self._prefix = topics.endpoint.rpartition("/endpoint/")[0]
        self._has_state = topics.endpoint.endswith(f"/{ENDPOINT_STATE_TOPIC}")

    def observe(self, now_s: float) -> Observation:
        """Return the state of the arm at a time of the clock that stamped the arrival of the messages."""
        topic = self._topics.endpoint
        messages = self._store.messages(topic)
        values = self._store.values(topic, messages[-1]) if messages else None
        if values is None:
            reason = self._store.refused or f"no message yet on {topic}"
            joints = {name: Health(NO_MESSAGE) for name in self._joints}
            return Observation(is_fresh=False, overall=Health(NO_MESSAGE, (reason,)), joints=joints)
        endpoint = self._endpoint(values, messages[-1])
        if (silence_s := self._silence_s(topic, now_s)) > 0.0:
            health = Health("STALE", (f"no message on {topic} for {silence_s:.1f} s",))
            joints = {name: Health("STALE") for name in self._joints}
            return Observation(is_fresh=False, overall=health, endpoint=endpoint, joints=joints)
        joints = {name: self._joint(name, values, now_s) for name in self._joints}
        scan, overall = self._scan(now_s), self._overall(values, now_s)
        if scan is not None and (
            without := [n for n, a in zip(self._joints, scan.encoders, strict=True) if np.isnan(a)]
        ):
            sentence = f"no encoder of {', '.join(without)}: the nominal arm has the measured angle there"
            overall = Health(overall.state, (*overall.sentences, sentence))
        return Observation(is_fresh=True, overall=overall, endpoint=endpoint, scan=scan, joints=joints)

    def _silence_s(self, topic: str, now_s: float) -> float:
        """Return for how long a topic with messages has been silent [s]; 0: it is not."""
        messages = self._store.messages(topic)
        arrivals_s = [each.arrival_s for each in messages][-PERIODS - 1 :]
        period_s = float(np.median(np.diff(arrivals_s))) if len(arrivals_s) > PERIODS else 0.0
        silence_s = now_s - messages[-1].arrival_s
        return silence_s if silence_s > max(SILENCE_S, 3.0 * period_s) else 0.0

    def _overall(self, values: Mapping[str, Any], now_s: float) -> Health:
        refused = (f"a message was refused: {self._store.refused}",) if self._store.refused else ()
        if not self._has_state:
            sentence = f"{self._topics.endpoint} says nothing about faults; {ENDPOINT_STATE_TOPIC} is not in the bag"
            return Health(NO_STATE, (sentence, *refused))
        reason = (values["reason"],) if values["reason"] else ()
        reports = self._diagnostics(f"{self._prefix}/chain_node", now_s)
        return Health(_state_name(values["state"]), (*reason, *reports, *refused))

    def _endpoint(self, values: Mapping[str, Any], message: Message) -> EndpointView:
        pose = "pose.pose" if "pose.pose.position.x" in values else "pose"
        parts = [values[name] for name in ("covariance_random", "covariance_systematic") if name in values]
        parts = parts or [values.get("pose.covariance", [np.nan] * 36)]
        return EndpointView(
            message.stamp_ns,
            (message.received_ns - message.stamp_ns) / NS,
            values.get("age", np.nan),
            values["header.frame_id"],
            np.array([values[f"{pose}.{part}"] for part in _POSE]),
            np.sum(parts, axis=0).reshape(6, 6),
            np.array(values.get("protection_level") or [np.nan] * 6),
            tuple(values.get("protection_causes", ())),
        )

    def _joint(self, name: str, endpoint: Mapping[str, Any], now_s: float) -> Health:
        """Return the health of a joint from its transform, from the endpoint's state and from the diagnostics."""
        reasons = [part for part in endpoint.get("reason", "").split("; ") if name in re.findall(r"\w+", part)]
        sentences = (*reasons, *self._diagnostics(f"{self._prefix}/{name}", now_s))
        topic = self._topics.transforms[name]
        messages = self._store.messages(topic)
        values = self._store.values(topic, messages[-1]) if messages else None
        if values is None:
            since_s = self._store.since_s
            state = NO_MESSAGE
            if since_s is not None and now_s - since_s > FIRST_MESSAGE_S:
                state, sentences = SILENT, (f"no transform in the {now_s - since_s:.0f} s of this page", *sentences)
        elif (silence_s := self._silence_s(topic, now_s)) > 0.0:
            state, sentences = SILENT, (f"no transform for {silence_s:.1f} s", *sentences)
        else:
            state = _state_name(values["state"])
            if faults := "|".join(str(flag.name) for flag in Fault if flag & values["faults"]):
                sentences = (faults, *sentences)
        if endpoint.get("joint") == name and endpoint["state"] > EndpointState.STATE_DEGRADED and state in USABLE:
            state = _state_name(endpoint["state"])
        return Health(state, sentences)

    def _diagnostics(self, prefix: str, now_s: float) -> tuple[str, ...]:
        """Return the reports besides OK of the nodes under a prefix, and the names of silent nodes."""
        found: dict[str, None] = {}  # a set that keeps its order
        for name, status in sorted(self._store.statuses.items()):
            if name.partition(":")[0] != prefix and not name.startswith(f"{prefix}/"):
                continue
            node = name.partition(":")[0].rpartition("/")[2]
            if now_s - status.arrival_s > DIAGNOSTICS_SILENCE_S:
                found[f"{node}: no diagnostics for {now_s - status.arrival_s:.0f} s"] = None
            elif status.level:
                found[f"{node}: {status.text}"] = None
        return tuple(found)

    def _scan(self, now_s: float) -> ArmScan | None:
        """Return the newest scan of which every joint has a transform that is not too old."""
        topics = [self._topics.transforms[name] for name in self._joints]
        by_stamp = [{each.stamp_ns: each for each in self._store.messages(topic)} for topic in topics]
        common = set.intersection(*(set(stamps) for stamps in by_stamp))
        if not common or any(self._silence_s(topic, now_s) > 0.0 for topic in topics):
            return None
        stamp_ns = max(common)
        found = [self._store.values(topic, stamps[stamp_ns]) for topic, stamps in zip(topics, by_stamp, strict=True)]
        joints = [values for values in found if values is not None]
        if len(joints) < len(topics):
            return None
        return ArmScan(
            stamp_ns,
            np.array([_usable_pose(values) for values in joints]),
            np.array([values["covariance_random"] for values in joints]).reshape(-1, 6, 6),
            np.array([values["covariance_systematic"] for values in joints]).reshape(-1, 6, 6),
            np.array([values["native"][5] for values in joints]),
            np.array([values["residual"] / max(values["redundancy"], 1) for values in joints]),
            np.array([self._encoder(name, stamp_ns) for name in self._joints]),
        )

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


def _usable_pose(values: Mapping[str, Any]) -> list[float]:
    """Return the pose of a transform; NaN if it must not be used."""
    return [values[f"pose.{part}"] if values["state"] <= State.DEGRADED else np.nan for part in _POSE]


def _state_name(state: int) -> str:
    return STATES.get(state, f"unknown state {state}")


def _position(values: Mapping[str, Any], name: str) -> float:
    """Return the position of a joint in a JointState [rad]; NaN: it has none."""
    index = list(values["name"]).index(name) if name in values["name"] else 0 if not name else -1
    return values["position"][index] if 0 <= index < len(values["position"]) else np.nan
