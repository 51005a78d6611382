# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.estimation.estimate import Estimate
from posor.messages.raw_scan import scan_of
from posor.model.fault import Fault, State
from posor.model.scan import DIODES_ESTIMATED, HOME_BUMP, NO_SOURCE, PROBES_ESTIMATED, SATURATED, SIMULATED
from posor_lab.harness.message_conversion import (
    is_usable,
    pose_from_message,
    pose_message,
    scan_from_message,
    transform_message,
)
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_classes import schema_of_class

RANDOM = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-12
SYSTEMATIC = np.outer(np.arange(1.0, 7.0), np.arange(1.0, 7.0)) * 1e-14


@pytest.fixture
def raw() -> Any:
    scan = RawScan(scan=2**63 + 1, status=RawScan.STATUS_OUTLIERS_DROPPED | RawScan.STATUS_OVERRUN)
    scan.header.stamp.sec, scan.header.stamp.nanosec = 1_700_000_000, 123_456_789
    scan.header.frame_id = "frame of the raw scan"
    scan.gap_voltages, scan.ring_voltages = [0.1, -0.2, 0.3], [1.0, 2.0, 3.0, 4.0]
    scan.diode_currents = [1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6, 7e-6, 8e-6]
    scan.lit_sources = [3, RawScan.NO_SOURCE]
    scan.supply_voltage, scan.temperature = 15.0, 293.15
    return scan


@pytest.fixture
def pose() -> pin.SE3:
    return pin.exp6(np.array([1e-4, -2e-4, 8e-4, 2e-3, -3e-3, 2.5]))


@pytest.fixture
def estimate(pose: pin.SE3) -> Estimate:
    lost = Estimate.lost(7, Fault.NONE, "")
    return lost._replace(
        state=State.DEGRADED,
        faults=Fault.RESIDUAL | Fault.COUNT,
        T_R_T=pose,
        theta=2.5 + 4.0 * math.pi,
        covariance_random=RANDOM,
        covariance_systematic=SYSTEMATIC,
        residual=3.25,
        redundancy=1,
        stamp_shift=np.arange(6.0),
    )


@pytest.mark.parametrize(("enum", "prefix"), [(State, "STATE_"), (Fault, "FAULT_")])
def test_states_and_faults_equal_the_constants_of_the_message(enum: type[IntEnum | IntFlag], prefix: str) -> None:
    names = [name for name in dir(JointTransform) if name.startswith(prefix)]
    message = {name.removeprefix(prefix): getattr(JointTransform, name) for name in names}
    core = {name: member.value for name, member in enum.__members__.items()}
    assert core == message


def test_flags_and_no_source_equal_the_constants_of_the_message() -> None:
    assert PROBES_ESTIMATED == RawScan.STATUS_PROBES_ESTIMATED
    assert DIODES_ESTIMATED == RawScan.STATUS_DIODES_ESTIMATED
    assert SATURATED == RawScan.STATUS_SATURATED
    assert SIMULATED == RawScan.STATUS_SIMULATED
    assert HOME_BUMP == RawScan.STATUS_HOME_BUMP
    assert NO_SOURCE == RawScan.NO_SOURCE


def test_faults_are_one_bit_each_so_that_they_can_be_combined() -> None:
    flags = [fault.value for fault in Fault]
    assert all(flag.bit_count() == 1 for flag in flags)
    assert len(set(flags)) == len(flags)


def test_the_quaternion_is_in_the_order_of_ros() -> None:
    """A quarter turn about Z: z and w are the square root of a half, x and y are zero."""
    orientation = pose_message(pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.zeros(3))).orientation
    half = math.sqrt(0.5)
    assert (orientation.x, orientation.y) == (0.0, 0.0)
    assert (orientation.z, orientation.w) == (pytest.approx(half, abs=1e-15), pytest.approx(half, abs=1e-15))


