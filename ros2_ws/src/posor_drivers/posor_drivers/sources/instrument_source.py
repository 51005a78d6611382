# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``instruments``: scans of one joint made of the channels of devices, see ``instruments.instruments_file``.

At each tick of the ROS clock the channels are interpolated between the three frames nearest to the tick, so the scans
of joints with devices of their own have common stamps. Each channel is interpolated by its own times of exposure. What
remains is stated in the scan: offsets of triggered devices, and exposures that are unknown. The error of the stamp is
that of the device whose clock is known least well, with the ages of its values, and that of the clock of this host. A
scan whose frames are missing is not published, nor one between frames with different light sources. A reading that a
device flags as invalid, such as one out of range, is NaN, and the scan has the flag SATURATED.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from posor.errors import ParameterError
from posor.node_parameters import TopicName  # noqa: TC002  pydantic needs it
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.parameter_model import ParameterGroup
from posor.ros_names import RAW_SCAN, RAW_TOPIC, TEMPERATURE_TOPIC
from posor.sensors.base import READING_KINDS
from pydantic import Field

from posor_drivers.host_clock import HostClock
from posor_drivers.instruments.calibrated_readings import check_readings
from posor_drivers.instruments.channel_exposures import Exposures
from posor_drivers.instruments.device_reader import StampError
from posor_drivers.instruments.instruments_file import (
    WHOLE_NUMBERS,
    InstrumentsFile,
    JointEntry,
    ThermometerEntry,
    load_instruments,
)
from posor_drivers.instruments.reference_entry import ReferenceEntry
from posor_drivers.instruments.shared_readers import shared_reader
from posor_drivers.instruments.tick_messages import LitSourceError, ReferenceReading, ScanWriter, ThermometerReading
from posor_drivers.sources.source import LiveSource, SourceMessage, SourceStatus, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

    from posor_drivers.instruments.device_reader import DeviceReader

EntryT = TypeVar("EntryT", ReferenceEntry, ThermometerEntry)
LATEST_S = 0.1
"""Time by which a scan may be published too late by a busy host, because frames are kept; an older tick is missed."""


