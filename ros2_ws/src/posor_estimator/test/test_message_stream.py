# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the bytes of raw scans to those of transforms, against the core's estimates as rclpy's messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from gc import collect
from itertools import product
from typing import Any
from weakref import ref

import numpy as np
import pytest
from posor.calibration.designs import BUMPS, DesignName, design
from posor.chain.identity import calibration_id
from posor.errors import TopicError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.estimation.scan_checks import MARKS
from posor.messages import message_stream
from posor.messages.joint_transform import TransformConstants
from posor.messages.message_stream import MessageEstimator, MessageStream, RawScanStream
from posor.messages.message_table import TableLayout
from posor.messages.raw_scan import ScanTemplate, scan_of
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import Scan
from posor.numerics.compiled import run_in_turn
from posor.numerics.kernel_library import BoundKernel
from posor.numerics.stamps import NS
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.graph import scan_message
from posor_lab.harness.message_conversion import estimate_with_effects, transform_message
from posor_lab.harness.random_poses import STACKS, TICK_NS
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_classes import schema_of_class
from rclpy.serialization import deserialize_message

RAW_SCAN = schema_of_class(RawScan)
JOINT_TRANSFORM = schema_of_class(JointTransform)
COUNT = 30
BUMP = 2.0 * math.pi / BUMPS


def message_of(scan: Scan) -> RawScan:
    """Return a scan as its message, with a number and a status of which no bit may be lost."""
    message = scan_message(scan)
    message.scan, message.samples, message.status = 2**64 - 100 + scan.number, 4, 2**31 + 8
    message.status |= RawScan.STATUS_HOME_BUMP if scan.at_home else 0
    return message


def moving(posor: Posor, *, start: float = 0.05) -> list[RawScan]:
    """Return noisy scans of a target that turns; some are unfit, contradictory, far away, or see the home mark."""
    rotations = np.array([rotation_from_native(1e-4, -2e-4, start + 2e-3 * n) for n in range(COUNT)])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (COUNT, 1))
    stamps = np.arange(1, COUNT + 1, dtype=np.int64) * TICK_NS + 1_700_000_000 * 10**9
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(4)).editable()
    scans.at_home[1 : 1 + MARKS] = 1
    scans.gap_voltages[7, 1] = np.nan
    for spoiled in (scans.ring_voltages, scans.diode_currents[:, :, 0]):
        spoiled[15:16, 0:1] *= 1.05
    scans.gap_voltages[20] = scans.gap_voltages[20, ::-1]
    scans.lit_sources[22] = 255
    return [message_of(scans[n]) for n in range(COUNT)]


def expected(posor: Posor, messages: Sequence[RawScan]) -> list[bytes]:
    """Return the transforms that the core's estimates of scans make, scan by scan, as rclpy's messages."""
    frames, number = posor.calibration.frames, calibration_id(posor.calibration)
    scans = [scan_of(RAW_SCAN.serialize(message)) for message in messages]
    transforms, causes = [], posor.hypotheses.joint_causes()
    for message, scan in zip(messages, scans, strict=True):
        estimate, effects = estimate_with_effects(posor, scan)
        transform = transform_message(message, estimate, frames.parent, frames.child, (causes, effects), number)
        transforms.append(JOINT_TRANSFORM.serialize(transform))
    return transforms


def decode(data: bytes | None) -> JointTransform:
    assert data is not None
    return deserialize_message(data, JointTransform)


@pytest.mark.parametrize("stack", STACKS)
def test_bytes_of_transforms_are_those_of_the_estimates_messages(stack: DesignName) -> None:
    calibration = design(stack, motion=True)
    messages = moving(Posor(calibration))
    wanted = expected(Posor(calibration), messages)
    states = [decode(data).state for data in wanted]
    assert {int(State.LOST), int(State.OK)} <= set(states)
    raw = [RAW_SCAN.serialize(message) for message in messages]
    stream = RawScanStream(Posor(calibration), raw[0])
    assert [stream.estimate_message(data) for data in raw] == wanted


def estimate_expected(stream: RawScanStream, data: bytes, now_ns: int) -> bytes | None:
    """Return the transform of a scan; None where it is not the expected one."""
    assert stream.prepare(data, now_ns)
    stream.run_prepared((stream,))
    return stream.finish(data)


