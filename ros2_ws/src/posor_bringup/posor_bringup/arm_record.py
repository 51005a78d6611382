"""What was received of an arm over a number of ticks: truth, POSOR endpoint, encoders; and the errors that follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.poses import Poses
from posor_estimator.accuracy.consistency import FREEDOMS, normalised_squares
from posor_estimator.accuracy.poses import errors_in_parent
from scipy.stats import chi2

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin
    from numpy.typing import NDArray
    from posor_estimator.core.types import FloatArray

REGION = 0.95
REGION_LIMIT = float(chi2.ppf(REGION, FREEDOMS))
"""Largest normalised error squared inside the published 95 % region of a pose."""
CHAIN, TRUTH = "chain", "truth"
"""Who may be the reason that there is no pose, beside the joints."""
NO_SCAN = "sent no scan"
GIVEN_UP = "given up by the chain, a transform came too late"
UNKNOWN = np.full((3, 3), np.nan), np.full(3, np.nan)


@dataclass(frozen=True)
class ArmRecord:
    """n successive ticks of an arm; NaN where something did not come.

    Attributes:
        ticks: Their numbers.
        times_s: Time of each tick since the first [s], (n,).
        truth: Where the endpoint was, in the base.
        posor: Where the POSORs said it was.
        covariances: Published with it, (n, 6, 6), ROS order.
        encoders: Where the encoders alone put it, by the nominal kinematics.
        target: Where it was commanded to be.
        stage: Position of the micromanipulator stage [m], (n, 3), axes of the endpoint.
        reasons: Of each tick why there is no pose, by joint, ``CHAIN`` or ``TRUTH``; empty where there is one.

    """

    ticks: range
    times_s: FloatArray
    truth: Poses
    posor: Poses
    covariances: FloatArray
    encoders: Poses
    target: Poses
    stage: FloatArray
    reasons: tuple[Mapping[str, str], ...]

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.times_s)

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """Whether the POSORs gave a pose, and the truth is known, (n,)."""
        return np.isfinite(self.posor.translations[:, 0]) & np.isfinite(self.truth.translations[:, 0])

    @property
    def complete(self) -> bool:
        """Whether nothing is missing, the stage apart, which not every arm has."""
        return not any(self.reasons) and bool(
            np.isfinite(self.encoders.translations).all() and np.isfinite(self.target.translations).all()
        )

    @cached_property
    def posor_errors(self) -> FloatArray:
        """POSOR minus truth, (n, 6), ROS order: x, y, z [m], about X, Y, Z [rad], axes of the base."""
        return errors(self.posor, self.truth)

    @cached_property
    def encoder_errors(self) -> FloatArray:
        """Encoders alone minus truth, as ``posor_errors``."""
        return errors(self.encoders, self.truth)

    @cached_property
    def normalised(self) -> FloatArray:
        """Normalised error squared of the POSOR pose with its published covariance, (n,)."""
        out = np.full(len(self), np.nan)
        known = self.has_pose
        out[known] = normalised_squares(self.posor_errors[known], self.covariances[known])
        return out

    @property
    def inside(self) -> float:
        """The part of the poses that lies inside the published 95 % region; NaN without any pose."""
        known = self.has_pose
        return float(np.mean(self.normalised[known] <= REGION_LIMIT)) if known.any() else float("nan")

    @cached_property
    def off_target(self) -> FloatArray:
        """Distance of the true endpoint to where it was commanded to be [m], (n,)."""
        return np.asarray(np.linalg.norm(self.truth.translations - self.target.translations, axis=1))


def errors(found: Poses, true: Poses) -> FloatArray:
    """Return errors of poses in ROS order, (n, 6); NaN where one of both is unknown."""
    out = np.full((len(found), 6), np.nan)
    known = np.isfinite(found.translations[:, 0]) & np.isfinite(true.translations[:, 0])
    if known.any():
        out[known] = errors_in_parent(
            found.rotations[known], found.translations[known], true.rotations[known], true.translations[known]
        )
    return out


def poses_of(poses: Sequence[pin.SE3 | None]) -> Poses:
    """Return poses as arrays, NaN for None."""
    parts = [UNKNOWN if pose is None else (pose.rotation, pose.translation) for pose in poses]
    return Poses(np.array([rotation for rotation, _ in parts]), np.array([translation for _, translation in parts]))


def rms(values: FloatArray) -> float:
    """Return the root of the mean square of the known values, or of the lengths of known vectors (n, 3)."""
    lengths = np.linalg.norm(values, axis=1) if values.ndim > 1 else values
    known = lengths[np.isfinite(lengths)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else float("nan")
