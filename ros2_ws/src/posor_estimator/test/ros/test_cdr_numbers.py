"""Numbers straight between bytes and arrays, against the same messages as rclpy's objects."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_estimator.core.estimate import Estimate
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.errors import TopicError
from posor_estimator.ros.cdr import NS, STAMP, Schema
from posor_estimator.ros.cdr_scan import RAW_SCAN, ScanReader, ScanTemplate, scan_of
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM, Lost, Reading, TransformReader, TransformWriter
from posor_estimator.ros.cdr_writer import MessageWriter
from posor_estimator.ros.messages import CovarianceKind, scan_from_message, transform_message
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from collections.abc import Iterator

SHAPES = [(3, 0, 8), (0, 4, 0), (8, 8, 16), (1, 0, 4), (0, 0, 0)]
"""Numbers of gap voltages, ring voltages and currents."""


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


def bits(scan: Scan) -> tuple[Any, ...]:
    """Return all that a scan says, numbers bit by bit."""
    numbers = (scan.gap_voltages, scan.ring_voltages, scan.diode_currents, scan.supply_voltage, scan.temperature)
    arrays = [np.asarray(each, dtype=float) for each in numbers]
    told = (scan.number, scan.stamp_ns, scan.lit_sources, scan.at_home)
    return (*told, *((each.shape, each.tobytes()) for each in arrays))


@pytest.mark.parametrize("shape", SHAPES)
def test_scans_are_read_into_arrays_as_rclpy_reads_them(shape: tuple[int, int, int]) -> None:
    reader = room = None
    for message in scans(shape):
        data = serialize_message(message)
        if reader is None or room is None:
            room = Scans.of([scan_of(data)])
            reader = ScanReader(data, room)
        assert reader.read(data)
        expected = scan_from_message(message)
        assert bits(room[0]) == bits(expected) == bits(scan_of(data))
        assert (reader.frame, reader.number, reader.status) == ("posor_receiving", message.scan, message.status)
        assert (reader.stamp_ns, reader.lit) == (expected.stamp_ns, expected.lit_sources)


def test_a_scan_of_another_kind_is_not_read_and_changes_nothing() -> None:
    first, *_ = scans((3, 0, 8))
    data = RAW_SCAN.serialize(first)
    room = Scans.of([scan_of(data)])
    reader = ScanReader(data, room)
    assert reader.read(data)
    before = bits(room[0])
    foreign, short, spread = (
        deserialize_message(data, RawScan),
        *(next(scans(shape)) for shape in ((2, 0, 8), (3, 0, 8))),
    )
    foreign.header.frame_id = "another_receiving"[:15]
    spread.gap_voltage_spreads = [1e-3]
    others = [RAW_SCAN.serialize(message) for message in (foreign, short, spread)]
    for other in [*others, data[:-1], b"", b"\x00\x00" + data[2:], b"\x00\x07" + data[2:]]:
        assert not reader.read(other)
        assert bits(room[0]) == before
    assert reader.read(data + b"surplus bytes at the end")


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
    with pytest.raises(TopicError, match=r"^RawScan: a message of 7 bytes ends within 'header\.stamp\.sec'"):
        ScanTemplate(b"\x00\x01\x00\x00abc")


def estimates() -> Iterator[Estimate]:
    chance = np.random.default_rng(7)
    lost = Estimate.lost(3, Fault.DARK_DIODE, "dark.")
    yield lost
    for state in State:
        if state is not State.LOST:
            yield replace(
                lost,
                state=state,
                T_R_T=pin.exp6(chance.normal(size=6)),
                theta=20.0,
                covariance_random=chance.normal(size=(6, 6)),
                covariance_systematic=chance.normal(size=(6, 6)),
                residual=chance.normal(),
                redundancy=int(chance.integers(200)),
            )


def put(estimate: Estimate, results: Lost) -> None:
    """Put an estimate where the estimator's lane would."""
    results.pose[:] = math.nan if estimate.T_R_T is None else pin.SE3ToXYZQUAT(estimate.T_R_T)
    results.native[:] = estimate.native
    results.random[:] = estimate.covariance_random
    results.systematic[:] = estimate.covariance_systematic
    results.residual, results.redundancy = estimate.residual, estimate.redundancy
    results.state, results.faults = int(estimate.state), int(estimate.faults)


