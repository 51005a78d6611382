"""Serialised scans of one joint, written into one prepared message, because building each from its fields is slow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import TableLayout
from posor.model.scan import HOME_BUMP, NO_SOURCE, SATURATED
from posor.numerics.stamps import NS
from posor.ros_names import RAW_SCAN

from posor_drivers.instruments.instruments_file import READINGS, JointEntry, ReadingEntry
from posor_drivers.message_builder import raw_scan

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.messages.message_definitions import MessageTypes
    from posor.numerics.array_types import FloatArray

FIELDS = tuple(name for name in READINGS if name != "home_mark")
"""Readings that are fields of the message; the home mark is a flag."""
SCALARS = ("supply_voltage", "temperature")


class LitSourceError(ValueError):
    """The number of a lit source is not a whole number, or is out of range."""


class ScanWriter:
    """Makes the scan of a joint from the values of all channels."""

    def __init__(self, joint: JointEntry, columns: Mapping[str, int], types: MessageTypes) -> None:
        """Prepare the message; ``columns`` are the channels by name, in the order of the values."""
        entries: list[ReadingEntry | int] = []
        parts: dict[str, slice] = {}
        for kind in READINGS:
            part = getattr(joint, kind)
            begin = len(entries)
            entries += part if isinstance(part, tuple) else [] if part is None else [part]
            parts[kind] = slice(begin, len(entries))
        self._readings = np.array([float(entry) if isinstance(entry, int) else np.nan for entry in entries])
        measured = [(n, entry) for n, entry in enumerate(entries) if isinstance(entry, ReadingEntry)]
        self._measured = np.array([n for n, _ in measured])
        self._columns = np.array([columns[entry.channel] for _, entry in measured])
        self._factors = np.array([entry.factor for _, entry in measured])
        self._shifts = np.array([entry.shift for _, entry in measured])
        self._lit_sources, self._home_mark = self._readings[parts["lit_sources"]], self._readings[parts["home_mark"]]
        arrays = {name: np.zeros(parts[name].stop - parts[name].start) for name in FIELDS if name not in SCALARS}
        arrays["lit_sources"] = arrays["lit_sources"].astype(np.uint8)
        example = types.serialize(raw_scan(types, 0, joint.frame_id, scan=0, **arrays), RAW_SCAN)
        self._message = message = TableLayout.of(example, installed_schema(RAW_SCAN)).copies(1)
        self._seconds, self._nanoseconds = message["header.stamp.sec"], message["header.stamp.nanosec"]
        self._number, self._status = message["scan"], message["status"]
        self._pairs = [
            (message[name].reshape(-1), self._readings[parts[name]])
            for name in FIELDS
            if parts[name].stop > parts[name].start
        ]

    def scan(self, channels: FloatArray, stamp_ns: int, number: int) -> bytes:
        """Return the serialised scan.

        Args:
            channels: Value of each channel, (c,); NaN: invalid, and the scan has the flag SATURATED.
            stamp_ns: Stamp [ns].
            number: Number of the scan.

        Raises:
            LitSourceError: A lit source is no whole number from 0 to 255.

        """
        readings = self._readings
        readings[self._measured] = self._factors * channels[self._columns] + self._shifts
        for lit in self._lit_sources.tolist():
            if not (0.0 <= lit <= NO_SOURCE and lit.is_integer()):
                what = f"lit sources {self._lit_sources.tolist()}; expected whole numbers from 0 to {NO_SOURCE}"
                raise LitSourceError(what)
        for field, part in self._pairs:
            field[:] = part
        status = 0 if np.isfinite(readings).all() else SATURATED
        self._seconds[0], self._nanoseconds[0] = divmod(stamp_ns, NS)
        self._number[0], self._status[0] = number, status | (HOME_BUMP if self._home_mark.any() else 0)
        serialised: bytes = self._message.messages[0].tobytes()
        return serialised
