"""Recordings for calibration as rosbag2 bags, written by the recorder's own writer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from posor_estimator.core.calibrate.recording import POINT, POSE, SCALAR
from posor_estimator.ros.message_types import POINT_STAMPED, RAW_SCAN, MessageTypes

from posor_drivers.bag_writer import BagWriter

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.scan import Scan

TYPES = MessageTypes()
FLOAT64 = "std_msgs/msg/Float64"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
HOME_BUMP = 128
"""Status bit of ``posor_msgs/RawScan``: the ring's home mark was seen."""
NS = 1_000_000_000
RAW = "/joint1/raw"

Entry = tuple[str, str, int, Any]
"""Topic, type, log time [ns], message."""


def header(stamp_ns: int, frame_id: str = "receiving") -> Any:
    """Return a header."""
    sec, nanosec = divmod(stamp_ns, NS)
    stamp = TYPES.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return TYPES.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def raw(scan: Scan, *, status: int = 0, topic: str = RAW, delay_ns: int = 2_000_000, **fields: Any) -> Entry:
    """Return a scan as it is recorded, some time after its stamp; ``fields`` replace those of the message."""
    none = np.empty(0)
    usual = {
        "header": header(scan.stamp_ns),
        "scan": scan.number,
        "samples": 1,
        "status": status,
        "gap_voltages": scan.gap_voltages,
        "gap_voltage_spreads": none,
        "ring_voltages": scan.ring_voltages,
        "ring_voltage_spreads": none,
        "diode_currents": scan.diode_currents.ravel(),
        "diode_current_spreads": none,
        "lit_sources": np.array(scan.lit_sources, dtype=np.uint8),
        "supply_voltage": scan.supply_voltage,
        "temperature": scan.temperature,
    }
    return topic, RAW_SCAN, scan.stamp_ns + delay_ns, TYPES.new(RAW_SCAN, **(usual | fields))


def scalar(topic: str, time_ns: int, value: float) -> Entry:
    """Return what an instrument for one number said; it has no stamp but the time it was recorded at."""
    return topic, FLOAT64, time_ns, TYPES.new(FLOAT64, data=value)


def point(topic: str, stamp_ns: int, values: Iterable[float], *, delay_ns: int = 5_000_000) -> Entry:
    """Return a point x, y, z [m], recorded some time after its stamp."""
    x, y, z = values
    content = TYPES.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return topic, POINT_STAMPED, stamp_ns + delay_ns, TYPES.new(POINT_STAMPED, header=header(stamp_ns), point=content)


def transform(topic: str, stamp_ns: int, values: Iterable[float], child: str = "target") -> Entry:
    """Return a pose: x, y, z [m] and the unit quaternion x, y, z, w."""
    x, y, z, qx, qy, qz, qw = values
    moved = TYPES.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    turned = TYPES.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw)
    content = TYPES.new("geometry_msgs/msg/Transform", translation=moved, rotation=turned)
    message = TYPES.new(TRANSFORM_STAMPED, header=header(stamp_ns), child_frame_id=child, transform=content)
    return topic, TRANSFORM_STAMPED, stamp_ns + 5_000_000, message


def entries(recording: Recording) -> list[Entry]:
    """Return all messages of a recording."""
    makers: dict[int, Any] = {SCALAR: lambda *a: scalar(a[0], a[1], a[2][0]), POINT: point, POSE: transform}
    statuses = np.zeros(len(recording.scans), dtype=np.int64) if recording.statuses is None else recording.statuses
    statuses = statuses | HOME_BUMP * recording.scans.at_home
    out = [raw(recording.scans[n], status=int(status)) for n, status in enumerate(statuses)]
    for topic, track in recording.tracks.items():
        for stamp, values in zip(track.stamps_ns.tolist(), track.values.tolist(), strict=True):
            out.append(makers[len(values)](topic, stamp, values))
    return out


def write_bag(path: Path, messages: Iterable[Entry]) -> Path:
    """Write a bag of messages in the order of their log times."""
    with BagWriter(path) as writer:
        for topic, type_name, time_ns, message in sorted(messages, key=lambda entry: entry[2]):
            if topic not in writer.counts:
                writer.add_topic(topic, type_name, TYPES.definition(type_name), [])
            writer.write(topic, time_ns, TYPES.serialize(message, type_name))
    return path
