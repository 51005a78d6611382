"""Verdicts on the endpoint of a scan: whether there is an endpoint, which joint decides, and why; their messages."""

from __future__ import annotations

from functools import lru_cache, reduce
from operator import or_
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.chain.joint_measurements import FAULT_TEXTS
from posor.messages.endpoint_messages import POSE, MessageWriter
from posor.model.fault import Fault, State
from posor.ros_names import ENDPOINT_STATE
from posor_msgs.msg import EndpointState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator

MAX_JOINT, MAX_REASON = 128, 255  # bounds of the strings in ``posor_msgs/EndpointState`` [bytes]
WRITERS = 16  # number of verdicts whose messages are kept prepared
ALL_FAULTS = sum(int(flag) for flag in Fault)
NOT_COUNTED = "waiting for the home mark or another reference"
"""Said of a joint without a fault whose large rotation is not counted."""
_STATE_TEXTS = {int(state): f"is {state.name.lower()}" for state in State}


class EndpointVerdict(NamedTuple):
    """Whether there is an endpoint, and why not; the fields of ``posor_msgs/EndpointState``."""

    state: int
    faults: int = 0
    joint: str = ""
    reason: str = ""
    is_waiting: bool = False  # each joint that gives no pose has no fault and only waits to be counted; no field there

    @property
    def has_pose(self) -> bool:
        """Whether the endpoint's numbers are valid."""
        return self.state <= int(EndpointState.STATE_DEGRADED)


SOUND = EndpointVerdict(EndpointState.STATE_OK)


class JointStatus(NamedTuple):
    """State of a joint in one scan, from its transform and from the checks of the chain."""

    name: str  # of the joint
    state: int  # ``State`` of the transform, or an unknown number
    faults: int  # ``Fault`` of the transform
    code: int = 0  # why the chain cannot use the transform, a key of ``FAULT_TEXTS``; zero: no reason


def waits_to_be_counted(state: int, faults: int) -> bool:
    """Return whether a joint has no fault and only waits for its home mark or another reference."""
    return state == State.UNCOUNTED and not faults


def degraded_verdict(joints: Sequence[JointStatus]) -> EndpointVerdict:
    """Return the verdict on a scan with an endpoint and at least one degraded joint."""
    degraded = [joint for joint in joints if joint.state]
    reason = ", ".join(f"{joint.name}{_fault_names(joint.faults)}" for joint in degraded)
    return EndpointVerdict(EndpointState.STATE_DEGRADED, _all_faults(degraded), degraded[0].name, f"degraded: {reason}")


def unusable_verdict(joints: Sequence[JointStatus]) -> EndpointVerdict:
    """Return the verdict on a scan without an endpoint: UNCOUNTED if all unusable joints are, else LOST."""
    unusable = [joint for joint in joints if joint.state > State.DEGRADED or joint.code]
    if not unusable:
        return EndpointVerdict(EndpointState.STATE_LOST, _all_faults(joints), "", "the endpoint is not finite")
    lost = [joint for joint in unusable if joint.state != State.UNCOUNTED]
    state = EndpointState.STATE_LOST if lost else EndpointState.STATE_UNCOUNTED
    names: dict[str, list[str]] = {}  # of the joints with the same reason: the text has to fit into the message
    for joint in unusable:
        names.setdefault(_reason(joint), []).append(joint.name)
    reason = "; ".join(f"{_listed(each)} {text}" for text, each in names.items())
    is_waiting = all(waits_to_be_counted(joint.state, joint.faults) and not joint.code for joint in unusable)
    return EndpointVerdict(state, _all_faults(joints), (lost or unusable)[0].name, reason, is_waiting)


def _listed(names: Sequence[str]) -> str:
    """Return names as the subject of a singular verb."""
    return names[0] if len(names) == 1 else f"each of {', '.join(names)}"


def _reason(joint: JointStatus) -> str:
    if joint.code:
        return FAULT_TEXTS[joint.code]
    if waits_to_be_counted(joint.state, joint.faults):
        return f"is {NOT_COUNTED}"
    return _STATE_TEXTS.get(joint.state, f"has the unknown state {joint.state}") + _fault_names(joint.faults)


def _all_faults(joints: Sequence[JointStatus]) -> int:
    return reduce(or_, (joint.faults for joint in joints), 0)


def _fault_names(faults: int) -> str:
    """Return the names of faults in parentheses after a space; empty without faults."""
    # Not Fault(faults): enum keeps a member of every value for ever, and damaged messages have any value.
    names = [str(flag.name) for flag in Fault if flag & faults]
    if unknown := faults & ~ALL_FAULTS:
        names.append(f"unknown faults {unknown}")
    return f" ({'|'.join(names)})" if faults else ""


class EndpointStateWriter:
    """Writes ``EndpointState``; pose, covariance and protection level are NaN without a pose.

    Attributes:
        protection_level: Written into every message with a pose, (6,) [m], [rad]; NaN: not known.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, child_frame: str, *, relative: bool) -> None:
        pose, covariance = estimator.result(relative=relative)
        self.protection_level = np.full(6, np.nan)
        self._age = np.full(1, np.nan)
        endpoint = {POSE: pose, "covariance": covariance, "protection_level": self.protection_level}
        nothing = {name: np.full(numbers.shape, np.nan) for name, numbers in endpoint.items()}
        frames = {"header.frame_id": frame, "child_frame_id": child_frame}

        @lru_cache(maxsize=WRITERS)
        def writer_of(verdict: EndpointVerdict) -> MessageWriter:
            values: dict[str, Any] = {"state": verdict.state, "faults": verdict.faults}
            for name, text, limit in (("joint", verdict.joint, MAX_JOINT), ("reason", verdict.reason, MAX_REASON)):
                values |= {name: text.encode()[:limit].decode(errors="ignore")}
            numbers = {"age": self._age, **(endpoint if verdict.has_pose else nothing)}
            return MessageWriter(ENDPOINT_STATE, frames | values, numbers)

        self._writer_of = writer_of

    def write(self, stamp: bytes, age_s: float, verdict: EndpointVerdict) -> bytes:
        """Return the message; ``stamp``: its eight bytes (``STAMP``); ``age_s``: until now [s], NaN: no scan yet."""
        self._age[0] = age_s
        return self._writer_of(verdict).write(stamp)
