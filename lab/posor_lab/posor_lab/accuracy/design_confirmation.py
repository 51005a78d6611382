"""Simulation of a POSOR that ``posor design posor`` wrote: are its errors those that the requirement allows?

Each draw is another POSOR: its parameters deviate from the written calibration as much as that states, its pose is
uniform over the required range, its readings have noise. The estimator knows the calibration only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor
from posor.model.native_coordinates import native_from_rotation, native_jacobian
from posor.numerics.vector import wrapped_angles
from posor_design.layout_evaluation import random_poses
from posor_design.posor_output import ARM_FILE, JOINT, REQUIREMENT
from posor_design.requirement import FREEDOMS, load_requirement

from posor_lab.accuracy.consistency import FALSE_ALARM, DrawnPosors, Nees, normalised
from posor_lab.harness.random_poses import errors_in_parent

if TYPE_CHECKING:
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

BAND = 0.99  # probability that the mean normalised error of a consistent estimator is in its band


@dataclass(frozen=True)
class DesignConfirmation:
    """Errors of drawn POSORs."""

    required: dict[str, float]  # largest standard uncertainty of each freedom [m, rad]
    errors: dict[str, float]  # root mean square of the errors over all draws
    stated: dict[str, float]  # root mean square of the standard uncertainties that the estimator stated
    nees: Nees  # normalised errors with the total covariance
    draws: int  # number of draws
    lost: int  # draws without a pose

    @property
    def within(self) -> bool:
        """Whether no error is larger than required."""
        return all(self.errors[name] <= self.required[name] for name in FREEDOMS)

    @property
    def consistent(self) -> bool:
        """Whether the errors agree with the stated covariances."""
        return self.nees.low <= self.nees.mean <= self.nees.high

    @property
    def confirmed(self) -> bool:
        """Whether the simulation confirms the requirement."""
        return self.within and self.consistent and self.lost == 0


def confirm_design(folder: Path, draws: int, seed: int) -> DesignConfirmation:
    """Simulate the POSOR in a folder of ``posor design posor``.

    Raises:
        CalibrationError: A file of the folder is missing or invalid.
        ChainError: Its URDF is invalid.

    """
    requirement, arm = load_requirement(folder / REQUIREMENT), load_arm_file(folder / ARM_FILE)
    gap = float(arm.chain().nominal_joint(JOINT, 0.0).translation[2])
    random = np.random.default_rng(seed)
    posor = Posor(arm.calibration(JOINT), false_alarm=FALSE_ALARM)
    posors = DrawnPosors(posor, random)
    poses = random_poses(requirement, gap, draws, random)
    rotations, translations, thetas = poses.rotations, poses.translations, poses.thetas
    errors, native = np.empty((draws, len(FREEDOMS))), np.empty((draws, len(FREEDOMS)))
    covariances, known = np.empty((draws, 6, 6)), np.zeros(draws, dtype=bool)
    variances = np.empty((draws, len(FREEDOMS)))
    for n in range(draws):
        rotation, translation = rotations[n : n + 1], translations[n : n + 1]
        found = posor.estimate_each(posors.scan(rotation, translation, random), thetas[n : n + 1])
        known[n] = np.isfinite(found.thetas[0])
        if not known[n]:
            continue
        errors[n] = errors_in_parent(found.rotations, found.translations, rotation, translation)[0]
        covariances[n] = found.covariances_random[0] + found.covariances_systematic[0]
        turned = np.subtract(native_from_rotation(found.rotations[0]), native_from_rotation(rotation[0]))
        native[n] = *(found.translations[0] - translation[0]), *wrapped_angles(turned)
        jacobian = native_jacobian(rotation[0])
        turns = jacobian @ covariances[n, 3:, 3:] @ jacobian.T
        variances[n] = *np.diagonal(covariances[n])[:3], *np.diagonal(turns)

    def by_freedom(values: FloatArray) -> dict[str, float]:
        return dict(zip(FREEDOMS, map(float, values), strict=True))

    return DesignConfirmation(
        required=by_freedom(requirement.sigmas),
        errors=by_freedom(np.sqrt(np.mean(np.square(native[known]), axis=0))),
        stated=by_freedom(np.sqrt(np.mean(variances[known], axis=0))),
        nees=normalised(errors[known], covariances[known], BAND),
        draws=draws,
        lost=int(np.sum(~known)),
    )


def design_rows(confirmation: DesignConfirmation) -> list[tuple[str, ...]]:
    """Return a row for each freedom: required, error, stated, error over required."""
    required, errors, stated = confirmation.required, confirmation.errors, confirmation.stated
    return [
        (name, *(f"{each[name]:.3e}" for each in (required, errors, stated)), f"{errors[name] / required[name]:.2f}")
        for name in FREEDOMS
    ]


def design_verdict(confirmation: DesignConfirmation) -> str:
    """Return the result in words."""
    nees = confirmation.nees
    errors = "All errors are within" if confirmation.within else "An error exceeds"
    agree = "agree with" if confirmation.consistent else "differ from"
    return (
        f"{errors} the requirement. NEES / 6 {nees.mean:.4f}, {100 * BAND:.0f} % band [{nees.low:.4f}, {nees.high:.4f}]"
        f": errors {agree} the stated covariances. {confirmation.lost} of {confirmation.draws} draws gave no pose."
    )
