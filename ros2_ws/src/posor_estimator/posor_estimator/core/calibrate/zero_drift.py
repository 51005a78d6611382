"""Digital zero-drift search: the zero shifts of the gap probes with which the POSOR agrees best with a reference.

The probes' electronics drift by some tenths of a volt from day to day, while their curves keep their shape. A shift
moves the point of the curve at which a probe works and so its slope: it shows as an error of alpha and beta that grows
with the motion. Source: thesis 8.3.1, table 8.1. There shifts were tried until the errors were least; here that is
least squares, which tells also how well each shift is known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.attitude_fit import AttitudeFit, Unknown, deviation, fit_attitude
from posor_estimator.core.calibrate.checks import check_alive, check_enough
from posor_estimator.core.calibrate.fit import Loss
from posor_estimator.core.calibrate.orientation import ANGLES, orientation_at
from posor_estimator.core.calibrate.parameters import indices, the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Options, Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import PROBES_ESTIMATED, SATURATED
from posor_estimator.core.calibrate.replacement import Replacement
from posor_estimator.core.calibrate.reporting import correlation_table, fit_warnings, parameter_table, row
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

NAME = "zero_drift"
URAD = 1e-6
LEAST_SCANS = 5
STANDING = 1e-5
"""Change of the reference's angles [rad] below which a reading may stay the same to the last digit."""


class ZeroDriftOptions(Options):
    """Options of the zero-drift search."""

    reference: str = Field(default="", description="topic of the reference; empty: the only one of its kind")
    lever: float = Field(
        default=0.0, ge=0.0, description="distance of a reference point from the pivot [m]; 0: the reference is a pose"
    )
    twist_sigma: float = Field(
        default=17e-6, gt=0.0, description="how still alpha, which a reference point does not show, was kept [rad]"
    )
    angles: tuple[Literal["alpha", "beta", "theta"], ...] = Field(
        default=("alpha", "beta"), min_length=1, description="which angles have to agree"
    )
    session: str = Field(
        default="", description="session of the file whose zero shifts are meant; empty: the probes' own"
    )
    expected_drift: float = Field(default=0.1, gt=0.0, description="standard uncertainty of the shifts so far [V]")
    first_sigma: float | None = Field(
        default=None,
        ge=0.0,
        description="how well the angles' zero at the first scan is known [rad]; 0: exact, motion is referred to it "
        "as in 1985; none: as well as at any other",
    )
    longest_gap: float = Field(default=0.5, gt=0.0, description="references further apart are not joined by a line [s]")
    loss: Loss = Field(default="linear", description="of the fit; soft_l1 or huber survive outliers")
    trust_sigmas: bool = Field(
        default=True,
        description="whether the readings scatter as stated; if not, the uncertainty follows the residuals",
    )


def find_zero_drift(recording: Recording, calibration: Calibration, options: ZeroDriftOptions) -> Outcome:
    """Find the zero shifts; see ``ZeroDriftOptions``.

    Raises:
        FitError: The data do not determine the shifts.
        TrackError: The reference does not serve.
        CalibrationError: There is no such session.

    """
    applied = calibration.for_session(options.session)
    sensor, probes = the_sensor(applied, GapProbesCalibration, NAME)
    reference = orientation_at(
        recording,
        recording.scans.stamps_ns,
        options.reference,
        lever=options.lever,
        twist_sigma=options.twist_sigma,
        longest_gap_s=options.longest_gap,
    )
    count = len(probes.probes)
    where = indices(applied, sensor, [f"zero_shifts[{k}]" for k in range(count)])
    before = np.array([probe.zero_shift.number for probe in probes.probes])
    unknowns = [
        Unknown(f"zero shift of {probe.name}", "V", int(index), options.expected_drift)
        for probe, index in zip(probes.probes, where, strict=True)
    ]
    names = [f"gap probe {probe.name}" for probe in probes.probes]
    volts = recording.scans.gap_voltages
    whole = np.isfinite(volts).all(axis=1) & np.isfinite(reference.angles).all(axis=1)
    places = np.round(reference.angles[whole] / STANDING)
    check_enough(int(whole.sum()), LEAST_SCANS, "scans while the reference was recorded", NAME)
    check_alive(names, volts[whole], np.zeros_like(volts[whole]), places, recording.source)
    found = fit_attitude(
        calibration,
        options.session,
        recording.scans,
        ~recording.having(PROBES_ESTIMATED | SATURATED),
        reference,
        unknowns,
        options.angles,
        first_sigma=options.first_sigma,
        check=True,
        along=True,
        loss=options.loss,
        trust_sigmas=options.trust_sigmas,
        what=NAME,
    )
    return _outcome(found, recording.scans, options, before, sensor)


