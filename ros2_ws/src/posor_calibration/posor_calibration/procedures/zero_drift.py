# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Zero-drift search: the zero shifts of the gap probes for which the POSOR agrees best with a reference.

The probes' electronics drift by some tenths of a volt from day to day, while their curves keep their shape. A zero
shift moves the operating point on the curve and so the slope: an error of alpha and beta that grows with the motion.
Source: thesis 8.3.1, table 8.1. There shifts were tried by hand; least squares also gives their uncertainty.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from posor.calibration.calibration_file import find_sensor
from posor.sensors.gap_probes import GapProbesCalibration
from pydantic import Field

from posor_calibration.attitude_fit import AttitudeOptions, AttitudeParameter, fit_attitude
from posor_calibration.calibration_parameters import parameter_indices
from posor_calibration.data_checks import check_channels_move, check_count
from posor_calibration.fit_report import result_tables
from posor_calibration.procedure import ANGLES, Outcome, Procedure, Replacement

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration

NAME = "zero_drift"
MIN_SCANS = 5
AT_REST = 1e-5  # change of the reference's angles [rad] below which a reading may repeat to the last digit


class ZeroDriftOptions(AttitudeOptions):
    """Options of ``zero_drift``."""

    reference: str = Field(default="", description="topic of the reference; empty: the only one of its kind")
    twist_sigma: float = Field(
        default=17e-6, gt=0.0, description="standard deviation of alpha, which a reference point does not show [rad]"
    )
    angles: tuple[Literal["alpha", "beta", "theta"], ...] = Field(
        default=("alpha", "beta"), min_length=1, description="angles that are compared with the reference"
    )
    session: str = Field(default="", description="session of the file whose zero shifts are fitted; empty: the probes'")
    expected_drift: float = Field(default=0.1, gt=0.0, description="prior standard uncertainty of the shifts [V]")
    first_sigma: float | None = Field(
        default=None,
        ge=0.0,
        description="standard uncertainty of the angles' zero at the first scan [rad]; 0: exact, motion is referred to "
        "it as in 1985; none: as at any other scan",
    )


def find_zero_drift(recording: Recording, calibration: Calibration, options: ZeroDriftOptions) -> Outcome:
    """Find the zero shifts; raises as ``Procedure.identify``."""
    applied = calibration.for_session(options.session)
    sensor, part = find_sensor(applied, GapProbesCalibration, NAME)
    count = len(part.probes)
    reference = options.read_reference(recording, options.twist_sigma)
    volts = recording.scans.gap_voltages
    whole = np.isfinite(volts).all(axis=1) & np.isfinite(reference.angles).all(axis=1)
    check_count(int(whole.sum()), MIN_SCANS, "scans while the reference was recorded", NAME)
    places = np.round(reference.angles[whole] / AT_REST)
    names = [f"gap probe {probe.name}" for probe in part.probes]
    check_channels_move(names, volts[whole], np.zeros_like(volts[whole]), places, recording.source, "sample")
    where = parameter_indices(applied, sensor, [f"zero_shifts[{k}]" for k in range(count)])
    found = fit_attitude(
        calibration,
        recording,
        options,
        reference,
        [
            AttitudeParameter(f"zero shift of {probe.name}", "V", int(index), options.expected_drift)
            for probe, index in zip(part.probes, where, strict=True)
        ],
        options.angles,
        first_sigma=options.first_sigma,
        check_reference=True,
        estimate_fixed=True,
        what=NAME,
    )
    fit = found.fit
    shifts, sigmas = fit.values[:count].tolist(), fit.sigmas[:count].tolist()
    if options.session:
        key = f"sessions.{options.session}.zero_shifts"
        entries = tuple(f"{key}[{k}]" for k in range(count))
        replacements: tuple[Replacement, ...] = (Replacement(key, shifts, sigmas),)
    else:
        entries = tuple(f"sensors[{sensor}].probes[{k}].zero_shift" for k in range(count))
        replacements = tuple(Replacement(*new) for new in zip(entries, shifts, sigmas, strict=True))
    before = np.array([probe.zero_shift.number for probe in part.probes])
    seconds = (recording.scans.stamps_ns - recording.scans.stamps_ns[0]) * 1e-9
    return Outcome(
        method=f"least squares of {', '.join(options.angles)} against the reference over "
        f"{np.count_nonzero(found.used)} scans (thesis 8.3.1)",
        fits={NAME: fit},
        replacements=replacements,
        covariances=(found.fixed.joint_covariance(entries, fit),),
        tables=(*result_tables("zero shifts", fit, before, count), found.error_table()),
        warnings=found.describe(count),
        figures=found.error_figures(seconds, "time [s]"),
    )


PROCEDURE = Procedure(
    NAME,
    "zero shifts of the gap probes from a motion that a reference measures",
    ZeroDriftOptions,
    find_zero_drift,
    drift_of=("y", "z", *ANGLES[:2]),
)
