"""Small bags for tests, made by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor_estimator.ros.message_types import RAW_SCAN, MessageTypes
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

TYPES = MessageTypes()
SECOND = 1_000_000_000


class Record(NamedTuple):
    """One recorded message."""

    topic: str
    type_name: str
    time_ns: int
    data: bytes


def header(stamp_ns: int, frame_id: str = "posor_receiving") -> Any:
    sec, nanosec = divmod(stamp_ns, SECOND)
    stamp = TYPES.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return TYPES.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def scan(
    number: int, time_ns: int, *, stamp_ns: int | None = None, topic: str = "/joint1/raw", **fields: Any
) -> Record:
    """Return a recorded scan; its stamp is its log time unless given, ``fields`` replace those of the usual scan."""
    none = np.empty(0)
    usual = {
        "header": header(time_ns if stamp_ns is None else stamp_ns),
        "scan": number,
        "samples": 1,
        "status": 0,
        "gap_voltages": np.array([0.1, float("nan"), 0.3]),
        "gap_voltage_spreads": none,
        "ring_voltages": none,
        "ring_voltage_spreads": none,
        "diode_currents": np.full(8, 5e-5),
        "diode_current_spreads": none,
        "lit_sources": np.array([0, 1], dtype=np.uint8),
        "supply_voltage": float("nan"),
        "temperature": float("nan"),
    }
    content = TYPES.new(RAW_SCAN, **(usual | fields))
    return Record(topic, RAW_SCAN, time_ns, TYPES.serialize(content, RAW_SCAN))


def point(time_ns: int, topic: str = "/truth/machining_centre") -> Record:
    """Return a recorded point with a header."""
    name = "geometry_msgs/msg/PointStamped"
    position = TYPES.new("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0)
    content = TYPES.new(name, header=header(time_ns, "machining_centre"), point=position)
    return Record(topic, name, time_ns, TYPES.serialize(content, name))


def text(time_ns: int, topic: str = "/remarks") -> Record:
    """Return a recorded message that has no header."""
    name = "std_msgs/msg/String"
    return Record(topic, name, time_ns, TYPES.serialize(TYPES.new(name, data="remark"), name))


def write_bag(path: Path, records: Iterable[Record], *, sqlite: bool = False, type_hash: str | None = None) -> Path:
    """Write a bag and return its path; ``type_hash`` stands for another version of every type."""
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for record in records:
            key = record.topic, record.type_name
            if key not in connections:
                definition = TYPES.definition(record.type_name)
                connections[key] = writer.add_connection(
                    record.topic, record.type_name, msgdef=definition.text, rihs01=type_hash or definition.type_hash
                )
            writer.write(connections[key], record.time_ns, record.data)
    return path


def read_bag(path: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, log time and bytes of all messages, in order."""
    with Reader(path) as reader:
        return [(connection.topic, time_ns, bytes(data)) for connection, time_ns, data in reader.messages()]
