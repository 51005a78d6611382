"""Source ``instruments``: scans of one joint made of the channels of devices, see ``instruments.instruments_file``.

At each tick of the ROS clock the channels are interpolated between the two frames nearest to the tick, so the scans of
joints with devices of their own have common stamps. A scan whose frames are missing is not published, nor one between
two frames with different light sources. A reading that a device flags as invalid, such as one out of range, is NaN, and
the scan has the flag SATURATED.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from posor_estimator.errors import ParameterError
from posor_estimator.model.scan import HOME_BUMP, NO_SOURCE, SATURATED
from posor_estimator.numerics.stamps import NS
from posor_estimator.parameter_model import ParameterGroup
from posor_estimator.ros_names import RAW_SCAN, RAW_TOPIC
from pydantic import Field

from posor_drivers.instruments.instruments_file import (
    READINGS,
    WHOLE_NUMBERS,
    InstrumentsFile,
    JointEntry,
    ReadingEntry,
    load_instruments,
)
from posor_drivers.instruments.shared_readers import shared_reader
from posor_drivers.message_builder import raw_scan
from posor_drivers.scan_clock import tick_stamp_ns
from posor_drivers.sources.source import LiveSource, SourceMessage, SourceStatus, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.numerics.array_types import FloatArray

    from posor_drivers.instruments.device_reader import DeviceReader

SCALARS = ("supply_voltage", "temperature")


class InstrumentParameters(ParameterGroup):
    """Parameters of the source ``instruments``."""

    file: Annotated[str, Field(min_length=1)] = Field(description="instruments file (YAML)")
    joint: Annotated[str, Field(min_length=1)] = Field(description="name of this driver's joint in the file")


class _Readings:
    """All readings of a joint, made of the values of all channels at once."""

    def __init__(self, joint: JointEntry, columns: dict[str, int]) -> None:
        entries: list[ReadingEntry | int] = []
        self.parts: dict[str, slice] = {}
        for kind in READINGS:
            part = getattr(joint, kind)
            begin = len(entries)
            entries += part if isinstance(part, tuple) else [] if part is None else [part]
            self.parts[kind] = slice(begin, len(entries))
        fixed = [float(entry) if isinstance(entry, int) else np.nan for entry in entries]
        measured = [(n, entry) for n, entry in enumerate(entries) if isinstance(entry, ReadingEntry)]
        self._fixed, self._measured = np.array(fixed), [n for n, _ in measured]
        self._columns = [columns[entry.channel] for _, entry in measured]
        self._factors = np.array([entry.factor for _, entry in measured])
        self._shifts = np.array([entry.shift for _, entry in measured])

    def of(self, channels: FloatArray) -> FloatArray:
        """Return the readings; those of each kind are where ``parts`` says."""
        readings = self._fixed.copy()
        readings[self._measured] = self._factors * channels[self._columns] + self._shifts
        return readings


class InstrumentSource(LiveSource[InstrumentParameters]):
    """Reads the devices of one joint, each in a thread that the joints of a process share."""

    Parameters = InstrumentParameters

    _file: InstrumentsFile
    _joint: JointEntry

    def __init__(self, parameters: InstrumentParameters, types: Any) -> None:
        """Store the parameters; ``open`` connects."""
        super().__init__(parameters, types)
        self._readers: list[DeviceReader] = []
        self._threads = ExitStack()
        self._scans_missing, self._no_scan = 0, ""

    @property
    def record(self) -> str:
        """The instruments file."""
        return self.parameters.file

    def open(self) -> Sequence[Topic]:
        """Read the file and start to read the devices; a device that is away is connected to when it comes."""
        where, name = self.parameters.file, self.parameters.joint
        self._file = load_instruments(Path(where))
        if name not in self._file.joints:
            expected = f"one of {', '.join(self._file.joints)}"
            raise ParameterError(
                f"'{name}' is not a joint of {where}", where="parameter 'instruments.joint'", expected=expected
            )
        self._joint = joint = self._file.joints[name]
        used = {entry.channel.partition("/")[0] for _, _, entry in joint.entries()}
        devices = [device for each, device in self._file.new_devices().items() if each in used]
        channels = [f"{device.name}/{channel.name}" for device in devices for channel in device.channels]
        columns = {channel: n for n, channel in enumerate(channels)}
        whole = {entry.channel for kind, _, entry in joint.entries() if kind in WHOLE_NUMBERS}
        self._whole = {
            device.name: [n for n, each in enumerate(device.channels) if f"{device.name}/{each.name}" in whole]
            for device in devices
        }
        self._readings = _Readings(joint, columns)
        self._rate = round(self._file.rate.number)
        self._latency_ns = round(self._file.latency.number * NS)
        self._readers = [self._threads.enter_context(shared_reader(Path(where), device)) for device in devices]
        return [Topic(RAW_TOPIC, RAW_SCAN)]

    def close(self) -> None:
        """End the threads and the connections."""
        self._threads.close()

    @property
    def rate(self) -> int:
        """Scans per second, as the file has it."""
        return self._rate

    def publication_time_ns(self, tick: int) -> int:
        """Return the time of a tick plus the latency [ns]."""
        return super().publication_time_ns(tick) + self._latency_ns

    def newest_tick(self, now_ns: int) -> int:
        """Return the newest tick whose frames must have come."""
        return super().newest_tick(now_ns - self._latency_ns)

    def read_tick(self, tick: int) -> Sequence[SourceMessage]:
        """Return the scan of a tick; none where a device lacks one of the frames around it."""
        stamp_ns = tick_stamp_ns(tick, self.rate)
        channels = {
            reader.device.name: reader.values_at(stamp_ns, self._whole[reader.device.name]) for reader in self._readers
        }
        present = [values for values in channels.values() if values is not None]
        if len(present) < len(channels):
            missing = ", ".join(name for name, values in channels.items() if values is None)
            return self._leave_out(f"no frames of {missing} around the tick, or frames with different light sources")
        readings = self._readings.of(np.concatenate(present))
        fields: dict[str, Any] = {kind: readings[part] for kind, part in self._readings.parts.items()}
        lit_sources, home_mark = fields.pop("lit_sources"), fields.pop("home_mark")
        scalars = {kind: fields.pop(kind) for kind in SCALARS}
        if np.any(lit_sources != np.clip(np.rint(lit_sources), 0, NO_SOURCE)):
            return self._leave_out(f"lit sources {lit_sources.tolist()}; expected whole numbers from 0 to {NO_SOURCE}")
        self._no_scan = ""
        status = 0 if np.isfinite(readings).all() else SATURATED
        scan = raw_scan(
            self.types,
            stamp_ns,
            self._joint.frame_id,
            scan=tick,
            status=status | (HOME_BUMP if home_mark.any() else 0),
            lit_sources=lit_sources.astype(np.uint8),
            **{kind: reading.item() for kind, reading in scalars.items() if len(reading)},
            **fields,
        )
        return (SourceMessage(RAW_TOPIC, stamp_ns, self.types.serialize(scan, RAW_SCAN)),)

    def _leave_out(self, reason: str) -> Sequence[SourceMessage]:
        """Count a scan that is not published, and return no message."""
        self._scans_missing += 1
        self._no_scan = f"no scan: {reason}"
        return ()

    def statuses(self) -> Sequence[SourceStatus]:
        """Return the state of each device, and the number of scans that were not published."""
        return [
            SourceStatus("scans", self._no_scan, "in time", {"scans_missing": self._scans_missing}),
            *(
                SourceStatus(f"device {reader.device.name}", state.fault, state.text, state.values)
                for reader in self._readers
                for state in (reader.state,)
            ),
        ]
