"""Source ``instruments``: scans of one joint made of the channels of devices, see ``instruments.instruments_file``.

At each tick of the ROS clock the channels are interpolated between the two frames nearest to the tick, so the scans of
joints with devices of their own have common stamps. A scan whose frames are missing is not published. A reading that a
device flags as invalid, such as one out of range, is NaN, and the scan has the flag SATURATED.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from posor_estimator.errors import ParameterError
from posor_estimator.numerics.stamps import NS
from posor_estimator.parameter_model import ParameterGroup
from posor_estimator.ros_names import RAW_SCAN, RAW_TOPIC
from pydantic import Field

from posor_drivers.instruments.device_reader import DeviceReader
from posor_drivers.instruments.instruments_file import InstrumentsFile, JointEntry, ReadingEntry, load_instruments
from posor_drivers.message_builder import raw_scan
from posor_drivers.scan_clock import tick_stamp_ns
from posor_drivers.sources.source import LiveSource, SourceMessage, SourceStatus, Topic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.numerics.array_types import FloatArray

STATUS_SATURATED = 16


class InstrumentParameters(ParameterGroup):
    """Parameters of the source ``instruments``."""

    file: Annotated[str, Field(min_length=1)] = Field(description="instruments file (YAML)")
    joint: Annotated[str, Field(min_length=1)] = Field(description="name of this driver's joint in the file")


class _Readings:
    """Readings of one kind, such as all gap voltages: channels of one or several devices."""

    def __init__(self, entries: Sequence[ReadingEntry], columns: dict[str, int]) -> None:
        self._columns = [columns[entry.channel] for entry in entries]
        self._factors = np.array([entry.factor for entry in entries])
        self._shifts = np.array([entry.shift for entry in entries])

    def of(self, channels: FloatArray) -> FloatArray:
        """Return the readings from the values of all channels."""
        readings: FloatArray = self._factors * channels[self._columns] + self._shifts
        return readings


class InstrumentSource(LiveSource[InstrumentParameters]):
    """Reads the devices of one joint, each in a thread of its own."""

    Parameters = InstrumentParameters

    _file: InstrumentsFile
    _joint: JointEntry

    def __init__(self, parameters: InstrumentParameters, types: Any) -> None:
        """Store the parameters; ``open`` connects."""
        super().__init__(parameters, types)
        self._readers: list[DeviceReader] = []
        self._threads = ExitStack()
        self._scans_missing, self._missing = 0, ""

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
        self._arrays = {
            kind: _Readings(getattr(joint, kind), columns)
            for kind in ("gap_voltages", "ring_voltages", "diode_currents")
        }
        scalars = {kind: getattr(joint, kind) for kind in ("supply_voltage", "temperature")}
        self._scalars = {kind: _Readings([entry], columns) for kind, entry in scalars.items() if entry is not None}
        self._lit_sources = np.array(joint.lit_sources, dtype=np.uint8)
        self._latency_ns = round(self._file.latency.number * NS)
        self._readers = [DeviceReader(device) for device in devices]
        for reader in self._readers:
            reader.start()
            self._threads.callback(reader.stop)
        return [Topic(RAW_TOPIC, RAW_SCAN)]

    def close(self) -> None:
        """End the threads and the connections."""
        self._threads.close()

    @property
    def rate(self) -> int:
        """Scans per second, as the file has it."""
        return round(self._file.rate.number)

    def publication_time_ns(self, tick: int) -> int:
        """Return the time of a tick plus the latency [ns]."""
        return super().publication_time_ns(tick) + self._latency_ns

    def newest_tick(self, now_ns: int) -> int:
        """Return the newest tick whose frames must have come."""
        return super().newest_tick(now_ns - self._latency_ns)

    def read_tick(self, tick: int) -> Sequence[SourceMessage]:
        """Return the scan of a tick; none where a device lacks one of the frames around it."""
        stamp_ns = tick_stamp_ns(tick, self.rate)
        parts = {reader.device.name: reader.values_at(stamp_ns) for reader in self._readers}
        present = [part for part in parts.values() if part is not None]
        if len(present) < len(parts):
            self._scans_missing += 1
            self._missing = ", ".join(name for name, part in parts.items() if part is None)
            return ()
        self._missing = ""
        values = np.concatenate(present)
        fields: dict[str, Any] = {kind: readings.of(values) for kind, readings in self._arrays.items()}
        scalars = {kind: readings.of(values).item() for kind, readings in self._scalars.items()}
        is_valid = np.isfinite([*np.concatenate(list(fields.values())), *scalars.values()]).all()
        status = 0 if is_valid else STATUS_SATURATED
        scan = raw_scan(
            self.types,
            stamp_ns,
            self._joint.frame_id,
            scan=tick,
            status=status,
            lit_sources=self._lit_sources,
            **fields,
            **scalars,
        )
        return (SourceMessage(RAW_TOPIC, stamp_ns, self.types.serialize(scan, RAW_SCAN)),)

    def statuses(self) -> Sequence[SourceStatus]:
        """Return the state of each device, and the number of scans that were not published."""
        missing = f"no scan: frames of {self._missing} are missing" if self._missing else ""
        return [
            SourceStatus("scans", missing, "in time", {"scans_missing": self._scans_missing}),
            *(
                SourceStatus(f"device {reader.device.name}", state.fault, state.text, state.values)
                for reader in self._readers
                for state in (reader.state,)
            ),
        ]