def test_only_a_newer_scan_of_an_accepted_age_is_expected() -> None:
    calibration = design("triad_diodes", motion=True)
    posor, other = Posor(calibration), Posor(calibration)
    template = ScanTemplate(RAW_SCAN.serialize(moving(Posor(calibration))[0]))
    stamps_ns = [NS + n * NS // 1000 for n in range(4)]
    raw = [template.at(stamp_ns, 7 + n) for n, stamp_ns in enumerate(stamps_ns)]
    stream, unchecked = (RawScanStream(each, raw[0]) for each in (posor, other))
    stream.accept_ages(-5.0, 10.0)
    wanted = [unchecked.estimate_message(data) for data in raw]
    assert stream.last_stamp_and_number() is None
    assert estimate_expected(stream, raw[0], stamps_ns[0]) is None  # no scan came before
    assert stream.estimate_message(raw[0]) == wanted[0]
    for n, age_ns in ((0, 0), (1, -6), (1, 11)):  # repeated, ahead of time, too old
        before = posor.model.workspace[0]["tracker"].tobytes()
        assert estimate_expected(stream, raw[n], stamps_ns[n] + age_ns) is None
        assert posor.model.workspace[0]["tracker"].tobytes() == before
        assert stream.last_stamp_and_number() == (stamps_ns[0], 7)
    for n, age_ns in ((1, -5), (2, 10)):
        assert estimate_expected(stream, raw[n], stamps_ns[n] + age_ns) == wanted[n]
    assert estimate_expected(stream, template.at(stamps_ns[3], 8), stamps_ns[3]) is None  # backward
    assert estimate_expected(stream, raw[3], stamps_ns[3]) == wanted[3]


def test_scans_that_are_missing_before_a_newer_one_are_counted_from_the_newest() -> None:
    calibration = design("triad_diodes", motion=True)
    template = ScanTemplate(RAW_SCAN.serialize(moving(Posor(calibration))[0]))
    raw = {number: template.at(NS + number * NS // 1000, number) for number in range(7, 30)}
    stream = RawScanStream(Posor(calibration), raw[7])
    missing = []
    for number in (9, 10, 13, 11, 12, 14, 17, 15, 29):  # the first, none, two, late, late, none, two, late, eleven
        assert stream.estimate_message(raw[number])
        missing.append(stream.stamp_change_and_missing()[2])
    assert missing == [0, 0, 2, 0, 0, 0, 2, 0, 11]


@pytest.mark.parametrize("stack", STACKS)
def test_many_rows_at_once_are_the_bytes_of_one_after_the_other(stack: DesignName) -> None:
    calibration = design(stack, motion=True)
    raw = [RAW_SCAN.serialize(message) for message in moving(Posor(calibration))]
    stream = RawScanStream(Posor(calibration), raw[0])
    wanted = [stream.estimate_message(data) for data in raw]
    layout, transforms = (
        TableLayout.of(raw[0], RAW_SCAN),
        TransformConstants.of(Posor(calibration)).layout(JOINT_TRANSFORM),
    )
    starts = np.arange(COUNT) * len(raw[0])
    rows = layout.read(np.frombuffer(b"".join(raw), dtype=np.uint8), starts, np.full(COUNT, len(raw[0])))
    out = transforms.copies(COUNT)
    rows_stream = MessageStream.of(layout, transforms, rows.rows, out.rows)
    assert MessageEstimator(Posor(calibration), rows_stream).estimate_rows()
    assert [message.tobytes() for message in out.messages] == wanted


@pytest.mark.parametrize("number", [0, 1, 0x7FF0000000000001, 0xFFF8000000000001, 2**64 - 1])
def test_an_id_that_would_be_no_number_keeps_its_bits(number: int) -> None:
    posor = Posor(design("triad_diodes"))
    raw = TableLayout.of(RAW_SCAN.serialize(moving(posor)[0]), RAW_SCAN)
    transforms = TransformConstants("receiving", "target", calibration=number).layout(JOINT_TRANSFORM)
    out = transforms.copies(1)
    for each in (posor, in_python(posor)):
        out.rows[:] = 0
        assert MessageEstimator(each, MessageStream.of(raw, transforms, raw.row[None].copy(), out.rows)).estimate_rows()
        assert decode(out.messages[0].tobytes()).calibration == number


@pytest.mark.parametrize("plain", [False, True])
def test_only_the_fault_effects_are_left_out_while_nobody_reads_them(*, plain: bool) -> None:
    posors = [Posor(design("triad_diodes", motion=True)) for _ in range(2)]
    raw = [RAW_SCAN.serialize(message) for message in moving(posors[0])]
    stream, whole = (RawScanStream(in_python(each) if plain else each, raw[0]) for each in posors)
    for n, data in enumerate(raw):
        stream.use_effects(used=n % 3 == 0)
        found, wanted = stream.estimate_message(data), whole.estimate_message(data)
        if n % 3:
            message = decode(wanted)
            message.effects = [math.nan] * len(message.effects)
            wanted = JOINT_TRANSFORM.serialize(message)
        assert found == wanted


def in_python(posor: Posor) -> Posor:
    """Return a POSOR that takes the path of sensors written in plain Python."""
    posor._plain.present = True
    return posor


def test_the_path_of_plain_sensors_gives_the_bytes_of_the_estimates() -> None:
    calibration = design("triad_bumpy_ring", motion=True)
    messages = moving(Posor(calibration))
    messages[5].header.stamp.sec = messages[5].header.stamp.nanosec = 0
    raw = [RAW_SCAN.serialize(message) for message in messages]
    stream = RawScanStream(in_python(Posor(calibration)), raw[0])
    found = [stream.estimate_message(data) for data in raw]
    assert decode(found.pop(5)).faults == Fault.BAD_READING
    assert found == expected(in_python(Posor(calibration)), messages[:5] + messages[6:])
    other = moving(Posor(calibration))[0]
    other.gap_voltages = [0.1]
    assert stream.estimate_message(RAW_SCAN.serialize(other)) is None


def test_the_last_scan_and_its_estimate_are_kept() -> None:
    posor = Posor(design("triad_diodes"))
    messages = moving(posor)
    stream, other = RawScanStream(posor, RAW_SCAN.serialize(messages[0])), Posor(posor.calibration)
    for message in messages:
        data = RAW_SCAN.serialize(message)
        stream.estimate_message(data)
        estimate = other.estimate(scan_of(data))
        status = [stream.status[name].item() for name in ("stamp_ns", "state", "faults")]
        assert status == [scan_of(data).stamp_ns, estimate.state, estimate.faults]
        answered = stream.last_scan()
        assert answered.stamp_ns == scan_of(data).stamp_ns
        assert (answered.number, answered.redundancy) == (message.scan, estimate.redundancy)
        assert answered.residual == pytest.approx(estimate.residual, nan_ok=True, rel=0.0, abs=0.0)
        assert stream.last_scan().reason == estimate.reason


def test_a_change_of_the_light_source_counts_as_row_change() -> None:
    posor = Posor(design("triad_diodes"))
    messages = moving(posor)
    stream = RawScanStream(posor, RAW_SCAN.serialize(messages[0]))
    seen = []
    for lit in ([0, 0], [0, 0], [1, 0], [1, 0], [0, 0]):
        messages[0].header.stamp.nanosec += 1
        messages[0].lit_sources = lit
        stream.estimate_message(RAW_SCAN.serialize(messages[0]))
        seen.append((stream.status["row_changes"].item(), stream.status["changed"].item()))
    assert seen == [(1, 1), (1, 0), (2, 1), (2, 0), (3, 1)]


@pytest.mark.parametrize("compiled", [True, False])
def test_another_state_or_fault_is_a_status_change(compiled: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_diodes"))
    posor = posor if compiled else in_python(posor)
    messages = moving(posor)[:7]
    stream = RawScanStream(posor, RAW_SCAN.serialize(messages[0]))
    messages[3].gap_voltages[0] = messages[4].gap_voltages[0] = math.nan
    messages[5].diode_currents[0] *= 1.5
    seen = []
    for message in messages:
        stream.estimate_message(RAW_SCAN.serialize(message))
        state, faults, changed = (stream.status[name].item() for name in ("state", "faults", "changed"))
        seen.append((State(state), Fault(faults), changed))
    bad, far = (State.LOST, Fault.BAD_READING), (State.LOST, Fault.RESIDUAL)
    sound = (State.OK, Fault(0))
    assert seen == [(*sound, 1), (*sound, 0), (*sound, 0), (*bad, 1), (*bad, 0), (*far, 1), (*sound, 1)]


def test_a_scan_of_another_layout_is_not_estimated_and_changes_nothing() -> None:
    calibration = design("triad_diodes")
    messages = moving(Posor(calibration))
    first, second = (RAW_SCAN.serialize(message) for message in messages[:2])
    undisturbed = RawScanStream(Posor(calibration), first)
    wanted = [undisturbed.estimate_message(data) for data in (first, second)]
    stream = RawScanStream(Posor(calibration), first)
    assert stream.estimate_message(first) == wanted[0]

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
        assert stream.estimate_message(other) is None
        assert (stream.last_scan().number, stream.status["state"].item()) == (messages[0].scan, State.OK)
        assert stream.last_scan().reason == ""
    assert stream.estimate_message(second + b"surplus bytes at the end") == wanted[1]


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("spoil", ["frame", "stamp", "nanoseconds"])
def test_unusable_scans_are_lost_and_every_number_is_nan(spoil: str, known: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_diodes"))
    sound, message = (moving(posor)[n] for n in range(2))
    before = RAW_SCAN.serialize(sound)
    if known:
        assert decode(RawScanStream(posor, before).estimate_message(before)).state == State.OK
    reason = "the stamp is zero, or its nanoseconds are a second or more; expected the time of exposure."
    if spoil == "frame":
        message.header.frame_id = "elsewhere"
        reason = "comes from frame 'elsewhere'; expected 'receiving', as in the calibration."
    elif spoil == "stamp":
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    else:
        message.header.stamp.nanosec = 1_000_000_000
    data = RAW_SCAN.serialize(message)
    stream = RawScanStream(posor, data)
    lost = decode(stream.estimate_message(data))
    assert (lost.scan, lost.scan_status, lost.header.stamp) == (message.scan, message.status, message.header.stamp)
    assert (lost.header.frame_id, lost.child_frame_id) == ("receiving", "target")
    assert (lost.state, lost.faults, lost.redundancy) == (State.LOST, Fault.BAD_READING, 0)
    assert np.isnan(
        [
            *lost.covariance_random,
            *lost.covariance_systematic,
            *lost.stamp_shift,
            *lost.native,
            lost.residual,
            lost.pose.position.x,
            lost.pose.orientation.w,
        ]
    ).all()
    assert (stream.status["state"].item(), stream.status["faults"].item()) == (State.LOST, Fault.BAD_READING)
    assert math.isnan(stream.last_scan().residual)
    assert stream.last_scan().reason == f"scan {message.scan}: {reason}"


@pytest.mark.parametrize("compiled", [True, False])
def test_unusable_scans_leave_count_and_previous_pose_alone(compiled: bool) -> None:  # noqa: FBT001
    posor = Posor(design("triad_bumpy_ring", motion=True))
    posor = posor if compiled else in_python(posor)
    messages = moving(posor, start=0.0)[: 1 + MARKS]
    raw = [RAW_SCAN.serialize(message) for message in messages]
    undisturbed = RawScanStream(posor, raw[0])
    wanted = [undisturbed.estimate_message(data) for data in raw]
    assert decode(wanted[-1]).state == State.OK
    posor.reset()
    stream = RawScanStream(posor, raw[0])
    messages[0].header.stamp.sec = messages[0].header.stamp.nanosec = 0
    without_time = RAW_SCAN.serialize(messages[0])
    messages[1].header.frame_id = "elsewhere"
    foreign = RAW_SCAN.serialize(messages[1])
    for data, expected_answer in zip(raw, wanted, strict=True):
        assert stream.estimate_message(data) == expected_answer
        assert decode(stream.estimate_message(without_time)).state == State.LOST
        assert decode(RawScanStream(posor, foreign).estimate_message(foreign)).state == State.LOST


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
        stream, other = RawScanStream(Posor(calibration), data), Posor(calibration)
        assert decode(stream.estimate_message(data)).state == State.LOST
        assert said in stream.last_scan().reason
        assert stream.last_scan().reason == other.estimate(scan_of(data)).reason


SOME = {  # how many of each a scan may have, or none
    "gap_voltages": 3,
    "gap_voltage_spreads": 3,
    "ring_voltages": 4,
    "ring_voltage_spreads": 4,
    "diode_currents": 8,
    "diode_current_spreads": 8,
    "lit_sources": 2,
}


@pytest.mark.parametrize("given", list(product([False, True], repeat=len(SOME))))
def test_a_scan_with_missing_sequences_is_estimated(given: tuple[bool, ...]) -> None:
    """An empty sequence is not aligned; spreads come from a driver that averages samples."""
    calibration = design("triad_diodes")
    message = moving(Posor(calibration))[0]
    for (name, count), there in zip(SOME.items(), given, strict=True):
        if not there:
            setattr(message, name, [])
        elif not len(getattr(message, name)):
            setattr(message, name, [1e-3] * count)
    data = RAW_SCAN.serialize(message)
    stream = RawScanStream(Posor(calibration), data)
    assert [stream.estimate_message(data)] == expected(Posor(calibration), [message])


def test_bytes_that_are_not_a_raw_scan_are_refused() -> None:
    error = refusal(TopicError, RawScanStream, Posor(design("triad_diodes")), b"\x00\x01\x00\x00abc")
    assert (error.where, error.what) == ("RawScan", "a message of 7 bytes ends within 'header.stamp.sec'")


@pytest.mark.parametrize("compiled", [True, False])
def test_theta_is_counted_from_the_next_usable_scan(compiled: bool) -> None:  # noqa: FBT001
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
    messages[0].header.stamp = messages[1].header.stamp
    messages[0].gap_voltages[0] = math.inf
    with_bad_voltage = RAW_SCAN.serialize(messages[0])
    for before in ([], raw[:1], [without_time], [with_bad_voltage]):
        stream = RawScanStream(estimator(), raw[0])
        for data in before:
            assert decode(stream.estimate_message(data)).state in (State.UNCOUNTED, State.LOST)
        stream.count_from_next()
        assert stream.counts_from_next
        if before in ([without_time], [with_bad_voltage]):
            assert decode(stream.estimate_message(before[0])).state == State.LOST
            assert stream.counts_from_next
        counted = decode(stream.estimate_message(raw[1]))
        assert counted.state == State.OK
        assert abs(counted.native[5]) < 0.5 * BUMP
        assert counted.scan_status == messages[1].status
        assert not stream.counts_from_next
        assert decode(stream.estimate_message(raw[3])).state == State.OK


def test_a_scan_is_the_same_whatever_its_padding_holds() -> None:
    calibration = design("triad_diodes", frames=("r", "target"))
    messages = moving(Posor(calibration))[:2]
    for message in messages:
        message.header.frame_id = "r"
    first, second = (RAW_SCAN.serialize(message) for message in messages)
    stream, other = RawScanStream(Posor(calibration), first), RawScanStream(Posor(calibration), first)
    assert stream.estimate_message(first) == other.estimate_message(first)
    end = second.index(b"r\x00", 12) + 2
    padded = second[:end] + b"\xaa" * (-end % 4) + second[end + (-end % 4) :]
    assert padded != second
    assert stream.estimate_message(padded) == other.estimate_message(second)


def test_only_a_group_of_scans_has_a_call_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    calibration = design("triad_diodes")
    data = RAW_SCAN.serialize(moving(Posor(calibration))[0])
    streams = [RawScanStream(Posor(calibration), data) for _ in range(2)]
    expected = RawScanStream(Posor(calibration), data).estimate_message(data)
    groups = list[int]()

    def counted_run_in_turn(kernels: list[BoundKernel]) -> Callable[[], object]:
        groups.append(len(kernels))
        return run_in_turn(kernels)

    monkeypatch.setattr(message_stream, "run_in_turn", counted_run_in_turn)
    for group in [(streams[0],), (streams[1],), tuple(streams), tuple(streams)]:
        for stream in group:
            assert stream.prepare(data, message_stream.RECORDED, only_expected=False)
        RawScanStream.run_prepared(group)
        assert all(len(stream.finish(data) or b"") == len(expected or b"") for stream in group)
    assert groups == [2]


def test_a_new_stream_releases_the_one_that_it_replaces() -> None:
    calibration = design("triad_diodes")
    data = RAW_SCAN.serialize(moving(Posor(calibration))[0])
    streams = [RawScanStream(Posor(calibration), data) for _ in range(2)]
    for stream in streams:
        stream.prepare(data, message_stream.RECORDED, only_expected=False)
    RawScanStream.run_prepared(tuple(streams))
    replaced = ref(streams[0])
    del stream
    streams[0] = RawScanStream(Posor(calibration), data)
    collect()
    assert replaced() is None