class InstrumentParameters(ParameterGroup):
    """Parameters of the source ``instruments``."""

    file: Annotated[str, Field(min_length=1)] = Field(description="instruments file (YAML)")
    joint: Annotated[str, Field(min_length=1)] = Field(description="name of this driver's joint in the file")
    temperature_topic: TopicName = Field(
        default=TEMPERATURE_TOPIC,
        description="name before those of the thermometers in their topics; bringup states that of the arm",
    )
    host_clock: bool = Field(
        default=True,
        description="add the largest error of this host's clock, which chronyc or pmc states where present, to that of "
        "the stamps; false: all users of the scans share this clock",
    )


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

    def check(self, calibration: Calibration) -> None:
        """Read the file and compare the readings of the joint with its calibration."""
        where = f"{self.parameters.file}, key joints.{self.parameters.joint}"
        check_readings(self._read_file().joints[self.parameters.joint], calibration, where)

    def _read_file(self) -> InstrumentsFile:
        where, name = self.parameters.file, self.parameters.joint
        file = load_instruments(Path(where))
        if name not in file.joints:
            what, expected = f"'{name}' is not a joint of {where}", f"one of {', '.join(file.joints)}"
            raise ParameterError(what, where="parameter 'instruments.joint'", expected=expected)
        return file

    def open(self) -> Sequence[Topic]:
        """Read the file and start to read the devices; a device that is away is connected to when it comes."""
        where, name = self.parameters.file, self.parameters.joint
        self._file = self._read_file()
        self._joint = joint = self._file.joints[name]
        prefix = self.parameters.temperature_topic
        self._references = [
            ReferenceReading(each, entry, self.types) for each, entry in self._of_joint(self._file.references)
        ]
        self._thermometers = [
            ThermometerReading(each, entry, self.types, prefix)
            for each, entry in self._of_joint(self._file.thermometers)
        ]
        self._of_scan = {entry.device for _, _, entry in joint.entries()}
        at_ticks = self._of_scan.union(*(each.devices for each in self._references))
        used = at_ticks.union(each.device for each in self._thermometers)
        devices = [device for each, device in self._file.new_devices().items() if each in used]
        of_scan = [device for device in devices if device.name in self._of_scan]
        channels = [f"{device.name}/{channel.name}" for device in of_scan for channel in device.channels]
        self._columns = {channel: n for n, channel in enumerate(channels)}
        whole = {entry.channel for kind, _, entry in joint.entries() if kind in WHOLE_NUMBERS}
        self._whole = {
            device.name: [n for n, each in enumerate(device.channels) if f"{device.name}/{each.name}" in whole]
            for device in devices
        }
        moving = {entry.channel for kind, _, entry in joint.entries() if kind in READING_KINDS}
        self._moving = {
            device.name: [n for n, each in enumerate(device.channels) if f"{device.name}/{each.name}" in moving]
            for device in devices
        }
        self._rate = round(self._file.rate.number)
        self._latency_ns = round(self._file.latency.number * NS)
        self._readers = [self._threads.enter_context(shared_reader(Path(where), device)) for device in devices]
        self._tick_readers = [reader for reader in self._readers if reader.device.name in at_ticks]
        self._scan_readers = [reader for reader in self._readers if reader.device.name in self._of_scan]
        self._prepare_writer()
        self._host_clock = HostClock() if self.parameters.host_clock else None
        return [Topic(RAW_TOPIC, RAW_SCAN), *(each.topic for each in self._published())]

    def _published(self) -> list[ReferenceReading | ThermometerReading]:
        return [*self._references, *self._thermometers]

    def _of_joint(self, entries: Mapping[str, EntryT]) -> list[tuple[str, EntryT]]:
        """Return the entries that this driver publishes, with their names."""
        return [(name, entry) for name, entry in entries.items() if entry.joint == self.parameters.joint]

    def _prepare_writer(self) -> None:
        """Prepare the scans with the exposures of all devices, which a device may know only when it is connected."""
        self._exposures = [reader.exposures for reader in self._scan_readers]
        offsets_s = tuple(offset for each in self._exposures for offset in each.offsets_s)
        exposures = Exposures(offsets_s, max(each.span_s for each in self._exposures))
        self._writer = ScanWriter(self._joint, self._columns, self.types, exposures)

    def _stamp_error(self, stamp_ns: int) -> StampError | None:
        """Return the error of a stamp of scans; None: a device has lost its connection meanwhile."""
        found = [reader.stamp_error_at(stamp_ns, self._moving[reader.device.name]) for reader in self._scan_readers]
        errors = [each for each in found if each is not None]
        if len(errors) < len(found):
            return None
        host_limit_s = 0.0 if self._host_clock is None else self._host_clock.limit_s
        return StampError(
            max(each.uncertainty_s for each in errors), max(each.limit_s for each in errors) + host_limit_s
        )

    def close(self) -> None:
        """End the threads and the connections."""
        self._threads.close()

    @property
    def rate(self) -> int:
        """Scans per second, as the file has it."""
        return self._rate

    @property
    def ticks_kept(self) -> int:
        """The ticks whose scans may still be published."""
        return int(LATEST_S * self._rate)

    def publication_time_ns(self, tick: int) -> int:
        """Return the time of a tick plus the latency [ns]."""
        return super().publication_time_ns(tick) + self._latency_ns

    def newest_tick(self, now_ns: int) -> int:
        """Return the newest tick whose frames must have come."""
        return super().newest_tick(now_ns - self._latency_ns)

    def read_tick(self, tick: int) -> Sequence[SourceMessage]:
        """Return scan, references and temperatures of a tick; none where a device lacks one of the frames around it."""
        stamp_ns = tick_stamp_ns(tick, self.rate)
        values = {
            reader.device.name: reader.values_at(stamp_ns, self._whole[reader.device.name])
            for reader in self._tick_readers
        }
        messages = [*self._scan(tick, stamp_ns, values), *self._read_references(stamp_ns, values)]
        if self._thermometers and stamp_ns % NS == 0:
            readers = {reader.device.name: reader for reader in self._readers}
            found = [each.message(readers[each.device], stamp_ns) for each in self._thermometers]
            messages += [each for each in found if each is not None]
        return messages

    def _scan(self, tick: int, stamp_ns: int, values: Mapping[str, FloatArray | None]) -> Sequence[SourceMessage]:
        present = [part for device, part in values.items() if part is not None and device in self._of_scan]
        stamp_error = self._stamp_error(stamp_ns)
        if stamp_error is None or len(present) < len(self._of_scan):
            absent = [device for device, part in values.items() if part is None and device in self._of_scan]
            names = ", ".join(absent or sorted(self._of_scan))
            return self._leave_out(f"no frames of {names} around the tick, or frames with different light sources")
        if any(reader.exposures is not used for reader, used in zip(self._scan_readers, self._exposures, strict=True)):
            self._prepare_writer()
        try:
            scan = self._writer.scan(np.concatenate(present), stamp_ns, tick, stamp_error)
        except LitSourceError as error:
            return self._leave_out(str(error))
        self._no_scan = ""
        return (SourceMessage(RAW_TOPIC, stamp_ns, scan),)

    def _read_references(self, stamp_ns: int, values: Mapping[str, FloatArray | None]) -> Iterator[SourceMessage]:
        if not self._references:
            return
        channels = {
            f"{reader.device.name}/{channel.name}": float(value)
            for reader in self._tick_readers
            if (part := values[reader.device.name]) is not None
            for channel, value in zip(reader.device.channels, part, strict=True)
        }
        for each in self._references:
            if (message := each.message(channels, stamp_ns)) is not None:
                yield message

    def _leave_out(self, reason: str) -> Sequence[SourceMessage]:
        """Count a scan that is not published, and return no message."""
        self._scans_missing += 1
        self._no_scan = f"no scan: {reason}"
        return ()

    def statuses(self) -> Sequence[SourceStatus]:
        """Return the state of each device, and the number of scans that were not published."""
        host = [] if self._host_clock is None else [SourceStatus("host clock", *self._host_clock.read())]
        return [
            SourceStatus("scans", self._no_scan, "in time", {"scans_missing": self._scans_missing}),
            *(each.status for each in self._published()),
            *(
                SourceStatus(f"device {reader.device.name}", state.fault, state.text, state.values)
                for reader in self._readers
                for state in (reader.take_state(),)
            ),
            *host,
        ]
