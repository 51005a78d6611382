"""Record of an arm over a number of ticks: truth, endpoint by POSORs and by encoders, and their errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.accuracy.consistency import REGION_LIMIT, normalised_squares
from posor_lab.harness.random_poses import errors_in_parent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin
    from numpy.typing import NDArray
    from posor.numerics.array_types import FloatArray

CHAIN, TRUTH = "chain", "truth"
"""Keys of ``ArmRecord.reasons`` beside the joints."""
NO_SCAN = "sent no scan"
GIVEN_UP = "given up by the chain, a transform came too late"
UNKNOWN = np.full((3, 3), np.nan), np.full(3, np.nan)


@dataclass(frozen=True)
class ArmRecord:
    """n successive ticks of an arm; NaN where nothing was received."""

    ticks: range  # numbers of the ticks
    times_s: FloatArray  # times since the first tick [s], (n,)
    truth: PoseArray  # true poses of the endpoint in the base
    posor: PoseArray  # poses of the endpoint by the POSORs
    covariances: FloatArray  # covariances published with them, (n, 6, 6), ROS order
    encoders: PoseArray  # poses of the endpoint by the encoders and nominal kinematics
    target: PoseArray  # commanded poses of the endpoint
    stage: FloatArray  # position of the micromanipulator stage [m], (n, 3), axes of the endpoint
    reasons: tuple[Mapping[str, str], ...]  # for each tick without a pose the reasons, by joint, ``CHAIN`` or ``TRUTH``

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.times_s)

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """Whether both the POSORs' pose and the truth are known, (n,)."""
        return np.isfinite(self.posor.translations[:, 0]) & np.isfinite(self.truth.translations[:, 0])

    @property
    def is_complete(self) -> bool:
        """Whether everything was received; the stage is optional."""
        return not any(self.reasons) and bool(
            np.isfinite(self.encoders.translations).all() and np.isfinite(self.target.translations).all()
        )

    @cached_property
    def posor_errors(self) -> FloatArray:
        """POSORs minus truth, (n, 6), ROS order: x, y, z [m], about X, Y, Z [rad], axes of the base."""
        return pose_errors(self.posor, self.truth)

    @cached_property
    def encoder_errors(self) -> FloatArray:
        """Encoders minus truth, as ``posor_errors``."""
        return pose_errors(self.encoders, self.truth)

    @cached_property
    def normalised(self) -> FloatArray:
        """Normalised error squared of the POSORs' pose with its published covariance, (n,)."""
        out = np.full(len(self), np.nan)
        known = self.has_pose
        out[known] = normalised_squares(self.posor_errors[known], self.covariances[known])
        return out

    @property
    def inside(self) -> float:
        """Share of the poses inside their published 95 % region; NaN without poses."""
        known = self.has_pose
        return float(np.mean(self.normalised[known] <= REGION_LIMIT)) if known.any() else float("nan")

    @cached_property
    def target_distances(self) -> FloatArray:
        """Distance of the true endpoint from its target [m], (n,)."""
        return np.asarray(np.linalg.norm(self.truth.translations - self.target.translations, axis=1))


def pose_errors(found: PoseArray, true: PoseArray) -> FloatArray:
    """Return errors of poses in ROS order, (n, 6); NaN where a pose is unknown."""
    out = np.full((len(found), 6), np.nan)
    known = np.isfinite(found.translations[:, 0]) & np.isfinite(true.translations[:, 0])
    if known.any():
        out[known] = errors_in_parent(
            found.rotations[known], found.translations[known], true.rotations[known], true.translations[known]
        )
    return out


def pose_array(poses: Sequence[pin.SE3 | None]) -> PoseArray:
    """Return poses as arrays, NaN for None."""
    parts = [UNKNOWN if pose is None else (pose.rotation, pose.translation) for pose in poses]
    return PoseArray(*map(np.array, zip(*parts, strict=True)))


def rms(values: FloatArray) -> float:
    """Return the root mean square of the known values (n,), or of the lengths of known vectors (n, 3)."""
    lengths = np.linalg.norm(values, axis=1) if values.ndim > 1 else values
    known = lengths[np.isfinite(lengths)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else float("nan")
