# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a tick from the channels of devices: the scan of a joint, references, temperatures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.errors import ParameterError
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import TableLayout
from posor.model.scan import DARK_SUBTRACTED, HOME_BUMP, NO_SOURCE, SATURATED
from posor.numerics.stamps import NS
from posor.ros_names import RAW_SCAN, REFERENCE_READING, REFERENCE_TOPIC, TEMPERATURE
from posor.sensors.base import READING_KINDS
from posor.tables.table_map import READINGS
from posor.uncertainty.interferometer import correct_reading

from posor_drivers.instruments.instruments_file import JointEntry, ReadingEntry, ThermometerEntry
from posor_drivers.message_builder import header, raw_scan, temperature
from posor_drivers.sources.source import SourceMessage, SourceStatus, Topic

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.messages.message_definitions import MessageTypes
    from posor.numerics.array_types import FloatArray

    from posor_drivers.instruments.channel_exposures import Exposures
    from posor_drivers.instruments.device_reader import DeviceReader, StampError
    from posor_drivers.instruments.reference_entry import ReferenceEntry

FIELDS = tuple(name for name in READINGS if name not in {"home_mark", "light"})
"""Readings that are fields of the message; the home mark is a flag, and ``light`` switches the lit sources."""
SCALARS = ("supply_voltage", "temperature", "reference_voltage")
"""Readings whose exposure a scan states, in the order of ``RawScan.exposure_offsets``."""


EVERY_SECOND_HZ = 2.0
"""Frames per second from which there is a new frame in each second."""


class LitSourceError(ValueError):
    """The number of a lit source is not a whole number, or is out of range."""


class ScanWriter:
    """Writes the scans of a joint into one prepared message, because building each from its fields is slow."""

    def __init__(
        self, joint: JointEntry, columns: Mapping[str, int], types: MessageTypes, exposures: Exposures
    ) -> None:
        """Prepare the message; ``columns``: channels by name; ``exposures``: theirs, in the order of the values."""
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
        self._lit_sources, self._home_mark, self._light = (
            self._readings[parts[name]] for name in ("lit_sources", "home_mark", "light")
        )
        self._sources, self._flags = self._lit_sources.copy(), DARK_SUBTRACTED if joint.demodulated else 0
        arrays = {name: np.zeros(parts[name].stop - parts[name].start) for name in FIELDS if name not in SCALARS}
        arrays["lit_sources"] = arrays["lit_sources"].astype(np.uint8)
        read = [entry for kind in READING_KINDS for entry in entries[parts[kind]] if isinstance(entry, ReadingEntry)]
        offsets_s = np.array([exposures.offsets_s[columns[entry.channel]] for entry in read])
        stated: dict[str, Any] = {}
        if exposures.span_s > 0.0 or np.any(offsets_s != 0.0):
            stated = {"exposure_offsets": offsets_s, "exposure_span": exposures.span_s}
        example = types.serialize(raw_scan(types, 0, joint.frame_id, scan=0, **arrays, **stated), RAW_SCAN)
        self._message = message = TableLayout.of(example, installed_schema(RAW_SCAN)).copies(1)
        self._seconds, self._nanoseconds = message["header.stamp.sec"], message["header.stamp.nanosec"]
        self._number, self._status = message["scan"], message["status"]
        self._uncertainty, self._limit = message["stamp_uncertainty"], message["stamp_limit"]
        present = [name for name in FIELDS if parts[name].stop > parts[name].start]
        self._pairs = [(message[name].reshape(-1), self._readings[parts[name]]) for name in present]

    def scan(self, channels: FloatArray, stamp_ns: int, number: int, error: StampError) -> bytes:
        """Return the serialised scan of the channels' values, (c,); NaN: invalid, and the scan is flagged SATURATED.

        ``error`` is that of the stamp.

        Raises:
            LitSourceError: A lit source is no whole number from 0 to 255.

        """
        readings = self._readings
        readings[self._measured] = self._factors * channels[self._columns] + self._shifts
        if self._light.size:  # fixed numbers come back after a dark scan
            fixed = np.isfinite(self._sources)
            self._lit_sources[fixed] = self._sources[fixed]
            if not self._light.any():
                self._lit_sources[:] = NO_SOURCE
        for lit in self._lit_sources.tolist():
            if not (0.0 <= lit <= NO_SOURCE and lit.is_integer()):
                what = f"lit sources {self._lit_sources.tolist()}; expected whole numbers from 0 to {NO_SOURCE}"
                raise LitSourceError(what)
        for field, part in self._pairs:
            field[:] = part
        status = self._flags | (0 if np.isfinite(readings).all() else SATURATED)
        self._seconds[0], self._nanoseconds[0] = divmod(stamp_ns, NS)
        self._uncertainty[0], self._limit[0] = error
        self._number[0], self._status[0] = number, status | (HOME_BUMP if self._home_mark.any() else 0)
        serialised: bytes = self._message.messages[0].tobytes()
        return serialised