def _outcome(found: AttitudeFit, scans: Scans, options: ZeroDriftOptions, before: FloatArray, sensor: int) -> Outcome:
    count = len(before)
    fit = found.fit
    scales = np.array([*[options.expected_drift] * count, *[1e-3] * (len(fit.names) - count)])
    replacements, entries = _replacements(fit.values[:count], fit.sigmas[:count], options.session, sensor)
    left_out = int(np.count_nonzero(~found.used))
    warnings = fit_warnings(fit, scales, count, found.readings)
    if left_out:
        unused = (
            f"{left_out} of {len(found.used)} scans count for nothing: they give no pose, have no reference, or their "
            "readings were filled in or saturated."
        )
        warnings = (unused, *warnings)
    return Outcome(
        method=f"least squares of {', '.join(options.angles)} against the reference over "
        f"{np.count_nonzero(found.used)} scans (thesis 8.3.1)",
        fits={NAME: fit},
        replacements=replacements,
        covariances=(found.taken.joint(entries, fit),),
        tables=(
            parameter_table("zero shifts", fit, before, count),
            correlation_table(fit, count),
            _error_table(found),
        ),
        warnings=warnings,
        figures=_figures(found, scans),
    )


def _replacements(
    shifts: FloatArray, sigmas: FloatArray, session: str, sensor: int
) -> tuple[tuple[Replacement, ...], tuple[str, ...]]:
    """Return what changes in the file, and the key of each shift."""
    if session:
        key = f"sessions.{session}.zero_shifts"
        return (Replacement(key, shifts.tolist(), sigmas.tolist()),), tuple(f"{key}[{k}]" for k in range(len(shifts)))
    keys = tuple(f"sensors[{sensor}].probes[{k}].zero_shift" for k in range(len(shifts)))
    made = (Replacement(key, float(v), float(s)) for key, v, s in zip(keys, shifts, sigmas, strict=True))
    return tuple(made), keys


def _error_table(found: AttitudeFit) -> Table:
    """Return the standard deviation and the largest of the angles' errors, before and after."""
    compared = np.isfinite(found.after).all(axis=1)
    before, after = found.before[compared], found.after[compared]
    figures = np.array(
        [
            *(deviation(errors) for errors in (before, after)),
            *(np.max(np.abs(errors), axis=0, initial=0.0) for errors in (before, after)),
        ]
    )
    rows = tuple(row(angle, figures[:, i] / URAD) for i, angle in enumerate(ANGLES))
    return Table(
        "error of the angles, POSOR less reference, referred to the first scan",
        ("angle", "sd before", "sd after", "largest before", "largest after"),
        ("", "urad", "urad", "urad", "urad"),
        rows,
    )


def _figures(found: AttitudeFit, scans: Scans) -> tuple[Figure, ...]:
    seconds = (scans.stamps_ns - scans.stamps_ns[0]) * 1e-9
    return tuple(
        Figure(
            f"error of {angle}",
            "time [s]",
            "POSOR less reference [urad]",
            {
                name: (seconds[found.used], errors[found.used, i] / URAD)
                for name, errors in (("before", found.before), ("after", found.after))
            },
        )
        for i, angle in enumerate(ANGLES)
    )


PROCEDURE = Procedure(
    NAME, "zero shifts of the gap probes from a motion that a reference measures", ZeroDriftOptions, find_zero_drift
)
