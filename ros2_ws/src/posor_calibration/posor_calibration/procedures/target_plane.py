# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Orientation of the target plane, the surface that the gap probes see, against the axis of rotation.

If the plane is not square to the axis, the gaps change with the sine and cosine of theta while the target turns, which
looks like a lean. The two fitted tilts of the plane keep alpha and beta where the reference says, or, without a
reference, where they were. Theta is the POSOR's own. The range of theta decides how well the tilts are separated from
the constant lean of the axis. Source: thesis 8.3.1, flatness of the plate, there corrected by constants times
sin(theta).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.calibration_file import find_sensor
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.gap_probes import GapProbesCalibration
from pydantic import Field

from posor_calibration.attitude_fit import AttitudeOptions, AttitudeParameter, ReferenceAttitude, fit_attitude
from posor_calibration.calibration_parameters import parameter_indices
from posor_calibration.data_checks import check_count
from posor_calibration.fit_report import correlation_table, parameter_table
from posor_calibration.procedure import ANGLES, Outcome, Procedure, Replacement

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration

NAME = "target_plane"
MIN_SCANS = 6


class TargetPlaneOptions(AttitudeOptions):
    """Options of ``target_plane``."""

    reference: str = Field(default="", description="topic of a reference of the lean; empty: the axis is steady")
    wobble_sigma: float = Field(
        default=5e-6,
        gt=0.0,
        description="standard deviation of alpha and beta of the axis, or of alpha beside a reference point [rad]",
    )
    expected_tilt: float = Field(default=1e-3, gt=0.0, description="prior standard uncertainty of the tilts [rad]")


def find_target_plane(recording: Recording, calibration: Calibration, options: TargetPlaneOptions) -> Outcome:
    """Find the tilts of the target plane; raises as ``Procedure.identify``."""
    applied = calibration.for_session(options.session)
    sensor, part = find_sensor(applied, GapProbesCalibration, NAME)
    valid = ~recording.has_status(PROBES_ESTIMATED | SATURATED)
    check_count(int(valid.sum()), MIN_SCANS, "scans", f"{NAME}, {recording.source}")
    where = parameter_indices(applied, sensor, ["plane_tilt[0]", "plane_tilt[1]"])
    has_reference = bool(options.reference or options.lever)
    if has_reference:
        reference = options.read_reference(recording, options.wobble_sigma)
    else:
        sigmas = np.array([options.wobble_sigma] * 2 + [np.inf])
        reference = ReferenceAttitude(np.zeros((len(recording.scans), 3)), sigmas, None)
    found = fit_attitude(
        calibration,
        recording,
        options,
        reference,
        [
            AttitudeParameter(f"tilt about {a}", "rad", int(i), options.expected_tilt)
            for a, i in zip("XY", where, strict=True)
        ],
        ("alpha", "beta"),
        check_reference=False,  # a wrong tilt looks like such a motion
        estimate_fixed=False,  # the motion is mostly noise, from which a scale of the readings would be estimated
        what=NAME,
    )
    fit = found.fit
    key = f"sensors[{sensor}].target_plane.tilt"
    return Outcome(
        method=f"least squares of alpha and beta over a turn of {np.ptp(found.thetas[found.used]):.3g} rad of an axis "
        f"that {'is measured' if has_reference else 'keeps its direction'} (thesis 8.3.1)",
        fits={NAME: fit},
        replacements=(Replacement(key, fit.values[:2].tolist(), fit.sigmas[:2].tolist()),),
        covariances=(found.fixed.joint_covariance((f"{key}[0]", f"{key}[1]"), fit),),
        tables=(
            parameter_table("tilt of the target plane", fit, part.target_plane.tilt.array, 2),
            correlation_table(fit, len(fit.names)),
        ),
        warnings=found.describe(2),
        figures=found.error_figures(found.thetas, "theta [rad]", ("alpha", "beta"), "apparent {}"),
    )


PROCEDURE = Procedure(
    NAME,
    "tilt of the target plane against the axis of rotation, from a turn",
    TargetPlaneOptions,
    find_target_plane,
    drift_of=("y", "z", *ANGLES[:2]),
)
