# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The six native coordinates of a POSOR: (x, y, gap, alpha, beta, theta).

``x, y, gap`` are the origin of T in R [m]. Alpha and beta are the lean of the target's own Z axis, about X and Y of R:
``Z_T = Ry(beta) Rx(alpha) Z``. Theta, the large rotation, is the heading of the target's Y axis in the XY plane of R.
In these coordinates a pure alpha or beta is what the gap probes read as a slope, and theta is what the spots read,
without cross terms of first order, whatever theta is (thesis 5.3.1, 5.4.1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor.numerics.vector import theta_of

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray


def rotation_from_native(alpha: float, beta: float, theta: float) -> FloatArray:
    """Return ``R_R_T`` whose Z axis leans by alpha, beta and whose Y axis heads along theta [rad], shape (3, 3)."""
    z = np.array([math.sin(beta) * math.cos(alpha), -math.sin(alpha), math.cos(beta) * math.cos(alpha)])
    heading = np.array([-math.sin(theta), math.cos(theta)])
    y = np.array([heading[0], heading[1], -(heading @ z[:2]) / z[2]])
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])


def native_from_rotation(rotation: FloatArray) -> tuple[float, float, float]:
    """Return (alpha, beta, theta) [rad] of ``R_R_T``; theta in (-pi, pi], leans below a right angle."""
    alpha = math.asin(max(-1.0, min(1.0, -rotation[1, 2])))
    beta = math.atan2(rotation[0, 2], rotation[2, 2])
    return alpha, beta, theta_of(rotation)


def native_jacobian(rotation: FloatArray) -> FloatArray:
    """Return d(alpha, beta, theta)/d(small turn about X, Y, Z of R) at ``R_R_T``, shape (3, 3)."""
    y, z = rotation[:, 1], rotation[:, 2]
    # A small turn w moves the axes y and z of T by w x y and w x z.
    moved_y, moved_z = -_cross_matrix(y), -_cross_matrix(z)
    return np.array(
        [
            -moved_z[1] / math.sqrt(1.0 - z[1] ** 2),
            (z[2] * moved_z[0] - z[0] * moved_z[2]) / (z[0] ** 2 + z[2] ** 2),
            (y[0] * moved_y[1] - y[1] * moved_y[0]) / (y[0] ** 2 + y[1] ** 2),
        ]
    )


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrix that multiplies from the left as ``vector x`` does."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
