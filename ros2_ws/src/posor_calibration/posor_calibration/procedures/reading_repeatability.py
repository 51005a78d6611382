# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of diodes and of ring probes, from repeated visits of the same places (thesis 7.4.1, 7.4.3; JCGM 100, H.5).

As ``gap_repeatability`` does for gap probes: the noise of one scan is the scatter within the dwells together with what
the visits of one place scatter beyond it. The readings themselves are compared, current ratios or voltages, so neither
map nor profile is needed. The scatter of the stage is part of the result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.bags.recording import POINT, SCALAR
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED, SATURATED
from posor.numerics.stamps import NS
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from pydantic import Field

from posor_calibration.data_checks import check_channels_vary, check_count
from posor_calibration.diode_spots import current_ratios
from posor_calibration.dwells import RestOptions
from posor_calibration.procedure import Outcome, Procedure, Replacement, Table
from posor_calibration.procedures.gap_repeatability import DRIFT, fit_visits, group_places

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

MIN_DWELLS = 6
DIODES, RING = "diode_repeatability", "ring_repeatability"


class ReadingRepeatabilityOptions(RestOptions):
    """Options of ``diode_repeatability`` and ``ring_repeatability``."""

    reference: str = Field(default="", description="topic of the stage; empty: the only one of its kind")
    same: float = Field(
        default=5e-6, gt=0.0, description="dwells whose reference differs by less are visits of the same place [m, rad]"
    )


def measure_diodes(recording: Recording, calibration: Calibration, options: ReadingRepeatabilityOptions) -> Outcome:
    """Find the noise of the ratios of all lit diodes; raises as ``Procedure.identify``."""
    at, part = find_sensor(calibration, DiodesCalibration, DIODES)
    recording = recording.without_status(DIODES_ESTIMATED | SATURATED)
    check_channels_vary(recording.scans, ("diode_currents",), recording.source)
    currents = recording.scans.diode_currents
    if currents.shape[1:2] != (len(part.diodes),):
        raise FitError(f"scans of {currents.shape[1]} diodes", where=DIODES, expected=f"{len(part.diodes)}")
    names, columns, keys = [], [], []
    for index, diode in enumerate(part.diodes):
        if np.all(currents[:, index, :2] + currents[:, index, 2:] >= diode.sums[0]):
            ratios = current_ratios(currents[:, index])
            names += [f"{diode.name} {axis}" for axis in "xy"]
            columns += [ratios[:, 0], ratios[:, 1]]
            keys.append(f"sensors[{at}].diodes[{index}].noise")
    if not keys:
        raise FitError("no diode sees the light in every scan", where=DIODES, expected="a light that stays on one")
    return _measure(recording, np.column_stack(columns), names, keys, "1", POINT, options, DIODES)


def measure_ring(recording: Recording, calibration: Calibration, options: ReadingRepeatabilityOptions) -> Outcome:
    """Find the noise of all ring probes; raises as ``Procedure.identify``."""
    at, part = find_sensor(calibration, BumpyRingCalibration, RING)
    recording = recording.without_status(PROBES_ESTIMATED | SATURATED)
    check_channels_vary(recording.scans, ("ring_voltages",), recording.source)
    volts = recording.scans.ring_voltages
    if volts.shape[1] != len(part.probes):
        raise FitError(f"scans of {volts.shape[1]} ring probes", where=RING, expected=f"{len(part.probes)}")
    names = [f"ring probe {probe.name}" for probe in part.probes]
    keys = [f"sensors[{at}].probes[{index}].noise" for index in range(len(names))]
    return _measure(recording, volts, names, keys, "V", SCALAR, options, RING)


def _measure(
    recording: Recording,
    readings: FloatArray,
    names: list[str],
    keys: list[str],
    unit: str,
    kind: int,
    options: ReadingRepeatabilityOptions,
    what: str,
) -> Outcome:
    """Return the noise of readings (n, c), of which each key of the file has an equal number in turn."""
    track = recording.find_track(options.reference, kind)
    stamps, parts, used = recording.scans.stamps_ns, [], []
    for dwell in options.dwells(track):
        begin, end = np.searchsorted(stamps, dwell.begin_ns), np.searchsorted(stamps, dwell.end_ns, "right")
        part = readings[begin:end][np.isfinite(readings[begin:end]).all(axis=1)]
        if len(part) > 1:
            parts.append(part)
            used.append(dwell)
    check_count(len(parts), MIN_DWELLS, "dwells of the reference with scans", what)
    unit_of_places = "m" if kind == POINT else "rad"
    places = group_places(np.array([dwell.mean for dwell in used]), options.same, unit_of_places, recording.source)
    counts = np.array([len(part) for part in parts])
    squares = np.sum([np.sum(np.square(part - part.mean(axis=0)), axis=0) for part in parts], axis=0)
    within = np.sqrt(squares / np.sum(counts - 1))
    means = np.array([part.mean(axis=0) for part in parts])
    times = np.array([0.5 * (dwell.begin_ns + dwell.end_ns - stamps[0] * 2) / NS for dwell in used])
    centred, sides = times - times.mean(), np.zeros(len(times))
    fits = {
        name: fit_visits(means[:, k], within[k] / np.sqrt(counts), centred, places, sides, unit, f"{what}, {name}")[0]
        for k, name in enumerate(names)
    }
    # Analysis of variance: what the visits scatter beyond the scatter within the dwells is noise of each scan too.
    excess = np.array([max(fit.spread**2 - 1.0, 0.0) for fit in fits.values()])
    noises = within * np.sqrt(1.0 + excess * float(np.mean(1.0 / counts)))
    freedoms = np.array([fit.freedoms for fit in fits.values()])
    sigmas = noises / np.sqrt(2.0 * freedoms)
    drifts = [fit.value(DRIFT) * float(np.ptp(times)) for fit in fits.values()]
    size = len(names) // len(keys)
    values = [noises[n : n + size].tolist() for n in range(0, len(names), size)]
    own_sigmas = [sigmas[n : n + size].tolist() for n in range(0, len(names), size)]
    rows = tuple(zip(names, within.tolist(), noises.tolist(), sigmas.tolist(), drifts, strict=True))
    columns = ("reading", "within the dwells", "noise of a scan", "sigma", f"drift over {np.ptp(times):.4g} s")
    return Outcome(
        method=f"{len(parts)} visits of {places.max() + 1} places, with drift fitted (thesis 7.4.3)",
        fits=fits,
        replacements=tuple(
            Replacement(key, value if size > 1 else value[0], sigma if size > 1 else sigma[0])
            for key, value, sigma in zip(keys, values, own_sigmas, strict=True)
        ),
        tables=(Table("repeatability", columns, ("", *(unit,) * 4), rows),),
    )


DIODE_REPEATABILITY = Procedure(
    DIODES,
    "noise of the diodes, from a light over the same places again and again",
    ReadingRepeatabilityOptions,
    measure_diodes,
    drift_of=(),
)
RING_REPEATABILITY = Procedure(
    RING,
    "noise of the ring probes, from the same angles again and again",
    ReadingRepeatabilityOptions,
    measure_ring,
    drift_of=(),
)
