"""Raw scans as bytes: as the core sees them, and written from a template."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from posor_estimator.core.kernels.stamps import NS
from posor_estimator.ros.cdr import STAMP, Schema
from posor_estimator.ros.messages import scan_from_message

if TYPE_CHECKING:
    from posor_estimator.core.scan import Scan

RAW_SCAN = Schema.of(RawScan)

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
