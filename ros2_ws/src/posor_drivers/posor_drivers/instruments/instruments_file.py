# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The instruments file: devices, and which of their channels are the readings of each joint.

::

    format: posor_instruments
    version: 1
    name: rig
    rate: {value: 500, unit: Hz}        # scans per second, at ticks of the ROS clock
    latency: {value: 0.02, unit: s}     # from the tick to the publication: the frames after the tick must have arrived
    devices:
      box: {kind: stream, ...}
    joints:
      elbow:
        frame_id: elbow_receiving
        gap_voltages:
          - {channel: box/gap1, scale: {value: 10000, unit: V/m}, offset: {value: -2.0, unit: V}}
          - {channel: box/gap2, scale: {value: 10000, unit: V/m}}
        temperature: {channel: box/plate, scale: {value: 1, unit: K/degC}, offset: {value: 273.15, unit: K}}

A reading is ``scale`` times the channel plus ``offset``. Without ``scale`` the channel has the unit of the reading.
``lit_sources``, ``home_mark`` and ``light`` are whole numbers: channels of unit ``1`` as they are; a lit source can be
a fixed number. ``light`` is 0 while all sources are switched off: those scans are dark. ``demodulated: true`` states
that the device demodulates the light of the sources, so that the diode currents hold no ambient light.
``acceleration``, in the unit of the channel per s^2, is the largest one that the reading is interpolated with, see
``reading_noise``. ``references`` are instruments of a calibration, see ``reference_entry``. ``thermometers`` are those
of the beams file, by name::

    thermometers:
      upper_arm: {joint: elbow, channel: box/skin, scale: {value: 1, unit: K/degC}, offset: {value: 273.15, unit: K}}

The driver of ``joint`` publishes the temperature once a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel, select_model_by_key
from posor.calibration.quantity import Quantity
from posor.calibration.yaml_document import load_document
from posor.ros_names import ROS_NAME_RULE, is_ros_name
from posor.sensors.base import READING_KINDS
from posor.tables.table_map import READINGS
from pydantic import Field, model_validator

from posor_drivers.instruments.device import Device, DeviceSettings, device_class, settings_of_kinds
from posor_drivers.instruments.frame_store import CAPACITY
from posor_drivers.instruments.reference_entry import ChannelEntry, ReferenceEntry
from posor_drivers.quantity_limits import NOT_NEGATIVE, Delay, TickRate

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

VERSION = 1
WHOLE_NUMBERS = ("lit_sources", "home_mark", "light")
"""Readings that are never interpolated."""
MOST_LATENCY_FRAMES = CAPACITY * 9 // 10  # the rest is for scans that are published late
NotNegative = Annotated[Quantity, NOT_NEGATIVE]


class ReadingEntry(ChannelEntry):
    """A reading of a joint."""

    acceleration: NotNegative | None = None


LitSource = Annotated[int, Field(strict=True, ge=0, le=254)] | ReadingEntry


class JointEntry(FrozenModel):
    """Readings of a joint, in the order of its calibration file."""

    frame_id: Annotated[str, Field(min_length=1)]
    gap_voltages: Annotated[tuple[ReadingEntry, ...], Field(max_length=8)] = ()
    ring_voltages: Annotated[tuple[ReadingEntry, ...], Field(max_length=8)] = ()
    diode_currents: Annotated[tuple[ReadingEntry, ...], Field(max_length=16)] = ()
    lit_sources: Annotated[tuple[LitSource, ...], Field(max_length=4)] = ()
    home_mark: ReadingEntry | None = None
    """Not 0: the home mark of the ring was seen."""
    light: ReadingEntry | None = None
    """0: no light source is lit."""
    demodulated: bool = Field(default=False, strict=True)
    supply_voltage: ReadingEntry | None = None
    temperature: ReadingEntry | None = None
    reference_voltage: ReadingEntry | None = None

    def entries(self) -> Iterator[tuple[str, tuple[str | int, ...], ReadingEntry]]:
        """Yield name of the readings, location in the joint, and entry of each reading."""
        for name in READINGS:
            part: tuple[LitSource, ...] | ReadingEntry | None = getattr(self, name)
            if isinstance(part, ReadingEntry):
                yield name, (name,), part
            else:
                for n, entry in enumerate(part or ()):
                    if isinstance(entry, ReadingEntry):
                        yield name, (name, n), entry

    @model_validator(mode="after")
    def _check_readings(self) -> Self:
        if not any(True for _ in self.entries()):
            raise EntryError("no reading", expected=f"at least one of {', '.join(READINGS)}")
        if len(self.diode_currents) != 4 * len(self.lit_sources):
            what = f"{len(self.diode_currents)} diode currents and {len(self.lit_sources)} lit sources"
            raise EntryError(what, key=("lit_sources",), expected="one source for the four currents of each diode")
        for name in ("light", "demodulated"):
            if getattr(self, name) and not self.diode_currents:
                raise EntryError(f"{name} without diode currents", key=(name,), expected="diode_currents")
        return self


class ThermometerEntry(ChannelEntry):
    """A thermometer of a beam or a plate; the driver of ``joint`` publishes its readings."""

    joint: str


SETTINGS: Any = select_model_by_key("kind", settings_of_kinds())


