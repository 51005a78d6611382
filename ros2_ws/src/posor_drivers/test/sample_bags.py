# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Small bags for tests, built by hand."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import POINT_STAMPED, RAW_SCAN
from posor_drivers import message_builder
from rosbags.rosbag2 import StoragePlugin, Writer

TYPES = MessageTypes()
FRAME = "posor_receiving"


class Record(NamedTuple):
    topic: str
    type_name: str
    time_ns: int
    data: bytes


def header(stamp_ns: int, frame_id: str = FRAME) -> Any:
    return message_builder.header(TYPES, stamp_ns, frame_id)


def scan(
    number: int, time_ns: int, *, stamp_ns: int | None = None, topic: str = "/joint1/raw", **fields: Any
) -> Record:
    """Return a recorded scan; its stamp is its log time by default, ``fields`` replace those of the usual scan."""
    usual = {
        "scan": number,
        "gap_voltages": np.array([0.1, float("nan"), 0.3]),
        "diode_currents": np.full(8, 5e-5),
        "lit_sources": np.array([0, 1], dtype=np.uint8),
    }
    content = message_builder.raw_scan(TYPES, time_ns if stamp_ns is None else stamp_ns, FRAME, **(usual | fields))
    return Record(topic, RAW_SCAN, time_ns, TYPES.serialize(content, RAW_SCAN))


def point(time_ns: int) -> Record:
    """Return a recorded point with a header."""
    content = message_builder.point_stamped(TYPES, time_ns, "machining_centre", (1.0, 2.0, 3.0))
    return Record("/truth/machining_centre", POINT_STAMPED, time_ns, TYPES.serialize(content, POINT_STAMPED))


def text(time_ns: int, topic: str = "/remarks") -> Record:
    name = "std_msgs/msg/String"
    return Record(topic, name, time_ns, TYPES.serialize(TYPES.new(name, data="remark"), name))


def write_bag(
    path: Path,
    records: Iterable[Record],
    *,
    sqlite: bool = False,
    type_hash: str | None = None,
    definition_of_scans: str | None = None,
) -> Path:
    """Write a bag; ``type_hash``, ``definition_of_scans``: instead of the installed ones."""
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for record in records:
            key = record.topic, record.type_name
            if key not in connections:
                definition = TYPES.definition(record.type_name)
                definition_text = definition.text
                if definition_of_scans is not None and record.type_name == RAW_SCAN:
                    definition_text = definition_of_scans
                connections[key] = writer.add_connection(
                    record.topic, record.type_name, msgdef=definition_text, rihs01=type_hash or definition.type_hash
                )
            writer.write(connections[key], record.time_ns, record.data)
    return path
