"""The digital zero: shifts of the gap probes' voltages such that a plate standing at a known place is seen there.

Source: thesis 8.3.1, where drift of the probes' zero is taken out in software. Three probes know the gap and the two
leans; x, y and theta are taken as measured, they move the gaps only through the tilt of the target plane.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from posor_estimator.core.calibrate.parameters import the_sensor
from posor_estimator.core.calibration.fit_record import FitRecord, RecordedData
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.calibration.session import Session
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.core.sensors.base import RowSensor
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

WHAT = "digital zero"
LEAST = 10
"""Scans below which their scatter says too little."""
STILL = 5.0
"""The two halves of the scans may differ by so many standard uncertainties of their difference."""


@dataclass(frozen=True)
class DigitalZero:
    """New zero shifts.

    Attributes:
        calibration: With them in force.
        shifts: Of each gap probe [V], value and standard uncertainty; the latter of the mean voltages only.
        changes: New less old [V], (probes,).

    """

    calibration: Calibration
    shifts: Quantity
    changes: FloatArray


def digital_zero(calibration: Calibration, scans: Scans, home: tuple[float, float, float]) -> DigitalZero:
    """Return the calibration whose gap probes see the target at home where some scans were taken.

    Args:
        calibration: The calibration in force.
        scans: Taken while the target stood at home.
        home: Gap [m], alpha and beta [rad] there.

    Raises:
        FitError: The POSOR has no gap probes, there are too few scans, the target moved, or home is out of range.

    """
    where, probes = the_sensor(calibration, GapProbesCalibration, WHAT)
    names = [probe.name for probe in probes.probes]
    mean, sigmas = _at_rest(scans, names)
    posor = Posor(calibration)
    if any(not isinstance(sensor, RowSensor) for sensor in posor.stack.sensors):
        raise FitError("a sensor of the POSOR cannot be run backwards", where=WHAT, expected="sensors with rows")
    estimate = posor.locate(mean)
    if estimate.T_R_T is None:
        raise FitError(f"the mean scan gives no pose: {estimate.reason.rstrip('.')}", where=WHAT)
    x, y, _, _, _, theta = estimate.native
    gap, alpha, beta = home
    at_home = pin.SE3(rotation_from_native(alpha, beta, theta), np.array([x, y, gap]))
    sensor, first = posor.stack.sensors[where], posor.stack.first_rows[where]
    readings = posor.predict(mean, at_home)[None, first : first + len(names)]
    assert isinstance(sensor, RowSensor)  # noqa: S101  seen above
    volts = sensor.encode(readings, Scans.of([mean]))["gap_voltages"][0]
    if not np.isfinite(volts).all():
        name = names[int(np.argmin(np.isfinite(volts)))]
        raise FitError(
            f"at home, probe {name} would read {readings[0, int(np.argmin(np.isfinite(volts)))]:.6g} m, beyond its "
            "calibrated range",
            where=WHAT,
            expected="a home within the range of every probe",
        )
    changes = volts - mean.gap_voltages
    before = np.array([probe.zero_shift.number for probe in probes.probes])
    shifts = Quantity(value=(before + changes).tolist(), sigma=sigmas.tolist(), unit="V")
    zeroed = probes.for_session(Session(note=WHAT, zero_shifts=shifts))
    sensors = [zeroed if i == where else part for i, part in enumerate(calibration.sensors)]
    update: dict[str, Any] = {"sensors": sensors}
    if calibration.fits:
        update["fits"] = [*calibration.fits, _record(calibration.session, where, len(names), mean.stamp_ns)]
    return DigitalZero(calibration.model_copy(update=update), shifts, changes)


def _record(session: str, where: int, probes: int, stamp_ns: int) -> FitRecord:
    """Return what says that the zero shifts are no longer those of the fits before, with what those said of them."""
    date = dt.datetime.fromtimestamp(stamp_ns * 1e-9, tz=dt.UTC).isoformat(timespec="seconds")
    shifts = [f"sensors[{where}].probes[{i}].zero_shift" for i in range(probes)]
    return FitRecord(
        procedure="digital_zero",
        method="zero shifts that show the target at home (thesis 8.3.1)",
        date=date,
        recording=RecordedData(name="scans at home", sha256=""),
        replaced=[*shifts, f"sessions.{session}.zero_shifts"],
    )


def _at_rest(scans: Scans, names: list[str]) -> tuple[Scan, FloatArray]:
    """Return the mean of scans, and the standard uncertainty of its gap voltages, (probes,)."""
    if len(scans) < LEAST:
        raise FitError(f"{len(scans)} scans", where=WHAT, expected=f"at least {LEAST}")
    volts = scans.gap_voltages
    if volts.shape[1] != len(names):
        raise FitError(f"{volts.shape[1]} gap voltages in a scan", where=WHAT, expected=f"{len(names)}")
    if not np.isfinite(volts).all():
        raise FitError("a gap voltage is not finite", where=WHAT, expected="sound scans")
    half = len(scans) // 2
    earlier, later = volts[:half], volts[half:]
    unsure = np.sqrt(earlier.var(axis=0, ddof=1) / len(earlier) + later.var(axis=0, ddof=1) / len(later))
    off = np.abs(later.mean(axis=0) - earlier.mean(axis=0))
    moved = off > STILL * unsure
    if moved.any():
        worst = int(np.argmax(np.where(moved, off, 0.0)))
        raise FitError(
            f"the target moves: probe {names[worst]} changed by {off[worst]:.3g} V within {len(scans)} scans",
            where=WHAT,
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
    )
    return mean, volts.std(axis=0, ddof=1) / np.sqrt(len(scans))
