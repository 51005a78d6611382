"""Poses as messages have them, (7,): x, y, z [m], unit quaternion x, y, z, w; and as the chain multiplies them."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined

if TYPE_CHECKING:
    from posor_estimator.core.kernels.matrix import Matrix
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

NOT_FINITE, NOT_UNIT, COVARIANCE_NOT_FINITE = 1, 2, 3
"""Why a joint's numbers must not be used; zero: they may."""
LARGEST = sys.float_info.max
UNIT_WITHIN = 1e-6
"""How far from one the length of an orientation quaternion may be."""


@inlined
def fault_of(pose: FloatArray, covariance: FloatArray) -> int:
    """Return what is wrong with one joint's pose (7,) or covariance (6, 6), zero where nothing is."""
    for i in range(7):
        if not math.isfinite(pose[i]):
            return NOT_FINITE
    length = math.sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6])
    if abs(length - 1.0) > UNIT_WITHIN:
        return NOT_UNIT
    finite = True
    for i in range(6):
        for j in range(6):
            finite &= abs(covariance[i, j]) <= LARGEST  # no way out of the loop, so that it takes several at a time
    return 0 if finite else COVARIANCE_NOT_FINITE


@inlined
def rotation_of(pose: FloatArray) -> Matrix:
    """Return the rotation of a pose (7,): x, y, z [m], quaternion x, y, z, w of any length but zero."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )


@inlined
def write_pose(rotation: Matrix, translation: Vector, pose: FloatArray) -> None:
    """Write a transform as a pose (7,): x, y, z [m], unit quaternion x, y, z, w, its sign as pinocchio's."""
    for i in range(3):
        pose[i] = translation[i]
    trace = rotation[0][0] + (rotation[1][1] + rotation[2][2])  # in the order of pinocchio's, to the last bit
    if trace > 0.0:
        root = math.sqrt(trace + 1.0)
        pose[6] = 0.5 * root
        root = 0.5 / root
        pose[3] = (rotation[2][1] - rotation[1][2]) * root
        pose[4] = (rotation[0][2] - rotation[2][0]) * root
        pose[5] = (rotation[1][0] - rotation[0][1]) * root
        return
    i = 0
    if rotation[1][1] > rotation[0][0]:
        i = 1
    if rotation[2][2] > rotation[i][i]:
        i = 2
    j, k = (i + 1) % 3, (i + 2) % 3
    root = math.sqrt(rotation[i][i] - rotation[j][j] - rotation[k][k] + 1.0)
    pose[3 + i] = 0.5 * root
    root = 0.5 / root
    pose[6] = (rotation[k][j] - rotation[j][k]) * root
    pose[3 + j] = (rotation[j][i] + rotation[i][j]) * root
    pose[3 + k] = (rotation[k][i] + rotation[i][k]) * root
