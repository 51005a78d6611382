# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Verdicts on the endpoint of a scan."""

from __future__ import annotations

import pytest
from posor.chain.joint_measurements import POSE_TOO_FAR
from posor.messages.endpoint_messages import EndpointVerdict
from posor.model.fault import Fault, State
from posor_estimator.endpoint_verdict import NOT_COUNTED, JointStatus, degraded_verdict, unusable_verdict
from posor_msgs.msg import EndpointState

SOUND_JOINT = JointStatus("base", State.OK, 0)
FLAGGED = JointStatus("wrist", State.DEGRADED, Fault.FLAGGED)
LOST = JointStatus("elbow", State.LOST, Fault.RESIDUAL)
UNCOUNTED = JointStatus("shoulder", State.UNCOUNTED, Fault.COUNT)
WAITING = JointStatus("shoulder", State.UNCOUNTED, 0)
TOO_FAR = JointStatus("tool", State.OK, 0, POSE_TOO_FAR)
GROUPED = f"each of shoulder, tool is {NOT_COUNTED}"
FAR_TEXT = "tool is further than 0.02 m from the nominal joint of the URDF"


@pytest.mark.parametrize(
    ("joints", "state", "faults", "joint", "reason"),
    [
        ([SOUND_JOINT, LOST], "LOST", Fault.RESIDUAL, "elbow", "elbow is lost (RESIDUAL)"),
        ([SOUND_JOINT, UNCOUNTED], "UNCOUNTED", Fault.COUNT, "shoulder", "shoulder is uncounted (COUNT)"),
        ([SOUND_JOINT, WAITING], "UNCOUNTED", 0, "shoulder", f"shoulder is {NOT_COUNTED}"),
        (
            [UNCOUNTED, FLAGGED, LOST],
            "LOST",
            Fault.COUNT | Fault.FLAGGED | Fault.RESIDUAL,
            "elbow",
            "shoulder is uncounted (COUNT); elbow is lost (RESIDUAL)",
        ),
        ([WAITING, JointStatus("tool", State.UNCOUNTED, 0), SOUND_JOINT], *("UNCOUNTED", 0, "shoulder"), GROUPED),
        ([SOUND_JOINT, TOO_FAR], "LOST", 0, "tool", FAR_TEXT),
        ([JointStatus("base", 200, 0)], "LOST", 0, "base", "base has the unknown state 200"),
        ([SOUND_JOINT, FLAGGED], "LOST", Fault.FLAGGED, "", "the endpoint is not finite"),
        ([], "LOST", 0, "", "the endpoint is not finite"),
    ],
)
def test_a_scan_without_an_endpoint_always_has_a_state_of_the_message_and_a_reason(
    joints: list[JointStatus], state: str, faults: int, joint: str, reason: str
) -> None:
    verdict = unusable_verdict(joints)
    assert verdict[:4] == (getattr(EndpointState, f"STATE_{state}"), faults, joint, reason)
    assert not verdict.has_pose
    EndpointState(state=verdict.state, faults=verdict.faults, joint=verdict.joint, reason=verdict.reason)


@pytest.mark.parametrize(
    ("joints", "is_waiting"),
    [
        ([SOUND_JOINT, WAITING], True),
        ([FLAGGED, WAITING], True),
        ([UNCOUNTED, WAITING], False),
        ([LOST, WAITING], False),
        ([JointStatus("shoulder", State.UNCOUNTED, 0, POSE_TOO_FAR)], False),
    ],
)
def test_the_endpoint_waits_only_if_every_joint_without_a_pose_does(
    joints: list[JointStatus], *, is_waiting: bool
) -> None:
    assert unusable_verdict(joints).is_waiting == is_waiting


def test_a_degraded_scan_names_its_degraded_joints() -> None:
    other = JointStatus("tool", State.DEGRADED, Fault.OUT_OF_RANGE)
    verdict = degraded_verdict([SOUND_JOINT, FLAGGED, other])
    faults = Fault.FLAGGED | Fault.OUT_OF_RANGE
    reason = "degraded: wrist (FLAGGED), tool (OUT_OF_RANGE)"
    assert verdict == EndpointVerdict(EndpointState.STATE_DEGRADED, faults, "wrist", reason)
    assert verdict.has_pose


def test_unknown_faults_are_named_and_not_kept_in_memory() -> None:
    known = len(Fault.__members__), len(Fault._value2member_map_)
    for damage in range(1, 200):
        faults = int(Fault.FLAGGED) | damage << 40
        verdict = degraded_verdict([JointStatus("wrist", State.DEGRADED, faults)])
        assert verdict.reason == f"degraded: wrist (FLAGGED|unknown faults {damage << 40})"
    assert (len(Fault.__members__), len(Fault._value2member_map_)) == known