@pytest.mark.parametrize("kind", ["random", "systematic", "total"])
def test_transforms_are_written_as_their_messages_are(kind: CovarianceKind) -> None:
    results = Lost()
    writer = TransformWriter("plate_r", "plate_t of a long name", kind, results)
    for scan, estimate in zip(scans((3, 0, 8)), estimates(), strict=False):
        put(estimate, results)
        message = transform_message(scan, estimate, "plate_r", "plate_t of a long name", kind)
        data = writer.write(RAW_SCAN.serialize(scan)[STAMP], scan.scan, scan.status)
        assert data == JOINT_TRANSFORM.serialize(message)


def test_what_never_comes_to_an_estimate_is_lost_without_a_number() -> None:
    scan = next(scans((3, 0, 8)))
    data = TransformWriter("plate_r", "plate_t", "total", Lost()).write(RAW_SCAN.serialize(scan)[STAMP], 7, 64)
    message = deserialize_message(data, JointTransform)
    assert (message.scan, message.scan_status) == (7, 64)
    assert (message.state, message.faults) == (JointTransform.STATE_LOST, JointTransform.FAULT_BAD_READING)
    assert np.isnan([*message.covariance, *message.native, message.residual, message.pose.orientation.w]).all()


def test_a_transform_is_read_for_the_chain() -> None:
    scan, reader = next(scans((3, 0, 8))), None
    for estimate in estimates():
        message = transform_message(scan, estimate, "plate_r", "plate_t", "total")
        data = serialize_message(message)
        reader = reader or TransformReader(data)
        assert reader.frames == ("plate_r", "plate_t")
        reading = reader.read(data)
        assert reading is not None
        assert (reading.state, reading.faults) == (message.state, message.faults)
        assert repr(reading.theta) == repr(float(message.native[5]))
        assert reading.stamp_ns == scan_from_message(scan).stamp_ns
        p, q = message.pose.position, message.pose.orientation
        assert data[reading.pose] == np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]).tobytes()
        assert data[reading.covariance] == np.asarray(message.covariance).tobytes()


def test_a_transform_between_other_plates_is_not_read() -> None:
    scan, estimate = next(scans((3, 0, 8))), next(estimates())
    own, other, longer = (
        JOINT_TRANSFORM.serialize(transform_message(scan, estimate, "plate_r", child, "total"))
        for child in ("plate_t", "plate_s", "another plate")
    )
    reader = TransformReader(own)
    assert isinstance(reader.read(own), Reading)
    assert [reader.read(data) for data in (other, longer, own[:-1], b"", b"\x00\x00" + own[2:])] == [None] * 5


def test_a_writer_writes_what_its_arrays_say_at_that_time() -> None:
    chance = np.random.default_rng(3)
    pose, covariance, angles = np.zeros(7), np.zeros((6, 6)), np.zeros(2)
    plain, full, joints = PoseStamped(), PoseWithCovarianceStamped(), JointState(name=["shoulder", "elbow"])
    plain.header.frame_id = full.header.frame_id = "base"
    joints.position = [0.0, 0.0]
    writers = [
        MessageWriter(plain, {"pose.position.x": pose}),
        MessageWriter(full, {"pose.pose.position.x": pose, "pose.covariance": covariance}),
        MessageWriter(joints, {"position": angles}),
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
            expected = Schema.of(type(message)).serialize(message)
            data = writer.write(expected[STAMP])
            assert data == expected
            assert deserialize_message(data, type(message)) == message