def test_a_transform_has_all_fields_of_its_estimate(raw: Any, estimate: Estimate, pose: pin.SE3) -> None:
    message = transform_message(raw, estimate, "plate_r", "plate_t")
    assert message.header.stamp == raw.header.stamp
    assert (message.header.frame_id, message.child_frame_id) == ("plate_r", "plate_t")
    assert message.scan == raw.scan
    assert message.scan_status == raw.status
    assert message.state == JointTransform.STATE_DEGRADED
    assert message.faults == JointTransform.FAULT_RESIDUAL | JointTransform.FAULT_COUNT
    assert (message.residual, message.redundancy) == (3.25, 1)
    np.testing.assert_array_equal(message.stamp_shift, estimate.stamp_shift)
    np.testing.assert_array_equal(message.native, estimate.native)
    np.testing.assert_array_equal(message.native[:3], pose.translation)
    assert message.native[5] == 2.5 + 4.0 * math.pi


def test_a_message_converts_back_to_the_pose_and_covariances(raw: Any, estimate: Estimate, pose: pin.SE3) -> None:
    uneven = np.arange(36.0).reshape(6, 6)  # not symmetric: rows and columns must not be exchanged
    message = transform_message(raw, estimate._replace(covariance_random=uneven), "plate_r", "plate_t")
    np.testing.assert_allclose(pose_from_message(message.pose).homogeneous, pose.homogeneous, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(np.reshape(message.covariance_random, (6, 6)), uneven)
    np.testing.assert_array_equal(np.reshape(message.covariance_systematic, (6, 6)), SYSTEMATIC)


def test_a_lost_joint_has_only_nan(raw: Any) -> None:
    lost = Estimate.lost(7, Fault.DARK_DIODE, "diode 1 is dark.")
    message = transform_message(raw, lost, "plate_r", "plate_t")
    assert message.state == JointTransform.STATE_LOST
    assert message.faults == JointTransform.FAULT_DARK_DIODE
    p, q = message.pose.position, message.pose.orientation
    pose = [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
    covariances = [*message.covariance_random, *message.covariance_systematic]
    assert np.isnan([*pose, *covariances, *message.stamp_shift, *message.native, message.residual]).all()
    assert message.redundancy == 0


@pytest.mark.parametrize(
    ("state", "usable"),
    [(State.OK, True), (State.DEGRADED, True), (State.LOST, False), (State.UNCOUNTED, False), (200, False)],
)
def test_only_ok_and_degraded_states_are_usable(state: int, usable: bool) -> None:  # noqa: FBT001  a table's column
    assert is_usable(JointTransform(state=int(state))) is usable


def test_a_scan_has_all_fields_of_its_message(raw: Any) -> None:
    raw.status |= RawScan.STATUS_HOME_BUMP
    scan = scan_from_message(raw)
    assert scan.number == 2**63 + 1
    assert scan.stamp_ns == 1_700_000_000_123_456_789
    assert scan.at_home
    assert scan.gap_voltages.tolist() == [0.1, -0.2, 0.3]
    assert scan.ring_voltages.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert scan.diode_currents.tolist() == [[1e-6, 2e-6, 3e-6, 4e-6], [5e-6, 6e-6, 7e-6, 8e-6]]
    assert scan.lit_sources == (3, NO_SOURCE)
    assert (scan.supply_voltage, scan.temperature) == (15.0, 293.15)
    raw.exposure_offsets, raw.exposure_span = [1e-6, 2e-6], 3e-6
    raw.stamp_uncertainty, raw.stamp_limit, raw.reference_voltage = 4e-6, 5e-6, 2.5
    scan, from_bytes = scan_from_message(raw), scan_of(schema_of_class(RawScan).serialize(raw))
    for name, value in vars(from_bytes).items():
        np.testing.assert_array_equal(getattr(scan, name), value, err_msg=name)


def test_an_empty_scan_has_no_readings() -> None:
    scan = scan_from_message(RawScan())
    assert not scan.at_home
    assert scan.gap_voltages.shape == scan.ring_voltages.shape == (0,)
    assert scan.diode_currents.shape == (0, 4)
    assert scan.lit_sources == ()


def test_currents_not_in_groups_of_four_keep_their_number(raw: Any) -> None:
    raw.diode_currents = [1e-6] * 6
    currents = scan_from_message(raw).diode_currents
    assert currents.size == 6
    assert currents.shape[1] != 4


def test_a_scan_does_not_share_its_numbers_with_the_message(raw: Any) -> None:
    scan = scan_from_message(raw)
    raw.gap_voltages[0] = 99.0
    assert scan.gap_voltages[0] == 0.1
