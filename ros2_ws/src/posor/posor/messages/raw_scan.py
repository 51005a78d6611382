# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Raw scans (``posor_msgs/RawScan``): from the bytes of messages to readings, and written from a template."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import BagError, ShapeError
from posor.messages.cdr_schema import STAMP
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import LEAD, MessageRows, MessageTable, TableLayout
from posor.model.scan import HOME_BUMP, SCAN, Scan, Scans
from posor.numerics.array_types import IntArray  # noqa: TC001  read by dataclasses
from posor.numerics.compiled import in_place, record_view
from posor.numerics.stamps import NS, time_in_kernel
from posor.ros_names import RAW_SCAN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import BoolArray

FIELDS = {  # fields that are read, and their ``struct`` codes
    "header.stamp.sec": "i",
    "header.stamp.nanosec": "I",
    "scan": "Q",
    "status": "I",
    "gap_voltages": "d",
    "ring_voltages": "d",
    "diode_currents": "d",
    "lit_sources": "B",
    "supply_voltage": "d",
    "temperature": "d",
    "header.frame_id": "s",
}
LATER_FIELDS = ("exposure_offsets", "exposure_span", "stamp_uncertainty", "stamp_limit", "reference_voltage")
"""Fields that an older recording lacks: its channels were read at one time, nothing is stated on its stamps, and no
reference voltage was read."""
COUNTS = {  # sequences of readings, and the names of their lengths in SCAN and RAW_SCAN_LAYOUT
    "gap_voltages": "gap_count",
    "ring_voltages": "ring_count",
    "diode_currents": "current_count",
    "lit_sources": "lit_count",
    "exposure_offsets": "offset_count",
}
RAW_SCAN_LAYOUT = np.dtype(
    [
        (name, "i8")
        for name in (
            "stamp",
            "number",
            "status",
            *COUNTS,
            *COUNTS.values(),
            "supply_voltage",
            "temperature",
            *LATER_FIELDS[1:],
        )
    ]
)
"""Byte offsets of the fields in a row of bytes (0: missing), and the lengths of the sequences.

The stamp is seconds, then nanoseconds, four bytes each; a lit source is one byte.
"""

_ARRAYS = ("log_times_ns", "order", "header_stamps", "statuses")  # of RecordedScans
_STAMP = struct.Struct("<iI")
_NUMBER = struct.Struct("<Q")
_STATUS = struct.Struct("<I")


def raw_scan_layout(raw: TableLayout) -> NDArray[np.void]:
    """Return the record of dtype RAW_SCAN_LAYOUT, shape (1,), of messages with a layout.

    Raises ShapeError: a sequence is longer than its bound; names the field, the expected and the received shape.
    """
    layout = np.zeros(1, dtype=RAW_SCAN_LAYOUT)
    paths = {"stamp": "header.stamp.sec", "number": "scan"}
    fields: Any = raw.dtype.fields
    paths |= {name: name for name in ("status", "supply_voltage", "temperature", *LATER_FIELDS[1:]) if name in fields}
    for name, path in paths.items():
        layout[name] = LEAD + raw.offset(path)
    for name, count in COUNTS.items():
        if name not in fields:
            continue
        shape, bound = fields[name][0].shape, SCAN[name].shape
        if shape > bound:
            raise ShapeError(name, received=shape, expected=f"at most {bound[0]} readings")
        layout[count] = shape[0]
        if shape[0]:  # the place of an empty sequence is not aligned
            layout[name] = LEAD + raw.offset(name)
    return layout


