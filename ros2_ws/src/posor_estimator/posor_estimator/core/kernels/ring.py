"""Ring probe: distance along the probe's axis to the bumpy ring around the target.

The surface is fixed in T, the same at every z: its radius at the azimuth phi is ``r(phi) = r0 + sum_k (C_k cos(k phi) +
S_k sin(k phi))``, k any whole numbers: the bump profile, its form errors and the ring's eccentricity alike. With the
tip ``o`` and the axis ``a`` seen from T, the reading is the first g at which ``|xy(o + g a)| = r(phi(o + g a))``.

Row parameters (8 + 3 H): tip in R [m] 0:3, axis in R 3:6, r0 [m] 6, number of harmonics H 7, then for each harmonic
its k, C_k [m], S_k [m].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import (
    at,
    cross,
    dot,
    minus,
    over,
    plus,
    put,
    rotate,
    rotate_back,
    times,
    within,
)

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

FIXED_PARAMETERS = 8
PER_HARMONIC = 3

_NEWTON_STEPS = 30
_SETTLED_M = 1e-15


@compiled
def radius_and_slope(rows: FloatArray, r: int, phi: float) -> tuple[float, float]:
    """Return r(phi) [m] and dr/dphi [m/rad] of row r."""
    radius = rows[r, 6]
    slope = 0.0
    for h in range(int(rows[r, 7])):
        k = rows[r, 8 + 3 * h]
        c, s = math.cos(k * phi), math.sin(k * phi)
        radius += rows[r, 9 + 3 * h] * c + rows[r, 10 + 3 * h] * s
        slope += k * (rows[r, 10 + 3 * h] * c - rows[r, 9 + 3 * h] * s)
    return radius, slope


@compiled
def _meet(tip: Vector, axis: Vector, rows: FloatArray, r: int) -> tuple[float, Vector]:
    """Return the distance [m] from the tip to the surface, and the surface's gradient there; all in T.

    The start is where the probe would meet the mean circle; NaN where it does not look at the ring.
    """
    a = axis[0] * axis[0] + axis[1] * axis[1]
    b = tip[0] * axis[0] + tip[1] * axis[1]
    c = tip[0] * tip[0] + tip[1] * tip[1] - rows[r, 6] * rows[r, 6]
    discriminant = b * b - a * c
    reading = (-b - math.sqrt(discriminant)) / a if discriminant > 0.0 and a > 0.0 else math.nan
    normal = (1.0, 0.0, 0.0)
    for _ in range(_NEWTON_STEPS):
        x = tip[0] + reading * axis[0]
        y = tip[1] + reading * axis[1]
        distance = math.sqrt(x * x + y * y)
        radius, slope = radius_and_slope(rows, r, math.atan2(y, x))
        normal = ((x + slope * y / distance) / distance, (y - slope * x / distance) / distance, 0.0)
        step = (radius - distance) / dot(normal, axis)
        reading += step
        if not abs(step) > _SETTLED_M:
            break
    return reading, normal


@compiled
def ring_gap(rows: FloatArray, r: int, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> float:
    """Return the gap [m] of row r and write its derivative with respect to the local tangent into that of ``jacobian``.

    Shapes: rows (m, 8 + 3 H or more), jacobian (m, 6).
    """
    tip = rotate_back(rotation, minus(within(rows, r, 0), at(translation, 0)))
    axis = rotate_back(rotation, within(rows, r, 3))
    reading, normal = _meet(tip, axis, rows, r)
    slant = dot(normal, axis)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(plus(tip, times(reading, axis)), normal), slant))
    return reading


@compiled
def ring_parameters(
    rows: FloatArray, r: int, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray
) -> None:
    """Write the derivative of the gap of row r with respect to its parameters into that of ``jacobian`` (m, 8 + 3 H+).

    The number of harmonics and each k are whole numbers: their derivatives are zero.
    """
    tip = rotate_back(rotation, minus(within(rows, r, 0), at(translation, 0)))
    axis = rotate_back(rotation, within(rows, r, 3))
    reading, normal = _meet(tip, axis, rows, r)
    slant = dot(normal, axis)
    normal_R = rotate(rotation, normal)
    put(jacobian, r, 0, over(times(-1.0, normal_R), slant))
    put(jacobian, r, 3, over(times(-reading, normal_R), slant))
    jacobian[r, 6] = 1.0 / slant
    jacobian[r, 7] = 0.0
    phi = math.atan2(tip[1] + reading * axis[1], tip[0] + reading * axis[0])
    for h in range(int(rows[r, 7])):
        k = rows[r, 8 + 3 * h]
        jacobian[r, 8 + 3 * h] = 0.0
        jacobian[r, 9 + 3 * h] = math.cos(k * phi) / slant
        jacobian[r, 10 + 3 * h] = math.sin(k * phi) / slant
