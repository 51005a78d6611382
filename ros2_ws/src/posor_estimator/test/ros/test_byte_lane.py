"""From the bytes of raw scans to those of transforms, against the core's estimates as rclpy's messages."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.accuracy.poses import STACKS, TICK_NS
from posor_estimator.bulk.columns import records_of, transform_layout
from posor_estimator.bulk.layout import TableLayout
from posor_estimator.core.designs import BUMPS, design
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import SAID_FAULTS, SAID_NEWS, SAID_STATE, SAID_TAKEN
from posor_estimator.errors import TopicError
from posor_estimator.ros.byte_lane import ByteLane
from posor_estimator.ros.cdr_scan import RAW_SCAN, scan_of
from posor_estimator.ros.cdr_transform import JOINT_TRANSFORM
from posor_estimator.ros.messages import transform_message
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.scan import Scan
    from posor_estimator.ros.messages import CovarianceKind

COUNT = 30
KINDS: tuple[CovarianceKind, ...] = ("random", "systematic", "total")
BUMP = 2.0 * math.pi / BUMPS


def message_of(scan: Scan, frame: str = "receiving") -> RawScan:
    """Return a scan as its message, with a number and a status of which no bit may be lost."""
    message = RawScan(scan=2**64 - 1 - scan.number, samples=4, status=2**31 + 8)
    message.status |= RawScan.STATUS_HOME_BUMP if scan.at_home else 0
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(scan.stamp_ns, 10**9)
    message.header.frame_id = frame
    message.gap_voltages, message.ring_voltages = scan.gap_voltages, scan.ring_voltages
    message.diode_currents, message.lit_sources = scan.diode_currents.ravel(), list(scan.lit_sources)
    message.supply_voltage, message.temperature = scan.supply_voltage, scan.temperature
    return message


def moving(posor: Posor, *, start: float = 0.05) -> list[RawScan]:
    """Return noisy scans of a target that turns; some are unfit, contradictory, far away, or see the home mark."""
    rotations = np.array([rotation_from_native(1e-4, -2e-4, start + 2e-3 * n) for n in range(COUNT)])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (COUNT, 1))
    stamps = np.arange(1, COUNT + 1, dtype=np.int64) * TICK_NS + 1_700_000_000 * 10**9
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(4))
    scans.at_home[2] = 1
    scans.gap_voltages[7, 1] = np.nan
    for spoiled in (scans.ring_voltages, scans.diode_currents[:, :, 0]):
        spoiled[15:16, 0:1] *= 1.05
    scans.gap_voltages[20] = scans.gap_voltages[20, ::-1]
    scans.lit_sources[22] = 255
    return [message_of(scans[n]) for n in range(COUNT)]


def expected(posor: Posor, messages: Sequence[RawScan], kind: CovarianceKind) -> list[bytes]:
    """Return the transforms that the core's estimates of scans make, scan by scan, as rclpy's messages."""
    frames = posor.calibration.frames
    scans = [scan_of(RAW_SCAN.serialize(message)) for message in messages]
    return [
        JOINT_TRANSFORM.serialize(transform_message(message, posor.locate(scan), frames.parent, frames.child, kind))
        for message, scan in zip(messages, scans, strict=True)
    ]


def told(data: bytes | None) -> JointTransform:
    assert data is not None
    return deserialize_message(data, JointTransform)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stack", STACKS)
def test_bytes_of_transforms_are_those_of_the_estimates_messages(stack: DesignName, kind: CovarianceKind) -> None:
    calibration = design(stack, motion=True)
    messages = moving(Posor(calibration))
    wanted = expected(Posor(calibration), messages, kind)
    states = [told(data).state for data in wanted]
    assert {int(State.LOST), int(State.OK)} <= set(states)
    raw = [RAW_SCAN.serialize(message) for message in messages]
    lane = ByteLane(Posor(calibration), raw[0], kind)
    assert [lane.answer(data) for data in raw] == wanted


@pytest.mark.parametrize("stack", STACKS)
def test_many_rows_at_once_are_the_bytes_of_one_after_the_other(stack: DesignName) -> None:
    calibration = design(stack, motion=True)
    raw = [RAW_SCAN.serialize(message) for message in moving(Posor(calibration))]
    lane = ByteLane(Posor(calibration), raw[0], "total")
    wanted = [lane.answer(data) for data in raw]
    layout, transforms = TableLayout.of(raw[0], RAW_SCAN), transform_layout("receiving", "target", "total")
    starts = np.arange(COUNT) * len(raw[0])
    rows = layout.read(np.frombuffer(b"".join(raw), dtype=np.uint8), starts, np.full(COUNT, len(raw[0])))
    out = transforms.empty(COUNT)
    records_of(Posor(calibration), layout, transforms).locate(rows.rows, out.rows)
    assert [message.tobytes() for message in out.messages] == wanted


def in_python(posor: Posor) -> Posor:
    """Return a POSOR whose scans are located one by one in Python, as where a sensor is one without rows."""
    posor.loop.tables.complete, posor.loop.tables.root = False, posor.parameter_root
    return posor


def test_where_the_loop_is_not_compiled_bytes_are_the_estimates_too() -> None:
    calibration = design("triad_bumpy_ring", motion=True)
    messages = moving(Posor(calibration))
    messages[5].header.stamp.sec = messages[5].header.stamp.nanosec = 0
    raw = [RAW_SCAN.serialize(message) for message in messages]
    lane = ByteLane(in_python(Posor(calibration)), raw[0], "total")
    found = [lane.answer(data) for data in raw]
    assert told(found.pop(5)).faults == Fault.BAD_READING
    assert found == expected(in_python(Posor(calibration)), messages[:5] + messages[6:], "total")
    other = moving(Posor(calibration))[0]
    other.gap_voltages = [0.1]
    assert lane.answer(RAW_SCAN.serialize(other)) is None


def test_what_the_last_scan_was_can_be_asked() -> None:
    posor = Posor(design("triad_diodes"))
    messages = moving(posor)
    lane, other = ByteLane(posor, RAW_SCAN.serialize(messages[0]), "total"), Posor(posor.calibration)
    for message in messages:
        data = RAW_SCAN.serialize(message)
        lane.answer(data)
        estimate = other.locate(scan_of(data))
        assert lane.said[:3].tolist() == [scan_of(data).stamp_ns, estimate.state, estimate.faults]
        answered = lane.answered()
        assert answered.stamp_ns == scan_of(data).stamp_ns
        assert (answered.number, answered.verdict.redundancy) == (message.scan, estimate.redundancy)
        assert answered.verdict.residual == pytest.approx(estimate.residual, nan_ok=True, rel=0.0, abs=0.0)
        assert lane.answered().reason == estimate.reason


def test_other_rows_are_told_where_another_source_is_lit() -> None:
    posor = Posor(design("triad_diodes"))
    messages = moving(posor)
    lane = ByteLane(posor, RAW_SCAN.serialize(messages[0]), "total")
    seen = []
    for lit in ([0, 0], [0, 0], [1, 0], [1, 0], [0, 0]):
        messages[0].header.stamp.nanosec += 1
        messages[0].lit_sources = lit
        lane.answer(RAW_SCAN.serialize(messages[0]))
        seen.append((lane.said[SAID_TAKEN], lane.said[SAID_NEWS]))
    assert seen == [(1, 1), (1, 0), (2, 1), (2, 0), (3, 1)]


@pytest.mark.parametrize("compiled", [True, False])
def test_another_state_or_another_fault_is_news(compiled: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_diodes"))
    posor = posor if compiled else in_python(posor)
    messages = moving(posor)[:7]
    lane = ByteLane(posor, RAW_SCAN.serialize(messages[0]), "total")
    messages[3].gap_voltages[0] = messages[4].gap_voltages[0] = math.nan
    messages[5].diode_currents[0] *= 1.5
    seen = []
    for message in messages:
        lane.answer(RAW_SCAN.serialize(message))
        seen.append((State(lane.said[SAID_STATE]), Fault(lane.said[SAID_FAULTS]), lane.said[SAID_NEWS]))
    bad, far = (State.LOST, Fault.BAD_READING), (State.LOST, Fault.RESIDUAL)
    sound = (State.OK, Fault(0))
    assert seen == [(*sound, 1), (*sound, 0), (*sound, 0), (*bad, 1), (*bad, 0), (*far, 1), (*sound, 1)]


def test_a_scan_of_another_kind_is_not_answered_and_changes_nothing() -> None:
    calibration = design("triad_diodes")
    messages = moving(Posor(calibration))
    first, second = (RAW_SCAN.serialize(message) for message in messages[:2])
    undisturbed = ByteLane(Posor(calibration), first, "total")
    wanted = [undisturbed.answer(data) for data in (first, second)]
    lane = ByteLane(Posor(calibration), first, "total")
    assert lane.answer(first) == wanted[0]

    def changed(**fields: Any) -> bytes:
        message = deserialize_message(first, RawScan)
        for name, value in fields.items():
            setattr(message, name, value)
        return RAW_SCAN.serialize(message)

    foreign = deserialize_message(first, RawScan)
    foreign.header.frame_id = "receiveng"
    unended = bytearray(first)
    unended[first.index(b"receiving\x00") + 9] = 0x41
    others = [
        bytes(unended),
        RAW_SCAN.serialize(foreign),
        changed(gap_voltages=[0.1, 0.2]),
        changed(gap_voltage_spreads=[1e-3] * 3),
    ]
    for other in [*others, first[:-1], b"", b"\x00\x00" + first[2:], b"\x00\x07" + first[2:]]:
        assert lane.answer(other) is None
        assert (lane.answered().number, lane.said[SAID_STATE]) == (messages[0].scan, State.OK)
        assert lane.answered().reason == ""
    assert lane.answer(second + b"surplus bytes at the end") == wanted[1]


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("spoil", ["frame", "stamp", "nanoseconds"])
def test_scans_that_may_not_be_used_are_lost_without_a_number(spoil: str, known: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_diodes"))
    sound, message = (moving(posor)[n] for n in range(2))
    before = RAW_SCAN.serialize(sound)
    if known:
        assert told(ByteLane(posor, before, "total").answer(before)).state == State.OK
    reason = "the stamp is zero, or its nanoseconds are a second or more; expected the time of exposure."
    if spoil == "frame":
        message.header.frame_id = "elsewhere"
        reason = "comes from frame 'elsewhere'; expected 'receiving', as in the calibration."
    elif spoil == "stamp":
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    else:
        message.header.stamp.nanosec = 1_000_000_000
    data = RAW_SCAN.serialize(message)
    lane = ByteLane(posor, data, "total")
    lost = told(lane.answer(data))
    assert (lost.scan, lost.scan_status, lost.header.stamp) == (message.scan, message.status, message.header.stamp)
    assert (lost.header.frame_id, lost.child_frame_id) == ("receiving", "target")
    assert (lost.state, lost.faults, lost.redundancy) == (State.LOST, Fault.BAD_READING, 0)
    assert np.isnan(
        [*lost.covariance, *lost.native, lost.residual, lost.pose.position.x, lost.pose.orientation.w]
    ).all()
    assert tuple(lane.said[1:3]) == (State.LOST, Fault.BAD_READING)
    assert math.isnan(lane.answered().verdict.residual)
    assert lane.answered().reason == f"scan {message.scan}: {reason}"


@pytest.mark.parametrize("compiled", [True, False])
def test_scans_that_may_not_be_used_leave_count_and_last_pose_alone(compiled: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_bumpy_ring", motion=True))
    posor = posor if compiled else in_python(posor)
    messages = moving(posor, start=0.0)[:6]
    raw = [RAW_SCAN.serialize(message) for message in messages]
    undisturbed = ByteLane(posor, raw[0], "total")
    wanted = [undisturbed.answer(data) for data in raw]
    assert told(wanted[-1]).state == State.OK
    posor.reset()
    lane = ByteLane(posor, raw[0], "total")
    messages[0].header.stamp.sec = messages[0].header.stamp.nanosec = 0
    without_time = RAW_SCAN.serialize(messages[0])
    messages[1].header.frame_id = "elsewhere"
    foreign = RAW_SCAN.serialize(messages[1])
    for data, expected_answer in zip(raw, wanted, strict=True):
        assert lane.answer(data) == expected_answer
        assert told(lane.answer(without_time)).state == State.LOST
        assert told(ByteLane(posor, foreign, "total").answer(foreign)).state == State.LOST


def test_wrong_numbers_of_readings_are_lost_with_a_sentence() -> None:
    calibration = design("triad_diodes")
    for fields, said in (
        ({"gap_voltages": [0.1, 0.2]}, "2 gap probe voltages; expected 3"),
        ({"diode_currents": [1e-5] * 7}, "7 contact currents"),
        ({"lit_sources": [0]}, "1 lit"),
    ):
        message = moving(Posor(calibration))[0]
        for name, value in fields.items():
            setattr(message, name, value)
        data = RAW_SCAN.serialize(message)
        lane, other = ByteLane(Posor(calibration), data, "total"), Posor(calibration)
        assert told(lane.answer(data)).state == State.LOST
        assert said in lane.answered().reason
        assert lane.answered().reason == other.locate(scan_of(data)).reason


SOME = {
    "gap_voltages": 3,
    "gap_voltage_spreads": 3,
    "ring_voltages": 4,
    "ring_voltage_spreads": 4,
    "diode_currents": 8,
    "diode_current_spreads": 8,
    "lit_sources": 2,
}
"""How many of each a scan may have, or none."""


@pytest.mark.parametrize("given", list(product([False, True], repeat=len(SOME))))
def test_whatever_a_scan_lacks_it_is_answered(given: tuple[bool, ...]) -> None:
    """An empty sequence is not aligned; spreads come from a driver that averages samples."""
    calibration = design("triad_diodes")
    message = moving(Posor(calibration))[0]
    for (name, count), there in zip(SOME.items(), given, strict=True):
        if not there:
            setattr(message, name, [])
        elif not len(getattr(message, name)):
            setattr(message, name, [1e-3] * count)
    data = RAW_SCAN.serialize(message)
    lane = ByteLane(Posor(calibration), data, "total")
    assert [lane.answer(data)] == expected(Posor(calibration), [message], "total")


def test_bytes_that_are_no_scan_are_refused() -> None:
    with pytest.raises(TopicError, match=r"^RawScan: a message of 7 bytes ends within 'header\.stamp\.sec'"):
        ByteLane(Posor(design("triad_diodes")), b"\x00\x01\x00\x00abc", "total")


@pytest.mark.parametrize("compiled", [True, False])
def test_theta_is_counted_from_the_next_scan_that_is_one(compiled: bool) -> None:  # noqa: FBT001
    """The scan that asks for a start, the scan after a start, and one that is lost before."""

    def estimator() -> Posor:
        return Posor(calibration) if compiled else in_python(Posor(calibration))

    calibration = design("triad_bumpy_ring", motion=True)
    messages = moving(Posor(calibration), start=0.0)
    for message in messages:
        message.status &= ~RawScan.STATUS_HOME_BUMP
    raw = [RAW_SCAN.serialize(message) for message in messages]
    messages[0].header.stamp.sec = messages[0].header.stamp.nanosec = 0
    without_time = RAW_SCAN.serialize(messages[0])
    for before in ([], raw[:1], [without_time]):
        lane = ByteLane(estimator(), raw[0], "total")
        for data in before:
            assert told(lane.answer(data)).state in (State.UNCOUNTED, State.LOST)
        lane.count_from_next()
        assert lane.counts_from_next
        if before == [without_time]:
            assert told(lane.answer(without_time)).state == State.LOST
            assert lane.counts_from_next
        counted = told(lane.answer(raw[1]))
        assert counted.state == State.OK
        assert abs(counted.native[5]) < 0.5 * BUMP
        assert counted.scan_status == messages[1].status
        assert not lane.counts_from_next
        assert told(lane.answer(raw[3])).state == State.OK


def test_a_scan_is_the_same_whatever_its_padding_holds() -> None:
    calibration = design("triad_diodes", frames=("r", "target"))
    messages = moving(Posor(calibration))[:2]
    for message in messages:
        message.header.frame_id = "r"
    first, second = (RAW_SCAN.serialize(message) for message in messages)
    lane, other = ByteLane(Posor(calibration), first, "total"), ByteLane(Posor(calibration), first, "total")
    assert lane.answer(first) == other.answer(first)
    end = second.index(b"r\x00", 12) + 2
    padded = second[:end] + b"\xaa" * (-end % 4) + second[end + (-end % 4) :]
    assert padded != second
    assert lane.answer(padded) == other.answer(second)