@in_place
def unpack_scan(rows: MessageRows, n: int, layout: Any, scan: Any) -> None:
    """Write the raw scan in row n into a record of dtype SCAN; the stamp is 0 where it is invalid."""
    words, floats = rows.words, rows.floats
    scan.stamp_ns = time_in_kernel(int(words[n, layout.stamp // 4]), int(words[n, layout.stamp // 4 + 1]) & 0xFFFFFFFF)
    number = layout.number // 4
    scan.number = int(words[n, number]) & 0xFFFFFFFF | (int(words[n, number + 1]) & 0xFFFFFFFF) << 32
    scan.status = int(words[n, layout.status // 4]) & 0xFFFFFFFF
    scan.at_home = 1 if scan.status & HOME_BUMP else 0
    scan.gap_count, scan.ring_count = layout.gap_count, layout.ring_count
    scan.current_count, scan.lit_count = layout.current_count, layout.lit_count
    for i in range(layout.gap_count):
        scan.gap_voltages[i] = floats[n, layout.gap_voltages // 8 + i]
    for i in range(layout.ring_count):
        scan.ring_voltages[i] = floats[n, layout.ring_voltages // 8 + i]
    for i in range(layout.current_count):
        scan.diode_currents[i] = floats[n, layout.diode_currents // 8 + i]
    for i in range(layout.lit_count):
        scan.lit_sources[i] = rows.octets[n, layout.lit_sources + i]
    scan.offset_count = layout.offset_count
    for i in range(layout.offset_count):
        scan.exposure_offsets[i] = floats[n, layout.exposure_offsets // 8 + i]
    scan.exposure_span = floats[n, layout.exposure_span // 8] if layout.exposure_span else 0.0
    scan.stamp_uncertainty = floats[n, layout.stamp_uncertainty // 8] if layout.stamp_uncertainty else 0.0
    scan.stamp_limit = floats[n, layout.stamp_limit // 8] if layout.stamp_limit else 0.0
    scan.supply_voltage = floats[n, layout.supply_voltage // 8]
    scan.temperature = floats[n, layout.temperature // 8]
    scan.reference_voltage = floats[n, layout.reference_voltage // 8] if layout.reference_voltage else math.nan


@in_place
def unpack_rows(rows: MessageRows, layout: Any, scans: NDArray[np.void]) -> None:
    """Write the raw scan in each row into the record (dtype SCAN) of the same index."""
    for n in range(scans.shape[0]):
        unpack_scan(rows, n, layout[0], scans[n])


def _scans_of(rows: MessageRows, raw: TableLayout) -> Scans:
    records = np.zeros(len(rows.octets), dtype=SCAN)
    unpack_rows(rows, record_view(raw_scan_layout(raw)), record_view(records))
    return Scans(records)


def scan_of(data: bytes) -> Scan:
    """Return a serialised raw scan with any numbers of readings. Raises TopicError: the bytes are not a raw scan."""
    schema = installed_schema(RAW_SCAN)
    layout = TableLayout.of(schema.normal(data), schema)
    return _scans_of(MessageRows.of(layout.row[None]), layout)[0]


@dataclass(frozen=True)
class RecordedScans:
    """Successive scans of one joint with the same readings, n of them, as a bag holds them."""

    log_times_ns: IntArray  # shape (n,)
    order: IntArray  # positions among the messages of all joints that were read together, shape (n,)
    scans: Scans  # the readings
    header_stamps: IntArray  # seconds and nanoseconds as recorded, which may be invalid, shape (n, 2)
    statuses: IntArray  # ``posor_msgs/RawScan.status``, shape (n,)
    frame: str  # frame of the receiving plate

    @staticmethod
    def unpack(log_times_ns: IntArray, order: IntArray, table: MessageTable) -> RecordedScans:
        """Return the scans of a table of RawScan messages. Raises ShapeError: a sequence is longer than its bound."""
        scans = _scans_of(MessageRows.of(table.rows), table.layout)
        stamps = np.column_stack([table[f"header.stamp.{part}"].astype(np.int64) for part in ("sec", "nanosec")])
        frame = table.layout.strings["header.frame_id"]
        return RecordedScans(log_times_ns, order, scans, stamps, scans.statuses, frame)

    def __len__(self) -> int:
        return len(self.log_times_ns)

    def select(self, which: BoolArray) -> RecordedScans:
        """Return some of the scans."""
        arrays = {name: getattr(self, name)[which] for name in _ARRAYS}
        return replace(self, scans=self.scans.select(which), **arrays)

    @staticmethod
    def concatenate(parts: Sequence[RecordedScans]) -> RecordedScans:
        """Return the scans of several parts, all with the same readings; the frame is that of the first part."""
        scans = Scans.concatenate([part.scans for part in parts])
        arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS}
        return replace(parts[0], scans=scans, **arrays)


def check_raw_scan_schema(schema: Schema, where: str) -> None:
    """Check that a stored definition of RawScan has all fields that are read.

    Raises BagError: a field is missing, or has another type.
    """
    for path, code in {**FIELDS, **dict.fromkeys(LATER_FIELDS, "d")}.items():
        field = schema.by_path.get(path)
        if field is None and path in LATER_FIELDS:
            continue
        if field is None or field.code != code:
            what = "is missing" if field is None else f"is of type '{field.code}'"
            raise BagError(
                f"field {path} of the recorded RawScan {what}", where=where, expected=f"type '{code}' (struct code)"
            )


class ScanTemplate:
    """A raw scan that is sent repeatedly with another stamp, scan number and status.

    Attributes:
        status: Status flags of the original scan.

    """

    def __init__(self, data: bytes) -> None:
        """Prepare from a serialised raw scan. Raises TopicError: the bytes are not a raw scan."""
        schema = installed_schema(RAW_SCAN)
        data = schema.normal(data)
        layout = schema.layout(data)
        self._data = bytearray(data[: layout.size])
        self._number, self._status = layout["scan"].offset, layout["status"].offset
        (self.status,) = _STATUS.unpack_from(data, self._status)

    def at(self, stamp_ns: int, number: int, status: int | None = None) -> bytes:
        """Return the scan with a stamp [ns], a number and status flags; None: the original flags."""
        _STAMP.pack_into(self._data, STAMP.start, *divmod(stamp_ns, NS))
        _NUMBER.pack_into(self._data, self._number, number)
        _STATUS.pack_into(self._data, self._status, self.status if status is None else status)
        return bytes(self._data)
