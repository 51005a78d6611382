"""The calibrated POSOR at poses that it has not seen: how far off it is, and how far its budget says it may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor_estimator.core.budget.first_order import sensitivities
from posor_estimator.core.calibrate.stated import stated_covariance
from posor_estimator.core.fault import State
from posor_estimator.core.posor import Posor

from posor_bringup.campaign.bench import natives_of, recorded, scans_of
from posor_bringup.campaign.steps import poses_in_range

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

    from posor_bringup.campaign.plant import Plant

FREEDOMS = {"x": "m", "y": "m", "gap": "m", "alpha": "rad", "beta": "rad", "theta": "rad"}
"""The six native coordinates and their units, in order."""


@dataclass(frozen=True)
class Fresh:
    """n poses.

    Attributes:
        poses: Native coordinates x, y, gap [m], alpha, beta, theta [rad], (n, 6).
        errors: Of the calibrated POSOR, (n, 6); NaN where it gives no pose.
        before: Of the POSOR as built, (n, 6).
        sigmas: Standard uncertainty by the budget, (n, 6).
        normalised: Error squared, normalised with the budget's covariance; of 6 degrees of freedom, (n,).

    """

    poses: FloatArray
    errors: FloatArray
    before: FloatArray
    sigmas: FloatArray
    normalised: FloatArray


def fresh_poses(plant: Plant, calibration: Calibration, count: int) -> Fresh:
    """Send the true POSOR to fresh poses, and locate it with a calibration."""
    random = plant.random("fresh")
    poses = poses_in_range(plant, count, random)
    scans = recorded(scans_of(plant.later, poses, random), None).scans
    covariance = stated_covariance(calibration)
    errors, before = np.full((2, count, 6), np.nan)
    sigmas, normalised = np.full((count, 6), np.nan), np.full(count, np.nan)
    posor = Posor(calibration, false_alarm=0.0)
    for of, known in ((errors, posor), (before, Posor(plant.known, false_alarm=0.0))):
        found = known.locate_each(scans, poses[:, 5])
        told = np.flatnonzero(found.states != int(State.LOST))
        off = natives_of(found.rotations[told], found.translations[told]) - poses[told]
        off[:, 5] = np.mod(off[:, 5] + np.pi, 2.0 * np.pi) - np.pi
        of[told] = off
        if known is not posor:
            continue
        for n in told.tolist():
            by = sensitivities(posor, scans[n], pin.SE3(found.rotations[n], found.translations[n]))
            noise = by.by_reading * by.noise
            own = noise @ noise.T + by.by_parameter @ covariance @ by.by_parameter.T
            sigmas[n] = np.sqrt(np.diag(own))
            normalised[n] = errors[n] @ np.linalg.solve(own, errors[n])
    return Fresh(poses, errors, before, sigmas, normalised)
