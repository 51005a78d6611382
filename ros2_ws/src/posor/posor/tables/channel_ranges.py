# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The channels that a calibration has, and the values that it accepts: compared with the columns of a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import CONTACT_LETTERS, DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor.tables.table_map import READINGS
from posor.tables.table_units import UNITS, units_of

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray


class Channel(NamedTuple):
    """A channel of a calibration: the reading of a map, its number there, its name, and the accepted values."""

    reading: str
    number: int
    name: str
    lowest: float
    highest: float
    required: bool = True


def likely_unit(number: float, channel: Channel) -> str:
    """Return the unit in which a number is within the range of a channel: SI, or the largest one; empty: no unit."""
    si = READINGS[channel.reading]
    units = [UNITS[name] for name in units_of(si)]
    fitting = [
        unit for unit in units if channel.lowest <= number * float(unit.factor) + float(unit.shift) <= channel.highest
    ]
    best = max(fitting, key=lambda unit: (unit.name == si, unit.factor), default=None)
    return best.name if best else ""


def channels_of(calibration: Calibration) -> list[Channel]:
    """Return the channels in the order of the file; a diode has four, whose range is that of the sum of two."""
    channels: list[Channel] = []
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            reading = "gap_voltages" if isinstance(sensor, GapProbesCalibration) else "ring_voltages"
            for probe in sensor.probes:
                low, high = probe.range.array - probe.zero_shift.number
                channels.append(Channel(reading, _count(channels, reading), probe.name, float(low), float(high)))
        elif isinstance(sensor, DiodesCalibration):
            for diode in sensor.diodes:
                for contact in CONTACT_LETTERS:
                    name, number = f"{diode.name} {contact}", _count(channels, "diode_currents")
                    channels.append(Channel("diode_currents", number, name, *diode.sums))
    environment = calibration.environment
    for reading, part in (("supply_voltage", "supply"), ("temperature", "temperature")):
        stated = environment and getattr(environment, part)
        if stated:
            low, high = stated.range.array
            channels.append(Channel(reading, 0, part, float(low), float(high), required=False))
    return channels


def _count(channels: list[Channel], reading: str) -> int:
    return sum(channel.reading == reading for channel in channels)


def light_sources(calibration: Calibration) -> int:
    """Return the number of light sources."""
    found = [len(sensor.light_sources) for sensor in calibration.sensors if isinstance(sensor, DiodesCalibration)]
    return sum(found)


def compared_values(channel: Channel, scans: Scans) -> FloatArray:
    """Return what is compared with a channel's range (n,): values, or the sums A + C, or B + D, of a diode [A]."""
    if channel.reading == "supply_voltage":
        return scans.supply_voltages
    if channel.reading == "temperature":
        return scans.temperatures
    if channel.reading != "diode_currents":
        voltages: FloatArray = getattr(scans, channel.reading)
        return voltages[:, channel.number]
    diode, contact = divmod(channel.number, len(CONTACT_LETTERS))
    currents = scans.diode_currents[~scans.dark][:, diode]
    return np.asarray(currents[:, contact] + currents[:, (contact + 2) % len(CONTACT_LETTERS)])