class InstrumentsFile(FrozenModel):
    """An instruments file."""

    format: Literal["posor_instruments"]
    version: Literal[1]
    name: str
    rate: TickRate
    latency: Delay
    devices: Annotated[dict[str, Annotated[DeviceSettings, SETTINGS]], Field(min_length=1)]
    joints: Annotated[dict[str, JointEntry], Field(min_length=1)]
    references: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], ReferenceEntry] = Field(default_factory=dict)
    thermometers: dict[str, ThermometerEntry] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        devices = self.new_devices()
        self._check_latency(devices)
        units = {f"{name}/{each.name}": each.unit for name, device in devices.items() for each in device.channels}
        used: dict[str, str] = {}
        for joint, readings in self.joints.items():
            for name, location, entry in readings.entries():
                key = ("joints", joint, *location)
                _check_units(READINGS[name], entry, units, key)
                if name in READING_KINDS and entry.channel in used:
                    what = f"channel '{entry.channel}' is used twice, also as {used[entry.channel]}"
                    raise EntryError(what, key=(*key, "channel"), expected="a channel of its own for each reading")
                if name in READING_KINDS:  # they share no channel with others
                    used[entry.channel] = f"{joint}.{name}[{location[-1]}]"
        for part, published in (("references", self.references), ("thermometers", self.thermometers)):
            for name, each in published.items():
                if each.joint not in self.joints:
                    what, expected = f"joint '{each.joint}'", f"one of {', '.join(self.joints)}"
                    raise EntryError(what, key=(part, name, "joint"), expected=expected)
        for name, reference in self.references.items():
            for path, unit, measured_by in reference.measured:
                _check_units(unit, measured_by, units, ("references", name, *path))
        self._check_thermometers(units)
        return self

    def _check_latency(self, devices: dict[str, Device[Any]]) -> None:
        """Raise EntryError: the frames of a tick would be overwritten before its scan is published."""
        for name, device in devices.items():
            frames = self.latency.number * device.frame_rate
            if frames > MOST_LATENCY_FRAMES:
                what = f"{self.latency.number:g} s, {frames:.0f} frames of device '{name}'"
                raise EntryError(what, key=("latency", "value"), expected=f"at most {MOST_LATENCY_FRAMES} frames")

    def _check_thermometers(self, units: dict[str, str]) -> None:
        """Check names and units; that each has a channel of its own: they are compared with one another.

        A plate's thermometer is the ``temperature`` of its joint.
        """
        used: dict[str, str] = {}
        plates = [(joint, each.temperature) for joint, each in self.joints.items() if each.temperature is not None]
        for name, thermometer in self.thermometers.items():
            key = ("thermometers", name)
            if not is_ros_name(name):
                raise EntryError(f"name '{name}'", key=key, expected=ROS_NAME_RULE)
            _check_units("K", thermometer, units, key)
            if (other := used.setdefault(thermometer.channel, name)) != name:
                what = f"channel '{thermometer.channel}' is used twice, also by thermometer '{other}'"
                raise EntryError(what, key=(*key, "channel"), expected="a channel of its own for each thermometer")
            same = [(joint, entry) for joint, entry in plates if entry.channel == thermometer.channel]
            if same and thermometer.joint not in [joint for joint, _ in same]:
                what = f"channel '{thermometer.channel}' is the temperature of joint '{same[0][0]}'"
                raise EntryError(what, key=(*key, "joint"), expected=f"joint: {same[0][0]}, or another channel")
            for joint, entry in same:
                if (entry.factor, entry.shift) != (thermometer.factor, thermometer.shift):
                    expected = f"scale and offset of joints.{joint}.temperature, the same channel"
                    raise EntryError("another scale or offset", key=key, expected=expected)

    def new_devices(self) -> dict[str, Device[Any]]:
        """Return the devices, not connected."""
        return {name: device_class(settings.kind)(name, settings) for name, settings in self.devices.items()}


def _check_units(unit: str, entry: ChannelEntry, units: dict[str, str], key: tuple[str | int, ...]) -> None:
    if entry.channel not in units:
        raise EntryError(f"channel '{entry.channel}'", key=(*key, "channel"), expected=f"one of {', '.join(units)}")
    per_channel = units[entry.channel]
    if isinstance(entry, ReadingEntry) and unit == "1" and (entry.scale is not None or entry.offset is not None):
        raise EntryError("a scale or offset of a whole number", key=key, expected="only a channel of unit 1")
    if entry.scale is None:
        if per_channel != unit:
            what = f"channel '{entry.channel}' is in {per_channel}"
            expected = "a channel of unit 1" if unit == "1" else f"a scale in {unit}/{per_channel}"
            raise EntryError(what, key=key, expected=expected)
    elif entry.scale.unit != f"{unit}/{per_channel}" or entry.scale.array.shape:
        what = f"scale in {entry.scale.unit}"
        raise EntryError(what, key=(*key, "scale", "unit"), expected=f"one number in {unit}/{per_channel}")
    elif entry.factor == 0.0:
        raise EntryError("scale 0", key=(*key, "scale", "value"), expected="a number other than 0")
    acceleration = entry.acceleration if isinstance(entry, ReadingEntry) else None
    if acceleration is not None and acceleration.unit != f"{per_channel}/s^2":
        what = f"acceleration in {acceleration.unit}"
        raise EntryError(what, key=(*key, "acceleration", "unit"), expected=f"one number in {per_channel}/s^2")
    if entry.offset is not None and (entry.offset.unit != unit or entry.offset.array.shape):
        what = f"offset in {entry.offset.unit}"
        raise EntryError(what, key=(*key, "offset", "unit"), expected=f"one number in {unit}")


def load_instruments(path: Path) -> InstrumentsFile:
    """Read and validate an instruments file (YAML, SI).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or holds an invalid entry.

    """
    keys = "format, version, name, rate, latency, devices, joints, references, thermometers"
    return load_document(path, "instruments file", keys, VERSION, InstrumentsFile.model_validate)[0]
