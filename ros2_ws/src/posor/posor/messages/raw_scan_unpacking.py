"""Raw scans: from rows of messages to arrays of readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import BagError
from posor.messages.message_table import MessageTable  # noqa: TC001  read by dataclasses
from posor.model.scan import HOME_BUMP, Scans
from posor.numerics.array_types import IntArray  # noqa: TC001  read by dataclasses
from posor.numerics.stamps import times_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import BoolArray

FIELDS = {
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
}
"""Fields of ``posor_msgs/RawScan`` that are read, and their ``struct`` codes."""


@dataclass(frozen=True)
class RecordedScans:
    """Successive scans of one joint with the same readings, n of them, as a bag holds them.

    Attributes:
        log_times_ns: Shape (n,).
        order: Positions among the messages of all joints that were read together, shape (n,).
        scans: The readings.
        header_stamps: Seconds and nanoseconds as recorded, which may be invalid, shape (n, 2).
        statuses: ``posor_msgs/RawScan.status``, shape (n,).
        frame: Frame of the receiving plate.

    """

    log_times_ns: IntArray
    order: IntArray
    scans: Scans
    header_stamps: IntArray
    statuses: IntArray
    frame: str

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.log_times_ns)

    def select(self, which: BoolArray) -> RecordedScans:
        """Return some of the scans."""
        return RecordedScans(
            self.log_times_ns[which],
            self.order[which],
            self.scans.select(which),
            self.header_stamps[which],
            self.statuses[which],
            self.frame,
        )

    @staticmethod
    def concatenate(parts: Sequence[RecordedScans]) -> RecordedScans:
        """Return the scans of several parts, all with the same readings; the frame is that of the first part."""
        scans = Scans(np.concatenate([part.scans.records for part in parts]))
        names = ("log_times_ns", "order", "header_stamps", "statuses")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return RecordedScans(scans=scans, frame=parts[0].frame, **arrays)


def check_raw_scan_schema(schema: Schema, where: str) -> None:
    """Check that a stored definition of RawScan has all fields that are read.

    Raises:
        BagError: A field is missing, or has another type.

    """
    for path, code in (*FIELDS.items(), ("header.frame_id", "s")):
        field = schema.by_path.get(path)
        if field is None or field.code != code:
            what = "is missing" if field is None else f"is of type '{field.code}'"
            raise BagError(
                f"field {path} of the recorded RawScan {what}", where=where, expected=f"type '{code}' (struct code)"
            )


def unpack_scans(log_times_ns: IntArray, order: IntArray, table: MessageTable) -> RecordedScans:
    """Return the scans of a table of RawScan messages."""
    statuses = table["status"].astype(np.int64)
    header_stamps = np.column_stack([table[f"header.stamp.{part}"].astype(np.int64) for part in ("sec", "nanosec")])
    scans = Scans.from_fields(
        numbers=table["scan"],
        stamps_ns=times_ns(header_stamps[:, 0], header_stamps[:, 1]),
        gap_voltages=table["gap_voltages"],
        ring_voltages=table["ring_voltages"],
        diode_currents=table["diode_currents"],
        lit_sources=table["lit_sources"],
        supply_voltages=table["supply_voltage"],
        temperatures=table["temperature"],
        at_home=((statuses & HOME_BUMP) != 0).astype(np.int64),
        statuses=statuses,
    )
    frame = table.layout.strings["header.frame_id"]
    return RecordedScans(log_times_ns, order, scans, header_stamps, statuses, frame)
