# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A calibrated POSOR at poses that no procedure has used: its errors, and the errors that its budget predicts.

Each pose has one scan with noise and converter and one scan without; errors of the latter come from the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.calibration.parameter_covariance import stated_covariance
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.numerics.vector import wrapped_angles
from posor.uncertainty.first_order import sensitivities

from posor_lab.campaign.calibration_rig import (
    SUPPLY,
    natives_of_poses,
    record_scans,
    rotations_of_natives,
    scan_stamps,
    simulate_scans,
)
from posor_lab.campaign.campaign_steps import draw_native_poses

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_lab.campaign.ground_truth import GroundTruth

FREEDOMS = {"x": "m", "y": "m", "gap": "m", "alpha": "rad", "beta": "rad", "theta": "rad"}
"""The six native coordinates and their units, in order."""


@dataclass(frozen=True)
class ValidationSet:
    """Errors and budgets at n validation poses, native coordinates x, y, gap [m], alpha, beta, theta [rad]."""

    errors: FloatArray  # errors of the calibrated POSOR, (n, 6); NaN where it gives no pose
    as_built_errors: FloatArray  # errors of the POSOR as built, (n, 6)
    sigmas: FloatArray  # standard uncertainties by the budget, (n, 6)
    normalised_squares: FloatArray  # squared errors normalised with the covariance of the budget, (n,)
    noise_free_errors: FloatArray  # errors of the calibrated POSOR without noise, (n, 6)
    calibration_sigmas: FloatArray  # standard uncertainties by the calibration's part of the budget, (n, 6)

    @property
    def located(self) -> BoolArray:
        """Which poses the calibrated POSOR gives, (n,)."""
        return np.isfinite(self.normalised_squares)

    def root_mean_squares(self) -> dict[str, FloatArray]:
        """Return errors and budgets as root mean squares over the poses [m, rad], (6,), by their names in JSON."""
        return {
            name: np.sqrt(np.nanmean(np.square(values), axis=0))
            for name, values in (
                ("errors", self.errors),
                ("budget", self.sigmas),
                ("errors_as_built", self.as_built_errors),
                ("errors_without_noise", self.noise_free_errors),
                ("budget_of_calibration", self.calibration_sigmas),
            )
        }


def validate_calibration(truth: GroundTruth, calibration: Calibration, count: int) -> ValidationSet:
    """Move the true POSOR to new random poses, and estimate these with a calibration."""
    random = truth.random("fresh")
    poses = draw_native_poses(truth, count, random)
    scans = record_scans(simulate_scans(truth.real, truth.later, poses, random), None).scans
    stamps, supply = scan_stamps(count), np.full(count, SUPPLY)
    rotations = rotations_of_natives(poses)
    quiet = truth.real.scans_at(truth.later, rotations, poses[:, :3], stamps, supply_voltages=supply)
    posor = Posor(calibration, false_alarm=0.0)
    errors, rotations, translations = _estimate_errors(posor, scans, poses)
    sigmas, calibration_sigmas = np.full((2, count, 6), np.nan)
    normalised = np.full(count, np.nan)
    covariance = stated_covariance(calibration)
    for n in np.flatnonzero(np.isfinite(errors[:, 0])).tolist():
        effects = sensitivities(posor, scans[n], pin.SE3(rotations[n], translations[n]))
        noise = effects.by_reading * effects.noise
        calibration_part = effects.by_parameter @ covariance @ effects.by_parameter.T
        total = noise @ noise.T + calibration_part
        sigmas[n], calibration_sigmas[n] = np.sqrt(np.diag(total)), np.sqrt(np.diag(calibration_part))
        normalised[n] = errors[n] @ np.linalg.solve(total, errors[n])
    return ValidationSet(
        errors,
        _estimate_errors(Posor(truth.as_built, false_alarm=0.0), scans, poses)[0],
        sigmas,
        normalised,
        _estimate_errors(posor, quiet, poses)[0],
        calibration_sigmas,
    )


def _estimate_errors(posor: Posor, scans: Scans, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the errors at poses (n, 6), NaN where a POSOR gives no pose, and its rotations and translations."""
    found = posor.estimate_each(scans, poses[:, 5])
    located = np.flatnonzero(found.states != int(State.LOST))
    errors = np.full(poses.shape, np.nan)
    differences = natives_of_poses(found.rotations[located], found.translations[located]) - poses[located]
    differences[:, 5] = wrapped_angles(differences[:, 5])
    errors[located] = differences
    return errors, found.rotations, found.translations
