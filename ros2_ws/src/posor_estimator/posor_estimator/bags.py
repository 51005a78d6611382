"""Recordings for calibration, out of rosbag2 bags: the scans of a POSOR and what instruments measured beside them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.serialization import deserialize_message

from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.kernels.chain_pose import UNIT_WITHIN
from posor_estimator.core.kernels.diode import CONTACTS
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.errors import BagError, TrackError
from posor_estimator.ros.bag_reader import check_filled, checked_type, counted_messages, opened_bag, scan_topic
from posor_estimator.ros.message_types import POINT_STAMPED, RAW_SCAN, MessageTypes, message_class
from posor_estimator.ros.messages import scan_from_message, stamp_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor_estimator.core.types import FloatArray

FLOAT64 = "std_msgs/msg/Float64"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"


@dataclass(frozen=True)
class Reference:
    """A reference measurement to read from a bag.

    Attributes:
        topic: Where it was recorded.
        sigmas: Standard uncertainty of the instrument: one for all its quantities, or one for each, in their units.

    """

    topic: str
    sigmas: tuple[float, ...] = (0.0,)


def load_recording(path: Path, *, topic: str = "", references: Sequence[Reference] = ()) -> Recording:
    """Read scans and reference measurements.

    Args:
        path: Folder with metadata.yaml, or a single .mcap or .db3 file.
        topic: Of the scans; empty: the only one there is.
        references: What to read beside them; none named: every topic of a type that can be a reference, its own
            uncertainty taken as zero. A ``std_msgs/Float64`` has no stamp: the time it was recorded at stands for it.

    Raises:
        BagError: The bag cannot be read, lacks a topic, or holds scans that do not belong together.
        TrackError: A reference cannot be used: stamps that go back, numbers that are none.

    """
    where = str(path)
    with opened_bag(path) as reader:
        scans_topic = scan_topic(reader.connections, topic, where, "the topic of the scans")
        if not references:
            names = {connection.topic for connection in reader.connections if connection.msgtype in _READERS}
            references = [Reference(name) for name in sorted(names)]
        types = MessageTypes()
        kinds = {scans_topic: checked_type(reader.connections, scans_topic, where, types, (RAW_SCAN,))}
        for reference in references:
            kinds[reference.topic] = checked_type(reader.connections, reference.topic, where, types, tuple(_READERS))
        for name in kinds:
            check_filled(reader.connections, name, where)
        collected: dict[str, list[tuple[int, Any]]] = {name: [] for name in kinds}
        classes = {name: message_class(kind) for name, kind in kinds.items()}
        for connection, time_ns, data in counted_messages(reader, kinds, where):
            collected[connection.topic].append((time_ns, deserialize_message(data, classes[connection.topic])))
    messages = [message for _, message in collected[scans_topic]]
    return Recording(
        scans=_scans(messages, f"{where}, topic {scans_topic}"),
        tracks={
            reference.topic: _track(kinds[reference.topic], collected[reference.topic], reference, where)
            for reference in references
        },
        source=where,
        sha256=bag_sha256(path),
        statuses=np.array([message.status for message in messages], dtype=np.int64),
        frame=messages[0].header.frame_id,
    )


def bag_sha256(path: Path) -> str:
    """Return what identifies a bag, 64 hexadecimal digits.

    Of a single file, its SHA-256. Of a folder, that of the list that ``sha256sum`` prints of its metadata.yaml and
    storage files, sorted by name.
    """
    if not path.is_dir():
        return _file_sha256(path)
    files = sorted(
        file for file in path.iterdir() if file.name == "metadata.yaml" or file.suffix in {".mcap", ".db3", ".zstd"}
    )
    listing = "".join(f"{_file_sha256(file)}  {file.name}\n" for file in files)
    return hashlib.sha256(listing.encode()).hexdigest()


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _scans(messages: Sequence[Any], where: str) -> Scans:
    """Return the scans of messages, all with the same readings, in the order of their stamps."""
    scans = [scan_from_message(message) for message in messages]
    for scan in scans:
        if scan.diode_currents.size and scan.diode_currents.shape[1] != CONTACTS:
            raise BagError(
                f"scan {scan.number} has {scan.diode_currents.size} diode currents",
                where=where,
                expected="4 for each diode",
            )
        if _shape_in_words(scan) != _shape_in_words(scans[0]):
            raise BagError(
                f"scan {scan.number} has {_shape_in_words(scan)}", where=where, expected=_shape_in_words(scans[0])
            )
    stamps = np.array([scan.stamp_ns for scan in scans])
    if stamps[0] == 0:
        raise BagError(f"scan {scans[0].number} has no stamp", where=where, expected="the middle of its exposure")
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if back.size:
        after, before = scans[back[0] + 1], scans[back[0]]
        raise BagError(
            f"scan {after.number} is stamped {after.stamp_ns} ns, scan {before.number} before it {before.stamp_ns} ns",
            where=where,
            expected="stamps that increase",
        )
    return Scans.of(scans)


def _shape_in_words(scan: Scan) -> str:
    sizes = [len(getattr(scan, name)) for name in _READINGS]
    words = ("gap voltages", "ring voltages", "diodes of 4 currents", "lit sources")
    return ", ".join(f"{size} {word}" for size, word in zip(sizes, words, strict=True))


def _track(kind: str, messages: Sequence[tuple[int, Any]], reference: Reference, source: str) -> Track:
    """Return a reference topic's messages as a track."""
    where = f"{source}, topic {reference.topic}"
    stamps = [time_ns if kind == FLOAT64 else stamp_ns(message) for time_ns, message in messages]
    if stamps[0] == 0:
        raise TrackError("the first message has no stamp", where=where, expected="the time of the measurement")
    if kind == TRANSFORM_STAMPED:
        frames = sorted({f"{message.header.frame_id} to {message.child_frame_id}" for _, message in messages})
        if len(frames) > 1:
            raise TrackError(f"transforms between {', '.join(frames)}", where=where, expected="two frames only")
    values = np.array([_READERS[kind](message) for _, message in messages], dtype=float)
    if kind == TRANSFORM_STAMPED:
        values = _continued(values, where)
    sigmas = np.array(reference.sigmas, dtype=float)
    if sigmas.size not in (1, values.shape[1]) or not np.all(np.isfinite(sigmas)) or np.any(sigmas < 0.0):
        raise TrackError(
            f"standard uncertainty {', '.join(f'{sigma:g}' for sigma in sigmas)}",
            where=where,
            expected=f"one number, or {values.shape[1]}, of zero or more",
        )
    return Track(np.array(stamps, dtype=np.int64), values, np.broadcast_to(sigmas, values.shape[1]).copy(), where)


def _continued(poses: FloatArray, where: str) -> FloatArray:
    """Return poses (n, 7) whose quaternions keep their sign from one to the next (q and -q are the same rotation)."""
    lengths = np.linalg.norm(poses[:, 3:], axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT_WITHIN))
    if bad.size:
        raise TrackError(
            f"rotation {bad[0] + 1} has the length {lengths[bad[0]]:.9g}", where=where, expected="a unit quaternion"
        )
    turned = np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1) < 0.0
    signs = np.cumprod(np.concatenate([[1.0], np.where(turned, -1.0, 1.0)]))
    return np.hstack([poses[:, :3], poses[:, 3:] * signs[:, None]])


def _of_transform(message: Any) -> list[float]:
    moved, turned = message.transform.translation, message.transform.rotation
    return [moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w]


_READINGS = ("gap_voltages", "ring_voltages", "diode_currents", "lit_sources")
_READERS: dict[str, Callable[[Any], list[float]]] = {
    POINT_STAMPED: lambda message: [message.point.x, message.point.y, message.point.z],
    TRANSFORM_STAMPED: _of_transform,
    FLOAT64: lambda message: [message.data],
}
