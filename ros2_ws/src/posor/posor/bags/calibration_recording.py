# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans of one POSOR from a bag; recordings for calibration, which add measurements of instruments."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.bags.bag_reader import checked_type, opened_bag, scan_schema, scan_topic
from posor.bags.block_reader import read_blocks, read_messages
from posor.bags.message_block import TopicReader
from posor.bags.recording import POSE, Recording, Track
from posor.chain.identity import file_sha256
from posor.chain.joint_measurements import UNIT_QUATERNION_TOLERANCE
from posor.errors import BagError, TopicError, TrackError, checked_path
from posor.messages.message_definitions import schema_of_topic
from posor.messages.raw_scan import RecordedScans
from posor.model.scan import CONTACTS
from posor.numerics.stamps import time_ns
from posor.ros_names import POINT_STAMPED, POSE_STAMPED, REFERENCE_READING, TRANSFORM_STAMPED

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from posor.bags.ordered_reader import OrderedReader
    from posor.messages.cdr_schema import Value
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

STORAGE_SUFFIXES = {".mcap", ".db3", ".db3-wal", ".db3-journal", ".zstd"}
FLOAT64 = "std_msgs/msg/Float64"


def _pose_fields(position: str, rotation: str) -> tuple[str, ...]:
    return (*(f"{position}.{axis}" for axis in "xyz"), *(f"{rotation}.{axis}" for axis in "xyzw"))


REFERENCE_FIELDS = {  # fields of a reference measurement, by message type
    POINT_STAMPED: ("point.x", "point.y", "point.z"),
    TRANSFORM_STAMPED: _pose_fields("transform.translation", "transform.rotation"),
    POSE_STAMPED: _pose_fields("pose.position", "pose.orientation"),
    FLOAT64: ("data",),
    REFERENCE_READING: ("value",),
}
READINGS = {  # readings of a scan, and their names in errors
    "gap_voltages": "gap voltages",
    "ring_voltages": "ring voltages",
    "diode_currents": "diodes of 4 currents",
    "lit_sources": "lit sources",
}


@dataclass(frozen=True)
class Reference:
    """A reference measurement to read from a bag."""

    topic: str  # where it was recorded
    # Standard uncertainty of the instrument: one for all its quantities, or one for each, in their units
    sigmas: tuple[float, ...] = (0.0,)


def read_scans(bag: Path | str, topic: str = "") -> Scans:
    """Return all raw scans of one topic of a bag; reads the definition stored in the bag and needs no ROS.

    Args:
        bag: Folder with metadata.yaml, or a single .mcap or .db3 file.
        topic: Of the scans; empty: the only one of type RawScan.

    Raises:
        ParameterError: ``bag`` is not a path.
        BagError: The bag cannot be read, lacks the topic, or the numbers of readings or the stamps are inconsistent.

    """
    path = checked_path(bag, "read_scans", "the path of a bag")
    with opened_bag(path) as reader:
        name = scan_topic(reader.connections, topic, str(path), "the topic of the scans")
        return _read_recorded_scans(reader, name, str(path)).scans


def load_recording(
    path: Path, *, topic: str = "", references: Sequence[Reference] = (), named: Collection[str] = ()
) -> Recording:
    """Read scans and reference measurements.

    ``path``: folder with metadata.yaml, or a single .mcap or .db3 file; ``topic``: of the scans; empty: the only one of
    type RawScan; ``references``: measurements to read; empty: every topic of a type that can be a reference, with an
    uncertainty of zero, but a ``geometry_msgs/PoseStamped`` only if it is ``named``: most are endpoints, not
    references. A ``std_msgs/Float64`` has no stamp: its log time is used. A ``posor_msgs/ReferenceReading`` states its
    uncertainty; the largest one applies unless another one is given; ``named``: topics that the caller knows as
    references. Raises BagError: the bag cannot be read, lacks a topic, or holds inconsistent scans; TrackError: a
    reference is invalid: its stamps go back, or its numbers are not finite.
    """
    where = str(path)
    with opened_bag(path) as reader:
        scans_topic = scan_topic(reader.connections, topic, where, "the topic of the scans")
        if not references:
            possible = [each for each in reader.connections if each.msgtype in REFERENCE_FIELDS]
            names = {each.topic for each in possible if each.msgtype != POSE_STAMPED or each.topic in named}
            references = [Reference(name) for name in sorted(names)]
        recorded = _read_recorded_scans(reader, scans_topic, where)
        tracks = _read_tracks(reader, references, where)
    return Recording(
        scans=recorded.scans,
        tracks=tracks,
        source=where,
        sha256=bag_sha256(path),
        statuses=recorded.statuses,
        frame=recorded.frame,
    )


def _read_recorded_scans(reader: OrderedReader, topic: str, where: str) -> RecordedScans:
    """Return the scans of a topic, all with the same readings, in the order of their stamps."""
    place = f"{where}, topic {topic}"
    schema = scan_schema(reader.connections, topic, where)
    topic_reader = TopicReader(0, topic, schema, where)
    parts = [
        RecordedScans.unpack(*table)
        for block in read_blocks(reader, [topic], where)
        for table in topic_reader.read_tables(block)
    ]
    for part in parts:
        currents = part.scans.diode_currents
        if currents.size and currents.shape[2] != CONTACTS:
            raise BagError(
                f"scan {part.scans.numbers[0]} has {currents.shape[1] * currents.shape[2]} diode currents",
                where=place,
                expected="4 for each diode",
            )
        if _reading_counts(part.scans) != _reading_counts(parts[0].scans):
            what = f"scan {part.scans.numbers[0]} has {_reading_counts(part.scans)}"
            raise BagError(what, where=place, expected=_reading_counts(parts[0].scans))
        if part.frame != parts[0].frame:
            what = f"scans are of the receiving plates '{parts[0].frame}' and '{part.frame}'"
            raise BagError(what, where=place, expected="those of one POSOR")
    recorded = RecordedScans.concatenate(parts)
    _check_stamps(recorded.scans, place)
    return recorded


