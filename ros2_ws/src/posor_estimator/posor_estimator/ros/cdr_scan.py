"""Raw scans as bytes: read straight into the estimator's arrays, and written from a template."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from posor_estimator.ros.cdr import NS, STAMP, Schema
from posor_estimator.ros.cdr_walk import LITTLE_ENDIAN
from posor_estimator.ros.messages import scan_from_message

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor_estimator.core.scan import Scan, Scans

RAW_SCAN = Schema.of(RawScan)

_SEQUENCES = (
    "gap_voltages#",
    "gap_voltage_spreads#",
    "ring_voltages#",
    "ring_voltage_spreads#",
    "diode_currents#",
    "diode_current_spreads#",
)
_STAMP = struct.Struct("<iI")
_NUMBER = struct.Struct("<Q")
_STATUS = struct.Struct("<I")


def scan_of(data: bytes) -> Scan:
    """Return a raw scan as the core sees it, however many readings it has.

    Raises:
        TopicError: The bytes are no raw scan.

    """
    data = RAW_SCAN.normal(data)
    RAW_SCAN.layout(data)
    return scan_from_message(deserialize_message(data, RawScan))


class ScanReader:
    """Reads raw scans of one kind (the same frame, the same numbers of readings) into arrays made for one.

    Attributes:
        frame: Of the scans.
        stamp_ns: Of the scan read last [ns].
        number: Its scan number.
        status: Its status flags.
        lit: Index of the source lit for each diode.

    """

    def __init__(self, example: bytes, scans: Scans) -> None:
        """Read scans like an example.

        Args:
            example: A raw scan, in plain CDR.
            scans: Where readings go: of length 1, with as many readings as the example.

        Raises:
            TopicError: The example is no raw scan.

        """
        layout = RAW_SCAN.layout(example)
        self.frame = str(RAW_SCAN.values(example, layout)["header.frame_id"])
        head = ("header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "scan", "status")
        self._unpack = layout.unpacker((*head, *_SEQUENCES, "lit_sources#", "lit_sources")).unpack_from
        said = self._unpack(example)
        self._frame, self._lengths = said[3], said[6:13]
        self._size = layout.size
        self._numbers, self._stamps_ns = scans.numbers.data, scans.stamps_ns.data
        self._at_home = scans.at_home.data
        self._lit_sources = scans.lit_sources
        into: dict[str, NDArray[np.float64]] = {
            "gap_voltages": scans.gap_voltages,
            "ring_voltages": scans.ring_voltages,
            "diode_currents": scans.diode_currents,
            "supply_voltage": scans.supply_voltages,
            "temperature": scans.temperatures,
        }
        self._copies = tuple((array.data.cast("B"), layout[path].part) for path, array in into.items() if array.size)
        self.stamp_ns = self.number = self.status = 0
        self.lit: tuple[int, ...] = ()

    def read(self, data: bytes) -> bool:
        """Read a scan; return whether it is of this kind. Where it is not, nothing has been read."""
        if len(data) < self._size:
            return False
        said = self._unpack(data)
        if said[0] != LITTLE_ENDIAN or said[3] != self._frame or said[6:13] != self._lengths:
            return False
        self.stamp_ns = self._stamps_ns[0] = said[1] * NS + said[2]
        self.number = self._numbers[0] = said[4]
        self.status = status = said[5]
        self._at_home[0] = status & RawScan.STATUS_HOME_BUMP != 0
        for array, part in self._copies:
            array[:] = data[part]
        lit = said[13:]
        if lit != self.lit:
            self.lit = lit
            self._lit_sources[0, :] = lit
        return True


class ScanTemplate:
    """A raw scan to be sent again and again: as it is, but for stamp, scan number and status.

    Attributes:
        status: Status flags of the scan that it was made of.

    """

    def __init__(self, data: bytes) -> None:
        """Take a serialised raw scan.

        Raises:
            TopicError: The bytes are no raw scan.

        """
        data = RAW_SCAN.normal(data)
        layout = RAW_SCAN.layout(data)
        self._data = bytearray(data[: layout.size])
        self._number, self._status = layout["scan"].offset, layout["status"].offset
        (self.status,) = _STATUS.unpack_from(data, self._status)

    def at(self, stamp_ns: int, number: int, status: int | None = None) -> bytes:
        """Return the scan with a stamp [ns], a number and status flags; without: those it had."""
        _STAMP.pack_into(self._data, STAMP.start, *divmod(stamp_ns, NS))
        _NUMBER.pack_into(self._data, self._number, number)
        _STATUS.pack_into(self._data, self._status, self.status if status is None else status)
        return bytes(self._data)
