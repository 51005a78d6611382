"""Messages of a reference at the ticks of the scans: the channel of a device, corrected, with its uncertainty."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.ros_names import REFERENCE_READING, REFERENCE_TOPIC
from posor.uncertainty.interferometer import correct_reading

from posor_drivers.message_builder import header
from posor_drivers.sources.source import SourceMessage, SourceStatus, Topic

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.messages.message_definitions import MessageTypes

    from posor_drivers.instruments.reference_entry import ReferenceEntry


class ReferenceReading:
    """Makes the messages of one reference."""

    def __init__(self, name: str, entry: ReferenceEntry, types: MessageTypes) -> None:
        """Store the entry."""
        self._entry, self._types, self._name = entry, types, name
        self.topic = Topic(REFERENCE_TOPIC.format(name=name), REFERENCE_READING)
        self.devices = {each.channel.partition("/")[0] for _, _, each in entry.measured}
        self._missing, self._fault = 0, ""

    def message(self, channels: Mapping[str, float], stamp_ns: int) -> SourceMessage | None:
        """Return the message of a tick; None where a channel is missing or invalid.

        Args:
            channels: Values of the channels by name; those of a device without frames are absent.
            stamp_ns: Stamp [ns].

        """
        entry = self._entry
        absent = sorted({each.channel for _, _, each in entry.measured} - set(channels))
        if absent:
            self._leave_out(f"no frames of {', '.join(absent)} around the tick")
            return None
        factor = 1.0 if entry.scale is None else entry.scale.number
        reading = factor * channels[entry.channel] + (0.0 if entry.offset is None else entry.offset.number)
        value, uncertainty = reading, entry.standard_uncertainty.number
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
