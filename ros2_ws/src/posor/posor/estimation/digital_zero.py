# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Digital zero: zero shifts of the gap probes with which a target at a known place is seen there.

Source: thesis 8.3.1, where drift of the probes' zero is compensated in software. Three probes determine the gap and the
two leans; x, y and theta are used as measured, since they move the gaps only through the tilt of the target plane.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.calibration.calibration_file import find_sensor
from posor.calibration.fit_record import FitRecord, RecordedData
from posor.calibration.quantity import Quantity
from posor.calibration.session import Session
from posor.errors import FitError
from posor.estimation.corrected_scans import corrected_scans
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import DARK_SUBTRACTED, Scan, Scans
from posor.sensors.base import RowSensor
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

NAME = "digital zero"
MIN_SCANS = 10
MOTION_SIGMAS = 5.0  # the target moves if the means of both halves differ by more standard uncertainties


@dataclass(frozen=True)
class DigitalZero:
    """New zero shifts."""

    calibration: Calibration  # with the new zero shifts in force
    shifts: Quantity  # of each gap probe [V]; the standard uncertainty is that of the mean voltages only
    changes: FloatArray  # new less old [V], (probes,)


def find_digital_zero(
    calibration: Calibration, scans: Scans, home: tuple[float, float, float], dark_currents: FloatArray | None = None
) -> DigitalZero:
    """Return the calibration whose gap probes see the target at home in the given scans.

    ``calibration``: the calibration in force; ``scans``: taken while the target rested at home; ``home``: gap [m],
    alpha and beta [rad] there; ``dark_currents``: see ``corrected_scans``. Raises FitError: the POSOR has no gap
    probes, there are too few scans, the target moved, or home is out of range.
    """
    where, probes = find_sensor(calibration, GapProbesCalibration, NAME)
    names = [probe.name for probe in probes.probes]
    mean, sigmas = _average_at_rest(corrected_scans(scans, calibration, dark_currents), names)
    posor = Posor(calibration)
    sensor, first = posor.stack.sensors[where], posor.stack.first_readings[where]
    if not isinstance(sensor, RowSensor) or any(not isinstance(other, RowSensor) for other in posor.stack.sensors):
        raise FitError("a sensor of the POSOR has no inverse model", where=NAME, expected="sensors with rows")
    estimate = posor.estimate(mean)
    if estimate.T_R_T is None:
        raise FitError(f"the mean scan gives no pose: {estimate.reason.rstrip('.')}", where=NAME)
    x, y, _, _, _, theta = estimate.native
    gap, alpha, beta = home
    import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

    at_home = pin.SE3(rotation_from_native(alpha, beta, theta), np.array([x, y, gap]))
    readings = posor.predict(mean, at_home)[None, first : first + len(names)]
    volts = sensor.encode(readings, Scans.of([mean]))["gap_voltages"][0]
    if not np.isfinite(volts).all():
        index = int(np.argmin(np.isfinite(volts)))
        raise FitError(
            f"at home, probe {names[index]} would read {readings[0, index]:.6g} m, beyond its calibrated range",
            where=NAME,
            expected="a home within the range of every probe",
        )
    changes = volts - mean.gap_voltages
    before = np.array([probe.zero_shift.number for probe in probes.probes])
    shifts = Quantity(value=(before + changes).tolist(), sigma=sigmas.tolist(), unit="V")
    zeroed = probes.for_session(Session(note=NAME, zero_shifts=shifts))
    update: dict[str, Any] = {"sensors": [zeroed if i == where else part for i, part in enumerate(calibration.sensors)]}
    if calibration.fits:
        # A further record replaces what earlier fits state of the shifts.
        replaced = [f"sensors[{where}].probes[{i}].zero_shift" for i in range(len(names))]
        record = FitRecord(
            procedure="digital_zero",
            method="zero shifts that show the target at home (thesis 8.3.1)",
            date=dt.datetime.fromtimestamp(mean.stamp_ns * 1e-9, tz=dt.UTC).isoformat(timespec="seconds"),
            recording=RecordedData(name="scans at home", sha256=""),
            replaced=[*replaced, f"sessions.{calibration.session}.zero_shifts"],
        )
        update["fits"] = [*calibration.fits, record]
    return DigitalZero(calibration.model_copy(update=update), shifts, changes)


def _average_at_rest(scans: Scans, names: list[str]) -> tuple[Scan, FloatArray]:
    """Return the mean of scans at rest, and the standard uncertainty of its gap voltages, (probes,)."""
    if len(scans) < MIN_SCANS:
        raise FitError(f"{len(scans)} scans", where=NAME, expected=f"at least {MIN_SCANS}")
    volts = scans.gap_voltages
    if volts.shape[1] != len(names):
        raise FitError(f"{volts.shape[1]} gap voltages in a scan", where=NAME, expected=f"{len(names)}")
    if not np.isfinite(volts).all():
        raise FitError("a gap voltage is not finite", where=NAME, expected="valid scans")
    half = len(scans) // 2
    earlier, later = volts[:half], volts[half:]
    sigmas = np.sqrt(earlier.var(axis=0, ddof=1) / len(earlier) + later.var(axis=0, ddof=1) / len(later))
    off = np.abs(later.mean(axis=0) - earlier.mean(axis=0))
    moved = off > MOTION_SIGMAS * sigmas
    if moved.any():
        worst = int(np.argmax(np.where(moved, off, 0.0)))
        raise FitError(
            f"the target moves: probe {names[worst]} changed by {off[worst]:.3g} V within {len(scans)} scans",
            where=NAME,
            expected="a target at rest",
        )
    last = scans[len(scans) - 1]
    mean = Scan(
        number=last.number,
        stamp_ns=last.stamp_ns,
        gap_voltages=volts.mean(axis=0),
        ring_voltages=scans.ring_voltages.mean(axis=0),
        diode_currents=scans.diode_currents.mean(axis=0),
        lit_sources=last.lit_sources,
        supply_voltage=float(scans.supply_voltages.mean()),
        temperature=float(scans.temperatures.mean()),
        reference_voltage=float(scans.reference_voltages.mean()),
        status=last.status & DARK_SUBTRACTED,
    )
    return mean, volts.std(axis=0, ddof=1) / np.sqrt(len(scans))
