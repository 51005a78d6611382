# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The readings that a calibration file expects of a joint, compared with those of an instruments file."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from posor.errors import CalibrationError, sum_up
from posor.sensors.base import READING_KINDS
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import CONTACT_LETTERS, DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor.tables.channel_ranges import light_sources

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration

    from posor_drivers.instruments.instruments_file import JointEntry

"""Readings whose number follows from the calibration; a sensor of another package may use more."""


def readings_of(calibration: Calibration) -> dict[str, str]:
    """Return the kind of each reading of a POSOR by the name of its channel, in the order of the calibration file."""
    readings: dict[str, str] = {}
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration):
            readings |= {probe.name: "gap_voltages" for probe in sensor.probes}
            readings |= {"reference": "reference_voltage"} if sensor.reference is not None else {}
        elif isinstance(sensor, BumpyRingCalibration):
            readings |= {probe.name: "ring_voltages" for probe in sensor.probes} | {"home": "home_mark"}
        elif isinstance(sensor, DiodesCalibration):
            names = [diode.name for diode in sensor.diodes]
            readings |= {f"{name}_{contact}": "diode_currents" for name in names for contact in CONTACT_LETTERS}
            readings |= {f"{name}_source": "lit_sources" for name in names}
            readings |= {"light": "light"} if sensor.ambient is not None else {}
    return readings


def check_readings(entry: JointEntry, calibration: Calibration, where: str) -> None:
    """Check the readings and the frame of a joint in an instruments file against its calibration.

    Raises CalibrationError: a number of readings, a light source or the frame differs; names ``where``.
    """
    expected, errors = Counter(readings_of(calibration).values()), []
    for name in READING_KINDS:
        number = len(getattr(entry, name))
        if expected[name] and number != expected[name]:
            what = f"{number} {name}"
            errors.append(CalibrationError(what, where=where, expected=f"{expected[name]}, as in the calibration"))
    sources = light_sources(calibration)
    errors += [
        CalibrationError(f"light source {lit}", where=where, expected=f"0 to {sources - 1}")
        for lit in entry.lit_sources
        if sources and isinstance(lit, int) and lit >= sources
    ]
    if entry.frame_id != calibration.frames.parent:
        expected_frame = f"'{calibration.frames.parent}', as in the calibration"
        errors.append(CalibrationError(f"frame_id '{entry.frame_id}'", where=where, expected=expected_frame))
    if errors:
        raise sum_up(errors)
