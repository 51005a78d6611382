# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Verdicts on the endpoint of a scan: whether there is an endpoint, which joint decides, and why."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, NamedTuple

from posor.chain.joint_measurements import FAULT_TEXTS
from posor.messages.endpoint_messages import EndpointVerdict
from posor.model.fault import Fault, State
from posor_msgs.msg import EndpointState

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

ALL_FAULTS = sum(int(flag) for flag in Fault)
NOT_COUNTED = "waiting for the home mark or another reference"
"""Text for a joint without a fault whose theta is not counted."""
_STATE_TEXTS = {int(state): f"is {state.name.lower()}" for state in State}
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


def degraded_by(verdict: EndpointVerdict, reason: str, joint: str = "") -> EndpointVerdict:
    """Return the verdict on a scan with a pose, with a further reason, of a joint or not; empty: nothing."""
    if not reason:
        return verdict
    if verdict is SOUND:
        return EndpointVerdict(EndpointState.STATE_DEGRADED, 0, joint, f"degraded: {reason}")
    return verdict._replace(reason=f"{verdict.reason}; {reason}")


def unusable_verdict(joints: Sequence[JointStatus]) -> EndpointVerdict:
    """Return the verdict on a scan without an endpoint: UNCOUNTED if all unusable joints are, else LOST."""
    unusable = [joint for joint in joints if joint.state > State.DEGRADED or joint.code]
    if not unusable:
        return EndpointVerdict(EndpointState.STATE_LOST, _all_faults(joints), "", "the endpoint is not finite")
    lost = [joint for joint in unusable if joint.state != State.UNCOUNTED]
    state = EndpointState.STATE_LOST if lost else EndpointState.STATE_UNCOUNTED
    reason = joined_reasons((joint.name, _reason(joint)) for joint in unusable)
    is_waiting = all(waits_to_be_counted(joint.state, joint.faults) and not joint.code for joint in unusable)
    return EndpointVerdict(state, _all_faults(joints), (lost or unusable)[0].name, reason, is_waiting)


def joined_reasons(reasons: Iterable[tuple[str, str]]) -> str:
    """Return the reasons of joints, by their names, each once: the text has to fit into the message."""
    names: dict[str, list[str]] = {}
    for joint, reason in reasons:
        names.setdefault(reason, []).append(joint)
    return "; ".join(f"{listed(each)} {reason}" for reason, each in names.items())


def listed(names: Sequence[str]) -> str:
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
