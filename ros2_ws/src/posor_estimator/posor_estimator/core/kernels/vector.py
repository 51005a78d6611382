"""Three-vectors and rotations for the kernels: plain loops, no temporaries beyond what is returned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@compiled
def dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product of two 3-vectors."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector product of two 3-vectors."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@compiled
def rotate(rotation: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``rotation @ a``."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[i, 0] * a[0] + rotation[i, 1] * a[1] + rotation[i, 2] * a[2]
    return out


@compiled
def rotate_back(rotation: FloatArray, a: FloatArray) -> FloatArray:
    """Return ``rotation.T @ a``."""
    out = np.empty(3)
    for i in range(3):
        out[i] = rotation[0, i] * a[0] + rotation[1, i] * a[1] + rotation[2, i] * a[2]
    return out


@compiled
def apply_tangent(rotation: FloatArray, translation: FloatArray, step: FloatArray) -> None:
    """Replace the pose by ``pose * exp6(step)`` in place.

    ``step`` is (v, w) in the axes of T. The same map as ``pinocchio.exp6`` (checked in the tests).
    """
    wx, wy, wz = step[3], step[4], step[5]
    angle_squared = wx * wx + wy * wy + wz * wz
    if angle_squared < 1e-8:  # noqa: PLR2004  series: the next terms are below 1e-18
        s = 1.0 - angle_squared / 6.0
        c = 0.5 - angle_squared / 24.0
        d = 1.0 / 6.0 - angle_squared / 120.0
    else:
        angle = math.sqrt(angle_squared)
        s = math.sin(angle) / angle
        c = (1.0 - math.cos(angle)) / angle_squared
        d = (1.0 - s) / angle_squared
    w = step[3:6]
    v = step[0:3]
    w_v = cross(w, v)
    w_w_v = cross(w, w_v)
    moved = np.empty(3)
    for i in range(3):
        moved[i] = v[i] + c * w_v[i] + d * w_w_v[i]
    shift = rotate(rotation, moved)
    for i in range(3):
        translation[i] += shift[i]
    turn = np.empty((3, 3))
    turn[0, 0] = 1.0 - c * (wy * wy + wz * wz)
    turn[0, 1] = c * wx * wy - s * wz
    turn[0, 2] = c * wx * wz + s * wy
    turn[1, 0] = c * wx * wy + s * wz
    turn[1, 1] = 1.0 - c * (wx * wx + wz * wz)
    turn[1, 2] = c * wy * wz - s * wx
    turn[2, 0] = c * wx * wz - s * wy
    turn[2, 1] = c * wy * wz + s * wx
    turn[2, 2] = 1.0 - c * (wx * wx + wy * wy)
    row = np.empty(3)
    for i in range(3):
        for j in range(3):
            row[j] = rotation[i, 0] * turn[0, j] + rotation[i, 1] * turn[1, j] + rotation[i, 2] * turn[2, j]
        for j in range(3):
            rotation[i, j] = row[j]


@compiled
def orthonormalise(rotation: FloatArray) -> None:
    """Remove the rounding that many small turns leave: one Newton step toward the nearest rotation, in place."""
    error = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            e = rotation[0, i] * rotation[0, j] + rotation[1, i] * rotation[1, j] + rotation[2, i] * rotation[2, j]
            error[i, j] = 0.5 * ((1.0 if i == j else 0.0) - e)
    row = np.empty(3)
    for i in range(3):
        for j in range(3):
            row[j] = rotation[i, 0] * error[0, j] + rotation[i, 1] * error[1, j] + rotation[i, 2] * error[2, j]
        for j in range(3):
            rotation[i, j] += row[j]