class ReferenceReading:
    """Makes the messages of one reference."""

    def __init__(self, name: str, entry: ReferenceEntry, types: MessageTypes) -> None:
        """Store the entry."""
        self._entry, self._types, self._name = entry, types, name
        self.topic = Topic(REFERENCE_TOPIC.format(name=name), REFERENCE_READING)
        self.devices = {each.device for _, _, each in entry.measured}
        self._missing, self._fault = 0, ""

    def message(self, channels: Mapping[str, float], stamp_ns: int) -> SourceMessage | None:
        """Return the message of a tick; None where a channel is missing or invalid.

        ``channels`` holds the values by name; those of a device without frames are absent.
        """
        entry = self._entry
        absent = sorted({each.channel for _, _, each in entry.measured} - set(channels))
        if absent:
            self._leave_out(f"no frames of {', '.join(absent)} around the tick")
            return None
        value = reading = entry.value(channels)
        uncertainty = entry.standard_uncertainty.number
        if not math.isfinite(reading):
            self._leave_out(f"{entry.channel} is invalid")
            return None
        if entry.interferometer is not None:
            try:
                corrected = correct_reading(entry.interferometer.setup(channels), reading)
            except ParameterError as error:
                self._leave_out(str(error))
                return None
            value = corrected.displacement
            uncertainty = math.hypot(uncertainty, corrected.standard_uncertainty)
        self._fault = ""
        message = self._types.new(
            REFERENCE_READING,
            header=header(self._types, stamp_ns, entry.frame_id),
            unit=entry.unit,
            value=value,
            standard_uncertainty=uncertainty,
            reading=reading,
        )
        return SourceMessage(self.topic.name, stamp_ns, self._types.serialize(message, REFERENCE_READING))

    def _leave_out(self, reason: str) -> None:
        self._missing += 1
        self._fault = f"no reading: {reason}"

    @property
    def status(self) -> SourceStatus:
        """Whether there are readings."""
        return SourceStatus(f"reference {self._name}", self._fault, "in time", {"readings_missing": self._missing})


class ThermometerReading:
    """Makes the messages of one thermometer, at whole seconds, from the newest frame of its device.

    It needs no frames around the tick, which a slow device does not have in time.
    """

    def __init__(self, name: str, entry: ThermometerEntry, types: MessageTypes, prefix: str) -> None:
        """Store the entry; ``prefix``: of the topic, before the name."""
        self._entry, self._types, self._name = entry, types, name
        self.topic = Topic(f"{prefix.rstrip('/')}/{name}", TEMPERATURE)
        self.device = entry.device
        self._last: int | None = None
        self._missing, self._fault = 0, ""

    def message(self, reader: DeviceReader, stamp_ns: int) -> SourceMessage | None:
        """Return the message at a whole second [ns], NaN: invalid channel; None: no new frame."""
        entry, frame = self._entry, reader.newest_frame()
        if frame is None or frame[0] == self._last:
            if frame is None or reader.device.frame_rate >= EVERY_SECOND_HZ:
                self._missing += 1
                self._fault = f"no reading: no new frame of {entry.device}"
            return None
        self._last, values = frame
        names = [f"{entry.device}/{channel.name}" for channel in reader.device.channels]
        kelvin = entry.value(dict(zip(names, values.tolist(), strict=True)))
        self._fault = "" if math.isfinite(kelvin) else f"{entry.channel} is invalid"
        message = temperature(self._types, stamp_ns, self._name, kelvin)
        return SourceMessage(self.topic.name, stamp_ns, self._types.serialize(message, TEMPERATURE))

    @property
    def status(self) -> SourceStatus:
        """Whether there are readings."""
        return SourceStatus(f"thermometer {self._name}", self._fault, "in time", {"readings_missing": self._missing})
