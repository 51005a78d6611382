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
from posor_estimator.core.kernels.vector import at, cross, dot, minus, plus, rotate, rotate_back, times

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

FIXED_PARAMETERS = 8
PER_HARMONIC = 3

_NEWTON_STEPS = 30
_SETTLED_M = 1e-15


@compiled
def radius_and_slope(row: FloatArray, phi: float) -> tuple[float, float]:
    """Return r(phi) [m] and dr/dphi [m/rad]."""
    radius = row[6]
    slope = 0.0
    for h in range(int(row[7])):
        k = row[8 + 3 * h]
        c, s = math.cos(k * phi), math.sin(k * phi)
        radius += row[9 + 3 * h] * c + row[10 + 3 * h] * s
        slope += k * (row[10 + 3 * h] * c - row[9 + 3 * h] * s)
    return radius, slope


@compiled
def _meet(tip: Vector, axis: Vector, row: FloatArray) -> tuple[float, Vector]:
    """Return the distance [m] from the tip to the surface, and the surface's gradient there; all in T.

    The start is where the probe would meet the mean circle; NaN where it does not look at the ring.
    """
    a = axis[0] * axis[0] + axis[1] * axis[1]
    b = tip[0] * axis[0] + tip[1] * axis[1]
    c = tip[0] * tip[0] + tip[1] * tip[1] - row[6] * row[6]
    discriminant = b * b - a * c
    reading = (-b - math.sqrt(discriminant)) / a if discriminant > 0.0 and a > 0.0 else math.nan
    normal = (1.0, 0.0, 0.0)
    for _ in range(_NEWTON_STEPS):
        x = tip[0] + reading * axis[0]
        y = tip[1] + reading * axis[1]
        distance = math.sqrt(x * x + y * y)
        radius, slope = radius_and_slope(row, math.atan2(y, x))
        normal = ((x + slope * y / distance) / distance, (y - slope * x / distance) / distance, 0.0)
        step = (radius - distance) / dot(normal, axis)
        reading += step
        if not abs(step) > _SETTLED_M:
            break
    return reading, normal


@compiled
def ring_gap(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into ``jacobian`` (6)."""
    tip = rotate_back(rotation, minus(at(row, 0), at(translation, 0)))
    axis = rotate_back(rotation, at(row, 3))
    reading, normal = _meet(tip, axis, row)
    slant = dot(normal, axis)
    lever = cross(plus(tip, times(reading, axis)), normal)
    for i in range(3):
        jacobian[i] = normal[i] / slant
        jacobian[3 + i] = lever[i] / slant
    return reading


@compiled
def ring_parameters(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> None:
    """Write the derivative of the gap with respect to the row's parameters into ``jacobian`` (8 + 3 H).

    The number of harmonics and each k are whole numbers: their derivatives are zero.
    """
    tip = rotate_back(rotation, minus(at(row, 0), at(translation, 0)))
    axis = rotate_back(rotation, at(row, 3))
    reading, normal = _meet(tip, axis, row)
    slant = dot(normal, axis)
    normal_R = rotate(rotation, normal)
    for i in range(3):
        jacobian[i] = -normal_R[i] / slant
        jacobian[3 + i] = -reading * normal_R[i] / slant
    jacobian[6] = 1.0 / slant
    jacobian[7] = 0.0
    phi = math.atan2(tip[1] + reading * axis[1], tip[0] + reading * axis[0])
    for h in range(int(row[7])):
        k = row[8 + 3 * h]
        jacobian[8 + 3 * h] = 0.0
        jacobian[9 + 3 * h] = math.cos(k * phi) / slant
        jacobian[10 + 3 * h] = math.sin(k * phi) / slant
