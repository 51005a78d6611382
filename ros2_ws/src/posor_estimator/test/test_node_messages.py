# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers straight between bytes and arrays, against the same messages as rclpy's objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.chain.joint_measurements import JointMeasurements, read_row
from posor.errors import TopicError
from posor.estimation.estimate import Estimate
from posor.messages.cdr_schema import STAMP
from posor.messages.endpoint_messages import MessageWriter
from posor.messages.joint_transform import JointTransformFormat, stamp_ns_of
from posor.messages.message_table import LEAD
from posor.messages.raw_scan import ScanTemplate
from posor.model.fault import Fault, State
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.stamps import NS
from posor.ros_names import JOINT_STATE, POSE_STAMPED, POSE_WITH_COVARIANCE_STAMPED
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.message_conversion import scan_from_message, transform_message
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_classes import schema_of_class
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

RAW_SCAN = schema_of_class(RawScan)
JOINT_TRANSFORM = schema_of_class(JointTransform)
SHAPES = [(3, 0, 8), (0, 4, 0), (8, 8, 16), (1, 0, 4), (0, 0, 0)]  # numbers of gap voltages, ring voltages and currents


def scans(shape: tuple[int, int, int], spreads: tuple[float, ...] = ()) -> Iterator[Any]:
    """Yield scans with so many readings, some of them none."""
    chance = np.random.default_rng(shape)
    gaps, rings, currents = shape
    for number in range(20):
        scan = RawScan(scan=2**64 - 1 - number, samples=number, status=int(chance.integers(2**32)))
        scan.header.stamp.sec, scan.header.stamp.nanosec = 1_700_000_000 + number, int(chance.integers(NS))
        scan.header.frame_id = "posor_receiving"
        scan.gap_voltages, scan.ring_voltages = chance.normal(size=gaps), chance.normal(size=rings)
        scan.diode_currents = chance.normal(size=currents)
        scan.gap_voltage_spreads = list(spreads)
        scan.lit_sources = [int(lit) for lit in chance.integers(256, size=currents // 4)]
        scan.supply_voltage, scan.temperature = chance.choice([15.0, math.nan, math.inf]), chance.normal()
        if gaps:
            scan.gap_voltages[0] = chance.choice([math.nan, 1.0])
        yield scan


def test_a_template_is_the_scan_but_for_stamp_number_and_status() -> None:
    for message in scans((3, 4, 8), (1e-3, 2e-3, 3e-3)):
        template = ScanTemplate(RAW_SCAN.serialize(message) + b"surplus")
        assert template.status == message.status
        for stamp_ns, number, status in ((1_700_000_001 * NS + 5, 7, None), (-NS + 1, 2**64 - 1, 32)):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
            message.scan = number
            message.status = message.status if status is None else status
            assert template.at(stamp_ns, number, status) == RAW_SCAN.serialize(message)


def test_a_template_of_bytes_that_are_no_scan_is_refused() -> None:
    assert refusal(TopicError, ScanTemplate, b"\x00\x01\x00\x00abc").where == "RawScan"


def estimates() -> Iterator[Estimate]:
    chance = np.random.default_rng(7)
    lost = Estimate.lost(3, Fault.DARK_DIODE, "dark.")
    yield lost
    for state in State:
        if state is not State.LOST:
            pose = pin.exp6(chance.normal(size=6))
            yield lost._replace(
                state=state,
                T_R_T=pose,
                theta=native_from_rotation(pose.rotation)[2] + 6.0 * math.pi,
                covariance_random=chance.normal(size=(6, 6)),
                covariance_systematic=chance.normal(size=(6, 6)),
                stamp_shift=chance.uniform(size=6),
                residual=chance.normal(),
                redundancy=int(chance.integers(200)),
            )


def test_a_transform_is_recognised_and_read_for_the_chain() -> None:
    scan = next(scans((3, 0, 8)))
    every = list(estimates())
    measured = JointMeasurements.allocate(len(every), 1)
    messages = [transform_message(scan, estimate, "plate_r", "plate_t") for estimate in every]
    kind = JointTransformFormat(JOINT_TRANSFORM.serialize(messages[0]))
    rows = np.zeros((len(every), -(-(LEAD + kind.size) // 8) * 8), dtype=np.uint8)
    for row, message in zip(rows, messages, strict=True):
        data = serialize_message(message)
        assert kind.matches(data)
        assert kind.read_state(data) == (message.state, message.faults)
        assert stamp_ns_of(data[STAMP]) == scan_from_message(scan).stamp_ns
        row[LEAD : LEAD + kind.size] = np.frombuffer(data, dtype=np.uint8)[: kind.size]
    for n, message in enumerate(messages):
        pose = measured.poses[n, 0]
        random, systematic = measured.covariances_random[n, 0], measured.covariances_systematic[n, 0]
        parts = pose, random, systematic, measured.stamp_shifts[n, 0]
        measured.thetas[n, 0] = read_row(kind.row_layout.record, 0, rows[n].view(np.float64), *parts)
        p, q = message.pose.position, message.pose.orientation
        assert measured.poses[n, 0].tobytes() == np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]).tobytes()
        assert random.tobytes() == np.asarray(message.covariance_random).tobytes()
        assert systematic.tobytes() == np.asarray(message.covariance_systematic).tobytes()
        assert measured.stamp_shifts[n, 0].tobytes() == np.asarray(message.stamp_shift).tobytes()
        theta = math.inf if message.state == State.LOST else message.native[5]
        assert repr(float(measured.thetas[n, 0])) == repr(float(theta))
        assert rows[n, kind.row_layout.state] == message.state


def test_shared_terms_and_causes_are_found_behind_names_of_any_length() -> None:
    scan, estimate = next(scans((3, 0, 8))), next(estimates())
    chance = np.random.default_rng(3)
    for names in ((), ("scale",), ("scale", "temperature_of_the_bench"), tuple("abcdefgh"), ()):
        message = transform_message(scan, estimate, "plate_r", "plate_t")
        message.shared_terms, message.shared_effects = list(names), chance.normal(size=6 * len(names))
        for causes in ((), names, tuple(reversed(names))):
            message.causes, message.effect_causes = list(causes), list(range(len(causes)))
            message.effect_kinds = [0] * len(causes)
            message.effects = chance.normal(size=7 * len(causes)).astype(np.float32)
            data = JOINT_TRANSFORM.serialize(message)
            for written in (data, data + b"surplus", serialize_message(message)):
                kind = JointTransformFormat(written)
                assert kind.matches(written)
                assert (kind.constants.shared, kind.constants.causes.names) == (names, causes)
                assert kind.size == len(data)
                row, at = bytes(LEAD) + written, kind.row_layout
                for begin, field in ((at.shared, message.shared_effects), (at.effects, message.effects)):
                    numbers = np.asarray(field)
                    assert row[begin : begin + numbers.nbytes] == numbers.tobytes()
                assert at.effect_count == len(causes)


@pytest.mark.parametrize(
    ("change", "what", "expected"),
    [
        ({"shared_terms": ["scale"], "shared_effects": [0.0] * 5}, "a message has 5 shared_effects", "6"),
        ({"causes": ["a"], "effect_causes": [0], "effect_kinds": [0], "effects": [0.0] * 6}, "6 effects", "7"),
        ({"causes": ["a"], "effect_causes": [0], "effects": [0.0] * 7}, "a message has 0 effect_kinds", "1"),
        (
            {"causes": ["a"], "effect_causes": [1], "effect_kinds": [0], "effects": [0.0] * 7},
            "effect_causes has 1",
            "less than 1",
        ),
    ],
)
def test_terms_and_causes_that_do_not_fit_are_refused(change: dict[str, Any], what: str, expected: str) -> None:
    message = transform_message(next(scans((3, 0, 8))), next(estimates()), "plate_r", "plate_t")
    for name, value in change.items():
        setattr(message, name, value)
    error = refusal(TopicError, JointTransformFormat, JOINT_TRANSFORM.serialize(message))
    assert what in error.what
    assert error.expected == expected


def test_a_transform_between_other_plates_is_not_taken() -> None:
    scan, estimate = next(scans((3, 0, 8))), next(estimates())
    own, other, longer = (
        JOINT_TRANSFORM.serialize(transform_message(scan, estimate, "plate_r", child))
        for child in ("plate_t", "plate_s", "another plate")
    )
    kind = JointTransformFormat(own)
    assert kind.matches(own + b"surplus")
    others = (other, longer, own[:-1], b"", b"\x00\x00" + own[2:], b"\x00\x07" + own[2:])
    assert [kind.matches(data) for data in others] == [False] * 6


def test_a_format_has_the_same_constants_whatever_the_padding_of_the_message_holds() -> None:
    scan, estimate = next(scans((3, 0, 8))), next(estimates())
    own = JOINT_TRANSFORM.serialize(transform_message(scan, estimate, "r", "t"))
    gap = own.index(b"r\x00", 12) + 2
    padded = own[:gap] + b"\xaa" * (-gap % 4) + own[gap + (-gap % 4) :]
    assert padded != own
    plain, other = JointTransformFormat(own), JointTransformFormat(padded)
    assert not plain.matches(padded)
    assert (other.constants, other.size) == (plain.constants, plain.size)


def test_a_writer_writes_the_present_numbers_of_its_arrays() -> None:
    chance = np.random.default_rng(3)
    pose, covariance, angles = np.zeros(7), np.zeros((6, 6)), np.zeros(2)
    plain, full, joints = PoseStamped(), PoseWithCovarianceStamped(), JointState(name=["shoulder", "elbow"])
    plain.header.frame_id = full.header.frame_id = "base"
    joints.position = [0.0, 0.0]
    header = {"header.frame_id": "base"}
    writers = [
        MessageWriter(POSE_STAMPED, header, {"pose.position.x": pose}),
        MessageWriter(
            POSE_WITH_COVARIANCE_STAMPED, header, {"pose.pose.position.x": pose, "pose.covariance": covariance}
        ),
        MessageWriter(JOINT_STATE, {"name": joints.name, "position": joints.position}, {"position": angles}),
    ]
    for sec in range(5):
        for array in (pose, covariance, angles):
            array[:] = chance.normal(size=array.shape)
        for part in (plain.pose, full.pose.pose):
            part.position.x, part.position.y, part.position.z = pose[:3].tolist()
            part.orientation.x, part.orientation.y, part.orientation.z, part.orientation.w = pose[3:].tolist()
        full.pose.covariance, joints.position = covariance.ravel(), angles.tolist()
        for message, writer in zip((plain, full, joints), writers, strict=True):
            message.header.stamp.sec = sec
            expected = schema_of_class(type(message)).serialize(message)
            data = writer.write(expected[STAMP])
            assert data == expected
            assert deserialize_message(data, type(message)) == message
