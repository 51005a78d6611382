# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Recordings for calibration as rosbag2 bags, written with the recorder's ``BagWriter``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from posor.bags.bag_writer import BagWriter
from posor.bags.recording import POINT, POSE, SCALAR
from posor.messages.message_definitions import MessageTypes
from posor.model.scan import HOME_BUMP
from posor.ros_names import POINT_STAMPED, RAW_SCAN, TRANSFORM_STAMPED
from posor_drivers.message_builder import point_stamped, raw_scan, scan_fields, transform_stamped

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from posor.bags.recording import Recording
    from posor.model.scan import Scan

TYPES = MessageTypes()
FLOAT64 = "std_msgs/msg/Float64"
RAW = "/joint1/raw"
FRAME = "receiving"
LOG_DELAY_NS = 5_000_000
"""Delay of the log time of a reference after its stamp."""

Entry = tuple[str, str, int, Any]
"""Topic, type, log time [ns], message."""


def raw(scan: Scan, *, status: int = 0, topic: str = RAW, delay_ns: int = 2_000_000, **fields: Any) -> Entry:
    """Return the entry of a scan, logged ``delay_ns`` after its stamp; ``fields`` replace those of the message."""
    message = raw_scan(TYPES, scan.stamp_ns, FRAME, **({"status": status} | scan_fields(scan) | fields))
    return topic, RAW_SCAN, scan.stamp_ns + delay_ns, message


def scalar(topic: str, time_ns: int, value: float) -> Entry:
    """Return the entry of an instrument for one number; it has no stamp, only its log time."""
    return topic, FLOAT64, time_ns, TYPES.new(FLOAT64, data=value)


def point(topic: str, stamp_ns: int, values: Iterable[float], *, delay_ns: int = LOG_DELAY_NS) -> Entry:
    """Return the entry of a point x, y, z [m]."""
    return topic, POINT_STAMPED, stamp_ns + delay_ns, point_stamped(TYPES, stamp_ns, FRAME, values)


def transform(topic: str, stamp_ns: int, values: Iterable[float], child: str = "target") -> Entry:
    """Return the entry of a pose: x, y, z [m] and the unit quaternion x, y, z, w."""
    message = transform_stamped(TYPES, stamp_ns, (FRAME, child), values)
    return topic, TRANSFORM_STAMPED, stamp_ns + LOG_DELAY_NS, message


def entries(recording: Recording) -> list[Entry]:
    """Return all messages of a recording."""
    makers: dict[int, Any] = {
        SCALAR: lambda topic, time_ns, values: scalar(topic, time_ns, values[0]),
        POINT: point,
        POSE: transform,
    }
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
