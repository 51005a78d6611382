# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of readings that are interpolated while the arm moves: the calibration's noise and the interpolation error.

A calibration is made at rest, so the noise that it states has no part for the interpolation between frames. An entry of
the instruments file can state the largest ``acceleration`` of its channel. The interpolation error is then at most
``interpolation_error``, and with a uniform distribution within this bound its variance is a third of the bound's square
(JCGM 100, 4.3.7). The estimator takes noise from the calibration file alone, so it is added there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from posor.calibration.edit import edit_document
from posor.model.scan import CONTACTS
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

from posor_drivers.instruments.interpolation import interpolation_error

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration

    from posor_drivers.instruments.instruments_file import InstrumentsFile, ReadingEntry


class ReadingNoise(NamedTuple):
    """Noise of a channel of the calibration file, for a probe [V] or the two ratios of a diode [1]."""

    name: str
    key: str  # of its noise in the calibration file
    unit: str
    at_rest: tuple[float, ...]
    bound: float  # of the interpolation error

    @property
    def in_motion(self) -> list[float]:
        """Root sum square of the noise at rest and the standard deviation of the interpolation error."""
        return [math.hypot(noise, self.bound / math.sqrt(3.0)) for noise in self.at_rest]

    def __str__(self) -> str:
        """Return one sentence."""
        at_rest, in_motion = (" and ".join(f"{size:.3g}" for size in sizes) for sizes in (self.at_rest, self.in_motion))
        bound = f"the interpolation error is at most {self.bound:.2g} {self.unit}"
        reason = bound if self.bound else "no acceleration is stated"
        return f"{self.name}: noise {at_rest} {self.unit} at rest, {in_motion} {self.unit} in motion; {reason}"


def noise_in_motion(file: InstrumentsFile, joint: str, calibration: Calibration) -> list[ReadingNoise]:
    """Return the noise of each probe and diode of a joint."""
    entry, intervals = file.joints[joint], {name: each.longest_interval_s for name, each in file.new_devices().items()}

    def bound_of(reading: ReadingEntry) -> float:
        """Return the largest interpolation error of a reading, in its unit; zero without a stated acceleration."""
        if reading.acceleration is None:
            return 0.0
        return interpolation_error(abs(reading.factor) * reading.acceleration.number, intervals[reading.device])

    found = []
    for s, sensor in enumerate(calibration.sensors):
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            readings = entry.gap_voltages if isinstance(sensor, GapProbesCalibration) else entry.ring_voltages
            for n, (probe, reading) in enumerate(zip(sensor.probes, readings, strict=False)):
                key, noise = f"sensors[{s}].probes[{n}].noise", (probe.noise.number,)
                found.append(ReadingNoise(probe.name, key, "V", noise, bound_of(reading)))
        elif isinstance(sensor, DiodesCalibration):
            for n, diode in enumerate(sensor.diodes):
                contacts = entry.diode_currents[CONTACTS * n : CONTACTS * (n + 1)]
                # A ratio (A - C) / (A + C) changes by at most twice the change of a current over the least sum.
                bound = 2.0 * max(map(bound_of, contacts), default=0.0) / diode.minimum_sum.number
                noise = tuple(diode.noise.array.tolist())
                found.append(ReadingNoise(diode.name, f"sensors[{s}].diodes[{n}].noise", "1", noise, bound))
    return found


def calibration_in_motion(path: Path, noises: Sequence[ReadingNoise]) -> str:
    """Return the text of a calibration file with the noise of readings in motion; all else is unchanged."""
    changes = {
        each.key: {"value": each.in_motion if len(each.at_rest) > 1 else each.in_motion[0], "unit": each.unit}
        for each in noises
        if each.bound
    }
    return edit_document(path.read_text(encoding="utf-8"), str(path), changes)
