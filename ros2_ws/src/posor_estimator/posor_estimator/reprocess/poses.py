"""Poses and native coordinates of many estimates, as messages have them, compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.chain_pose import write_pose

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@compiled
def write_poses(
    rotations: FloatArray, translations: FloatArray, thetas: FloatArray, poses: FloatArray, natives: FloatArray
) -> None:
    """Write poses and native coordinates (``core.native``).

    Args:
        rotations: Shape (n, 3, 3).
        translations: [m], shape (n, 3).
        thetas: Large rotations, turns counted [rad], shape (n,).
        poses: x, y, z [m] and the unit quaternion x, y, z, w, to write, shape (n, 7).
        natives: x, y, gap [m], alpha, beta, theta [rad], to write, shape (n, 6).

    """
    for n in range(rotations.shape[0]):
        rotation = rotations[n]
        write_pose(rotation, translations[n], poses[n])
        for i in range(3):
            natives[n, i] = translations[n, i]
        natives[n, 3] = math.asin(max(-1.0, min(1.0, -rotation[1, 2])))
        natives[n, 4] = math.atan2(rotation[0, 2], rotation[2, 2])
        natives[n, 5] = thetas[n]
