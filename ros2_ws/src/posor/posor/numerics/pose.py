"""Poses as messages hold them, (7,): x, y, z [m], quaternion x, y, z, w; to a rotation matrix and back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.numerics.compiled import inlined

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.matrix import Matrix
    from posor.numerics.vector import Vector


@inlined
def rotation_of_pose(pose: FloatArray) -> Matrix:
    """Return the rotation of a pose (7,), whose quaternion may have any length but zero."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    return (
        (1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)),
        (scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)),
        (scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)),
    )


@inlined
def write_pose(rotation: Matrix, translation: Vector, pose: FloatArray) -> None:
    """Write a transform as a pose (7,) with a unit quaternion, whose sign is that of ``pinocchio.SE3ToXYZQUAT``."""
    for i in range(3):
        pose[i] = translation[i]
    trace = rotation[0][0] + (rotation[1][1] + rotation[2][2])  # pinocchio's order of summation: same last bit
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