def _reading_counts(scans: Scans) -> str:
    return ", ".join(f"{getattr(scans, name).shape[1]} {words}" for name, words in READINGS.items())


def _check_stamps(scans: Scans, where: str) -> None:
    numbers, stamps = scans.numbers, scans.stamps_ns
    if stamps[0] == 0:
        raise BagError(f"scan {numbers[0]} has no stamp", where=where, expected="the middle of its exposure")
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if back.size:
        n = int(back[0])
        raise BagError(
            f"scan {numbers[n + 1]} is stamped {stamps[n + 1]} ns, scan {numbers[n]} before it {stamps[n]} ns",
            where=where,
            expected="stamps that increase",
        )


def _read_tracks(reader: OrderedReader, references: Sequence[Reference], where: str) -> dict[str, Track]:
    if not references:
        return {}  # rosbags would take an empty list for all topics
    topics = [reference.topic for reference in references]
    known = reader.connections
    kinds = {topic: checked_type(known, topic, where, None, REFERENCE_FIELDS, filled=True) for topic in topics}
    schemas = {topic: schema_of_topic(known, topic, where) for topic in kinds}
    messages: dict[str, list[tuple[int, dict[str, Value]]]] = {topic: [] for topic in topics}
    for connection, logged_ns, data in read_messages(reader, kinds, where):
        try:
            messages[connection.topic].append((logged_ns, schemas[connection.topic].values(data)))
        except TopicError as error:
            place = f"{where}, topic {connection.topic}, logged at {logged_ns} ns"
            raise BagError(f"{error.where}: {error.what}", where=place, expected=error.expected) from error
    return {each.topic: _track(kinds[each.topic], messages[each.topic], each, where) for each in references}


def bag_sha256(path: Path) -> str:
    """Return a digest that identifies a bag, 64 hexadecimal digits.

    For a single file, its SHA-256. For a folder, the SHA-256 of the list that ``sha256sum`` prints of its metadata.yaml
    and storage files, sorted by name.
    """
    if not path.is_dir():
        return file_sha256(path)
    files = sorted(file for file in path.iterdir() if file.name == "metadata.yaml" or file.suffix in STORAGE_SUFFIXES)
    listing = "".join(f"{file_sha256(file)}  {file.name}\n" for file in files)
    return hashlib.sha256(listing.encode()).hexdigest()


def _track(kind: str, messages: Sequence[tuple[int, Mapping[str, Value]]], reference: Reference, source: str) -> Track:
    where = f"{source}, topic {reference.topic}"
    stamps = [
        logged_ns if kind == FLOAT64 else time_ns(message["header.stamp.sec"], message["header.stamp.nanosec"])
        for logged_ns, message in messages
    ]
    if stamps[0] == 0:
        raise TrackError("the first message has no stamp", where=where, expected="the time of the measurement")
    if kind == TRANSFORM_STAMPED:
        frames = sorted({f"{message['header.frame_id']} to {message['child_frame_id']}" for _, message in messages})
        if len(frames) > 1:
            raise TrackError(f"transforms between {', '.join(frames)}", where=where, expected="two frames only")
    stated = sorted({str(message.get("header.frame_id", "")) for _, message in messages})
    if kind in (POSE_STAMPED, POINT_STAMPED) and len(stated) > 1:
        what = "poses" if kind == POSE_STAMPED else "points"
        raise TrackError(f"{what} in {', '.join(stated)}", where=where, expected="one frame only")
    values = np.array([[message[path] for path in REFERENCE_FIELDS[kind]] for _, message in messages], dtype=float)
    if values.shape[1] == POSE:
        values = with_continuous_signs(values, where)
    sigmas = np.array(reference.sigmas, dtype=float)
    if kind == REFERENCE_READING:
        largest = _stated_uncertainty([message for _, message in messages], where)
        sigmas = sigmas if sigmas.any() else np.array([largest])
    if sigmas.size not in (1, values.shape[1]) or not np.all(np.isfinite(sigmas)) or np.any(sigmas < 0.0):
        raise TrackError(
            f"standard uncertainty {', '.join(f'{sigma:g}' for sigma in sigmas)}",
            where=where,
            expected=f"one number, or {values.shape[1]}, of zero or more",
        )
    own = np.broadcast_to(sigmas, values.shape[1]).copy()
    return Track(np.array(stamps, dtype=np.int64), values, own, where, stated[0] if len(stated) == 1 else "")


def _stated_uncertainty(readings: Sequence[Mapping[str, Value]], where: str) -> float:
    """Return the largest standard uncertainty that reference readings of one unit state."""
    units = sorted({str(reading["unit"]) for reading in readings})
    if len(units) > 1:
        raise TrackError(f"readings in {', '.join(units)}", where=where, expected="one unit only")
    return max(float(reading["standard_uncertainty"]) for reading in readings)


def with_continuous_signs(poses: FloatArray, where: str) -> FloatArray:
    """Return poses (n, 7) whose quaternions keep their sign from one to the next (q and -q are the same rotation)."""
    lengths = np.linalg.norm(poses[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT_QUATERNION_TOLERANCE))
    if bad.size:
        raise TrackError(
            f"rotation {bad[0] + 1} has the length {lengths[bad[0]]:.9g}", where=where, expected="a unit quaternion"
        )
    turned = np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0.0
    signs = np.cumprod(np.concatenate([[1.0], np.where(turned, -1.0, 1.0)]))
    return np.hstack([poses[:, :3], poses[:, 3:] * signs[:, None]])
