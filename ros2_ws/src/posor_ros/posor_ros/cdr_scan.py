"""Serialised raw scans: read as ``Scan``, and written from a template."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from posor.messages.cdr_schema import STAMP
from posor.numerics.stamps import NS
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message

from posor_ros.message_classes import schema_of_class
from posor_ros.message_conversion import scan_from_message

if TYPE_CHECKING:
    from posor.model.scan import Scan

RAW_SCAN = schema_of_class(RawScan)

_STAMP = struct.Struct("<iI")
_NUMBER = struct.Struct("<Q")
_STATUS = struct.Struct("<I")


def scan_of(data: bytes) -> Scan:
    """Return a serialised raw scan with any numbers of readings.

    Raises:
        TopicError: The bytes are not a raw scan.

    """
    data = RAW_SCAN.normal(data)
    RAW_SCAN.layout(data)
    return scan_from_message(deserialize_message(data, RawScan))


class ScanTemplate:
    """A raw scan that is sent repeatedly with another stamp, scan number and status.

    Attributes:
        status: Status flags of the original scan.

    """

    def __init__(self, data: bytes) -> None:
        """Prepare from a serialised raw scan.

        Raises:
            TopicError: The bytes are not a raw scan.

        """
        data = RAW_SCAN.normal(data)
        layout = RAW_SCAN.layout(data)
        self._data = bytearray(data[: layout.size])
        self._number, self._status = layout["scan"].offset, layout["status"].offset
        (self.status,) = _STATUS.unpack_from(data, self._status)

    def at(self, stamp_ns: int, number: int, status: int | None = None) -> bytes:
        """Return the scan with a stamp [ns], a number and status flags; None: the original flags."""
        _STAMP.pack_into(self._data, STAMP.start, *divmod(stamp_ns, NS))
        _NUMBER.pack_into(self._data, self._number, number)
        _STATUS.pack_into(self._data, self._status, self.status if status is None else status)
        return bytes(self._data)
