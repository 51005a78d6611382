"""The calibrated POSOR at poses that it has not seen: how far off it is, and how far its budget says it may be.

At each pose there is one scan as the electronics give it, and one without any noise: what that is off by, the
calibration is to blame for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor_estimator.core.budget.first_order import sensitivities
from posor_estimator.core.calibration.stated import stated_covariance
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor

from posor_bringup.campaign.bench import SUPPLY, natives_of, recorded, rotations_of, scans_of, stamps_of
from posor_bringup.campaign.steps import poses_in_range

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import BoolArray, FloatArray

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
        still_errors: Of the calibrated POSOR without noise, (n, 6).
        still_sigmas: Standard uncertainty by the calibration's part of the budget, (n, 6).

    """

    poses: FloatArray
    errors: FloatArray
    before: FloatArray
    sigmas: FloatArray
    normalised: FloatArray
    still_errors: FloatArray
    still_sigmas: FloatArray

    @property
    def known(self) -> BoolArray:
        """Which poses the calibrated POSOR gives, (n,)."""
        return np.isfinite(self.normalised)


def fresh_poses(plant: Plant, calibration: Calibration, count: int) -> Fresh:
    """Send the true POSOR to fresh poses, and locate it with a calibration."""
    random = plant.random("fresh")
    poses = poses_in_range(plant, count, random)
    scans = recorded(scans_of(plant.later, poses, random), None).scans
    supplies = np.full(count, SUPPLY)
    still = scans_at(plant.later, rotations_of(poses), poses[:, :3], stamps_of(count), supply_voltages=supplies)
    posor = Posor(calibration, false_alarm=0.0)
    errors, rotations, translations = _errors(posor, scans, poses)
    sigmas, still_sigmas = np.full((2, count, 6), np.nan)
    normalised = np.full(count, np.nan)
    covariance = stated_covariance(calibration)
    for n in np.flatnonzero(np.isfinite(errors[:, 0])).tolist():
        by = sensitivities(posor, scans[n], pin.SE3(rotations[n], translations[n]))
        noise = by.by_reading * by.noise
        common = by.by_parameter @ covariance @ by.by_parameter.T
        own = noise @ noise.T + common
        sigmas[n], still_sigmas[n] = np.sqrt(np.diag(own)), np.sqrt(np.diag(common))
        normalised[n] = errors[n] @ np.linalg.solve(own, errors[n])
    return Fresh(
        poses,
        errors,
        _errors(Posor(plant.known, false_alarm=0.0), scans, poses)[0],
        sigmas,
        normalised,
        _errors(posor, still, poses)[0],
        still_sigmas,
    )


def _errors(posor: Posor, scans: Scans, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the errors at poses (n, 6), NaN where a POSOR gives no pose, and its rotations and translations."""
    found = posor.locate_each(scans, poses[:, 5])
    told = np.flatnonzero(found.states != int(State.LOST))
    errors = np.full(poses.shape, np.nan)
    off = natives_of(found.rotations[told], found.translations[told]) - poses[told]
    off[:, 5] = np.mod(off[:, 5] + np.pi, 2.0 * np.pi) - np.pi
    errors[told] = off
    return errors, found.rotations, found.translations
