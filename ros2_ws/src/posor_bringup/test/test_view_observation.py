# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor.calibration.causes import EXCEEDED
from posor.chain.identity import ArmIdentity, file_sha256
from posor.numerics.stamps import NS
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_events import Cause
from posor_bringup.view_messages import ArmTopics, MessageStore
from posor_bringup.view_observation import LAG_S, PERIODS, SILENCE_S, Observer
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.message_classes import schema_of_class
from scipy.special import chdtri
from sensor_msgs.msg import JointState

PERIOD_S = 0.01
STATE, TRANSFORM, ENCODERS = "/test_rig/endpoint/state", "/test_rig/joint1/transform", "/test_rig/encoders"


class Rig:
    """The topics of the test rig, fed by hand."""

    def __init__(self) -> None:
        self.arm = load_checked_arm("test_rig")
        topics = ArmTopics(self.arm)
        self.store = MessageStore("/test_rig", topics.types)
        observer = Observer(topics, self.store, ["joint1"], self.arm)
        self.observe = lambda now_s: observer.observe(now_s, round(now_s * NS))

    def add(self, topic: str, message: Any, time_s: float, stamp_s: float | None = None) -> None:
        stamp_ns = round((time_s if stamp_s is None else stamp_s) * NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
        self.store.add(topic, time_s, round(time_s * NS), schema_of_class(type(message)).serialize(message))

    def add_scan(
        self, time_s: float, state: EndpointState | None = None, transform: JointTransform | None = None
    ) -> None:
        self.add(TRANSFORM, JointTransform(redundancy=2, residual=3.0) if transform is None else transform, time_s)
        self.add(STATE, EndpointState() if state is None else state, time_s)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_nothing_is_fresh_before_the_first_message(rig: Rig) -> None:
    seen = rig.observe(1.0)
    assert not seen.is_fresh
    assert seen.causes == (Cause("NO MESSAGE", f"no message yet on {STATE}"),)
    assert seen.joints["joint1"] == "NO MESSAGE"


def test_sound_scan(rig: Rig) -> None:
    rig.add_scan(1.0)
    rig.add_scan(1.0 + PERIOD_S)
    seen = rig.observe(1.05)
    assert seen.is_fresh
    assert (seen.state, seen.joints["joint1"]) == ("OK", "OK")
    assert seen.scan is not None
    assert seen.scan.stamp_ns == 1_010_000_000
    assert seen.scan.residuals[0] == pytest.approx(3.0 / chdtri(2, EXCEEDED * 1e-4))
    assert seen.causes == ()
    assert seen.reports == (Cause("NOTE", "no encoder: the nominal arm has the measured angle there", ("joint1",)),)


OTHER_FILES = "the arm runs with another URDF, beams file or commissioning record than the page"


@pytest.mark.parametrize(
    ("state", "clause"),
    [
        ({"identity": "own"}, ""),
        ({"identity": "0" * 64}, OTHER_FILES),
        ({"identity": "own", "child_frame_id": "tool"}, "the endpoint of the arm is 'tool', that of the page '"),
    ],
)
def test_an_arm_with_other_files_than_those_of_the_page_is_named(rig: Rig, state: dict[str, str], clause: str) -> None:
    """Its drawing and deviation would be those of another arm, beside the state OK."""
    files = ArmIdentity({}, file_sha256(rig.arm.urdf), file_sha256(rig.arm.beams))
    own = {"own": files.with_calibrations({"joint1": 5}, "").sha256}
    message = EndpointState(**{name: own.get(value, value) for name, value in state.items()})
    for time_s in np.arange(1.0, 2.1 + LAG_S, 0.1).tolist():
        rig.add_scan(time_s, message, JointTransform(calibration=5))
        seen = rig.observe(time_s + 0.01)
    warnings = [each.text for each in seen.reports if each.state == "WARNING"]
    assert len(warnings) == bool(clause)
    assert all(text.startswith(clause) for text in warnings)


def test_everything_is_stale_without_messages_on_the_endpoint(rig: Rig) -> None:
    rig.add_scan(1.0)
    rig.add_scan(1.0 + PERIOD_S)
    now_s = 1.1 + PERIOD_S + SILENCE_S
    rig.add(TRANSFORM, JointTransform(), now_s)
    seen = rig.observe(now_s)
    assert not seen.is_fresh
    assert (seen.state, seen.joints["joint1"]) == ("STALE", "STALE")
    assert seen.causes == (Cause("STALE", f"no message on {STATE}: chain_node has ended, hangs or is not active"),)
    assert seen.scan is None


def test_slow_arm_is_silent_after_three_periods(rig: Rig) -> None:
    for time_s in range(0, 2 * PERIODS + 1, 2):
        rig.add_scan(float(time_s))
    assert rig.observe(2.0 * PERIODS + 5.9).is_fresh
    assert not rig.observe(2.0 * PERIODS + 6.1).is_fresh


def test_joint_that_is_never_heard_of_becomes_silent(rig: Rig) -> None:
    rig.store.clear(since_s=1.0)
    rig.add(STATE, EndpointState(), 1.5)
    assert rig.observe(1.5).joints["joint1"] == "NO MESSAGE"
    rig.add(STATE, EndpointState(), 4.0)
    assert rig.observe(4.0).joints["joint1"] == "SILENT"


def test_joint_without_transforms_is_silent(rig: Rig) -> None:
    rig.add_scan(1.0)
    reason = "joint1: transform missing from a scan that the other joints sent"
    rig.add(STATE, EndpointState(state=EndpointState.STATE_LOST, joint="joint1", reason=reason), 1.5)
    seen = rig.observe(1.5)
    assert seen.is_fresh
    assert (seen.state, seen.joints["joint1"]) == ("LOST", "SILENT")
    assert seen.causes == (Cause("LOST", "transform missing from a scan that the other joints sent", ("joint1",)),)
    assert seen.scan is None


def test_pose_of_a_lost_joint_is_not_used(rig: Rig) -> None:
    lost = JointTransform(state=JointTransform.STATE_LOST, faults=JointTransform.FAULT_RESIDUAL)
    rig.add_scan(1.0, EndpointState(state=EndpointState.STATE_LOST, joint="joint1", reason="joint1 is lost"), lost)
    seen = rig.observe(1.0)
    assert seen.joints["joint1"] == "LOST"
    assert seen.scan is not None
    assert math.isnan(seen.scan.poses[0, 0])


def test_joint_that_the_chain_refuses_is_not_ok(rig: Rig) -> None:
    rig.add_scan(1.0, EndpointState(state=EndpointState.STATE_LOST, joint="joint1", reason="joint1 has no covariance"))
    seen = rig.observe(1.0)
    assert seen.joints["joint1"] == "LOST"
    assert seen.scan is not None
    assert math.isnan(seen.scan.poses[0, 0])


@pytest.mark.parametrize(
    ("messages", "angle"),
    [([(0.99, 0.1), (1.01, 0.3)], pytest.approx(0.2)), ([(0.99, 0.1)], pytest.approx(math.nan, nan_ok=True))],
)
def test_angle_of_the_encoder_is_interpolated_at_the_stamp_of_the_scan_and_not_extrapolated(
    rig: Rig, messages: list[tuple[float, float]], angle: Any
) -> None:
    rig.add_scan(1.0)
    for stamp_s, position in messages:
        rig.add(ENCODERS, JointState(name=["other", "joint1"], position=[9.0, position]), 1.02, stamp_s)
    scan = rig.observe(1.02).scan
    assert scan is not None
    assert scan.encoders[0] == angle


def test_an_encoder_among_several_without_names_is_not_shown(rig: Rig) -> None:
    rig.add_scan(1.0)
    for stamp_s in (0.99, 1.01):
        rig.add(ENCODERS, JointState(position=[9.0, 0.1]), 1.02, stamp_s)
    scan = rig.observe(1.02).scan
    assert scan is not None
    assert math.isnan(scan.encoders[0])


def test_diagnostics_of_the_joint_and_their_silence(rig: Rig) -> None:
    array = DiagnosticArray()
    for name, level, message in (
        ("/test_rig/joint1/driver_node: source", DiagnosticStatus.WARN, "late"),
        ("/test_rig/joint1/posor_node: lifecycle", DiagnosticStatus.OK, "active"),
        ("/other_arm/joint1/posor_node: lifecycle", DiagnosticStatus.ERROR, "of another arm"),
    ):
        array.status.append(DiagnosticStatus(name=name, level=level, message=message))
    rig.add("/diagnostics", array, 1.0)
    rig.add_scan(1.0)
    assert (
        Cause("WARNING", "driver_node: late", ("joint1",)) not in rig.observe(1.0).reports
    )  # may be of a fault before
    rig.add_scan(1.0 + LAG_S)
    assert rig.observe(1.0 + LAG_S).reports[0] == Cause("WARNING", "driver_node: late", ("joint1",))
    rig.add_scan(5.0)
    assert rig.observe(5.0).details["joint1"] == (
        "driver_node has ended or hangs: no diagnostics for 4 s",
        "posor_node has ended or hangs: no diagnostics for 4 s",
    )


def test_invalid_message_is_refused_with_a_sentence(rig: Rig) -> None:
    rig.add_scan(1.0)
    rig.store.add(STATE, 1.0, 0, b"\x00\x01\x00\x00" + bytes(10))
    seen = rig.observe(1.0)
    assert not seen.is_fresh
    assert seen.causes[0].text.startswith(f"{STATE}: EndpointState: a message of 14 bytes ends within ")


def test_an_earlier_pause_does_not_hide_a_later_silence(rig: Rig) -> None:
    rig.add_scan(0.0)
    rig.add_scan(60.0)
    assert rig.observe(60.0 + 0.5 * SILENCE_S).is_fresh
    assert not rig.observe(60.0 + 2.0 * SILENCE_S).is_fresh
    for number in range(10):
        rig.add_scan(61.0 + number * PERIOD_S)
    assert not rig.observe(61.1 + 2.0 * SILENCE_S).is_fresh


def test_every_change_of_the_state_is_kept_although_few_messages_are_drawn(rig: Rig) -> None:
    lost = EndpointState(state=EndpointState.STATE_LOST, joint="joint1", reason="joint1 is lost (FROZEN)")
    for number, state in enumerate([EndpointState()] * 100 + [lost] + [EndpointState(age=1.0)] * 100):
        rig.add(STATE, state, 1.0 + 0.001 * number)
    changes = rig.store.take_changes()
    assert [(round(each.received_ns / 1e6), each.values["state"]) for each in changes] == [
        (1000, 0),
        (1100, 2),
        (1101, 0),
    ]
    assert rig.store.take_changes() == []
