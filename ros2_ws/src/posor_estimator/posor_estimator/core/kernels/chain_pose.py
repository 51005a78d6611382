"""Poses as messages have them, (7,): x, y, z [m], unit quaternion x, y, z, w; and as the chain multiplies them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import rotate, within

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

NOT_FINITE, NOT_UNIT, COVARIANCE_NOT_FINITE = 1, 2, 3
"""Why a joint's numbers must not be used; zero: they may."""
UNIT_WITHIN = 1e-6
"""How far from one the length of an orientation quaternion may be."""


@compiled
def fault_of(pose: FloatArray, covariance: FloatArray) -> int:
    """Return what is wrong with one joint's pose (7,) or covariance (6, 6), zero where nothing is."""
    for i in range(7):
        if not math.isfinite(pose[i]):
            return NOT_FINITE
    length = math.sqrt(pose[3] * pose[3] + pose[4] * pose[4] + pose[5] * pose[5] + pose[6] * pose[6])
    if abs(length - 1.0) > UNIT_WITHIN:
        return NOT_UNIT
    for i in range(6):
        for j in range(6):
            if not math.isfinite(covariance[i, j]):
                return COVARIANCE_NOT_FINITE
    return 0


@compiled
def rotation_of(pose: FloatArray, rotation: FloatArray) -> None:
    """Write the rotation (3, 3) of a pose (7,): x, y, z [m], quaternion x, y, z, w of any length but zero."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    rotation[0, 0] = 1.0 - scale * (y * y + z * z)
    rotation[0, 1] = scale * (x * y - w * z)
    rotation[0, 2] = scale * (x * z + w * y)
    rotation[1, 0] = scale * (x * y + w * z)
    rotation[1, 1] = 1.0 - scale * (x * x + z * z)
    rotation[1, 2] = scale * (y * z - w * x)
    rotation[2, 0] = scale * (x * z - w * y)
    rotation[2, 1] = scale * (y * z + w * x)
    rotation[2, 2] = 1.0 - scale * (x * x + y * y)


@compiled
def write_pose(rotation: FloatArray, translation: FloatArray, pose: FloatArray) -> None:
    """Write a transform as a pose (7,): x, y, z [m], unit quaternion x, y, z, w, its sign as pinocchio's."""
    for i in range(3):
        pose[i] = translation[i]
    trace = rotation[0, 0] + (rotation[1, 1] + rotation[2, 2])  # in the order of pinocchio's, to the last bit
    if trace > 0.0:
        root = math.sqrt(trace + 1.0)
        pose[6] = 0.5 * root
        root = 0.5 / root
        pose[3] = (rotation[2, 1] - rotation[1, 2]) * root
        pose[4] = (rotation[0, 2] - rotation[2, 0]) * root
        pose[5] = (rotation[1, 0] - rotation[0, 1]) * root
        return
    i = 0
    if rotation[1, 1] > rotation[0, 0]:
        i = 1
    if rotation[2, 2] > rotation[i, i]:
        i = 2
    j, k = (i + 1) % 3, (i + 2) % 3
    root = math.sqrt(rotation[i, i] - rotation[j, j] - rotation[k, k] + 1.0)
    pose[3 + i] = 0.5 * root
    root = 0.5 / root
    pose[6] = (rotation[k, j] - rotation[j, k]) * root
    pose[3 + j] = (rotation[j, i] + rotation[i, j]) * root
    pose[3 + k] = (rotation[k, i] + rotation[i, k]) * root


@compiled
def turn_on(rotation: FloatArray, further: FloatArray) -> None:
    """Replace ``rotation`` by ``rotation @ further``."""
    for i in range(3):
        a, b, c = within(rotation, i)
        for j in range(3):
            rotation[i, j] = a * further[0, j] + b * further[1, j] + c * further[2, j]


@compiled
def go_on(rotation: FloatArray, translation: FloatArray, further: FloatArray) -> None:
    """Replace a transform by its product with a fixed one, (4, 3): rotation, translation [m]."""
    step = rotate(rotation, within(further, 3))
    for i in range(3):
        translation[i] += step[i]
    turn_on(rotation, further)
