"""Ring probe: distance along the probe's axis to the bumpy ring around the target.

The surface is fixed in T, the same at every z: its radius at the azimuth phi is ``r(phi) = r0 + sum_k (C_k cos(k phi) +
S_k sin(k phi))``, k any whole numbers: the bump profile, its form errors and the ring's eccentricity alike. With the
tip ``o`` and the axis ``a`` seen from T, the reading is the first g at which ``|xy(o + g a)| = r(phi(o + g a))``.

Row parameters (8 + 3 H): tip in R [m] 0:3, axis in R 3:6, r0 [m] 6, number of harmonics H 7, then for each harmonic
its k, C_k [m], S_k [m]. Prepared (1): the gap at the pose before, the start from which the parameters' derivatives find
it again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place
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


@in_place
def turned_times(c: float, s: float, k: int) -> tuple[float, float]:
    """Return cosine and sine of k times the angle that has these, k zero or more.

    By squaring: the rounding is that of an angle multiplied by k, the cost a third.
    """
    cosine, sine = 1.0, 0.0
    while k > 0:
        if k % 2 == 1:
            cosine, sine = cosine * c - sine * s, cosine * s + sine * c
        c, s = c * c - s * s, 2.0 * c * s
        k //= 2
    return cosine, sine


@in_place
def radius_and_slope(rows: FloatArray, r: int, cosine: float, sine: float) -> tuple[float, float]:
    """Return r(phi) [m] and dr/dphi [m/rad] of row r, by cosine and sine of phi."""
    radius = rows[r, 6]
    slope = 0.0
    for h in range(int(rows[r, 7])):
        k = rows[r, 8 + 3 * h]
        c, s = turned_times(cosine, sine, int(k))
        radius += rows[r, 9 + 3 * h] * c + rows[r, 10 + 3 * h] * s
        slope += k * (rows[r, 10 + 3 * h] * c - rows[r, 9 + 3 * h] * s)
    return radius, slope


@in_place
def _meet(tip: Vector, axis: Vector, rows: FloatArray, r: int, start: float) -> tuple[float, Vector]:
    """Return the distance [m] from the tip to the surface, and the surface's gradient there; all in T.

    Where ``start`` is no number, the start is where the probe would meet the mean circle; NaN where it does not look at
    the ring.
    """
    reading, normal = start, (1.0, 0.0, 0.0)
    if not math.isfinite(start):
        reading = _to_circle(tip, axis, rows[r, 6])
    for _ in range(_NEWTON_STEPS):
        x = tip[0] + reading * axis[0]
        y = tip[1] + reading * axis[1]
        distance = math.sqrt(x * x + y * y)
        cosine, sine = x / distance, y / distance
        radius, slope = radius_and_slope(rows, r, cosine, sine)
        normal = ((x + slope * sine) / distance, (y - slope * cosine) / distance, 0.0)
        step = (radius - distance) / dot(normal, axis)
        reading += step
        if not abs(step) > _SETTLED_M:
            break
    return reading, normal


@in_place
def _to_circle(tip: Vector, axis: Vector, radius: float) -> float:
    """Return the distance [m] from the tip to a circle, NaN where the probe does not look at it."""
    a = axis[0] * axis[0] + axis[1] * axis[1]
    b = tip[0] * axis[0] + tip[1] * axis[1]
    c = tip[0] * tip[0] + tip[1] * tip[1] - radius * radius
    discriminant = b * b - a * c
    return (-b - math.sqrt(discriminant)) / a if discriminant > 0.0 and a > 0.0 else math.nan


@in_place
def prepare_ring(r: int, prepared: FloatArray) -> None:
    """Write into row r of ``prepared`` (m, 1 or more) that the probe has not met the surface yet."""
    prepared[r, 0] = math.nan


@in_place
def ring_gap(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Return the gap [m] of row r and write its derivative with respect to the local tangent into that of ``jacobian``.

    Shapes: rows (m, 8 + 3 H or more), prepared (m, 1 or more), jacobian (m, 6). The gap is kept in ``prepared`` for
    ``ring_parameters`` at the same pose.
    """
    tip = rotate_back(rotation, minus(within(rows, r, 0), at(translation, 0)))
    axis = rotate_back(rotation, within(rows, r, 3))
    reading, normal = _meet(tip, axis, rows, r, math.nan)
    prepared[r, 0] = reading
    slant = dot(normal, axis)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(plus(tip, times(reading, axis)), normal), slant))
    return reading


@in_place
def ring_parameters(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write the derivative of the gap of row r with respect to its parameters into that of ``jacobian`` (m, 8 + 3 H+).

    The number of harmonics and each k are whole numbers: their derivatives are zero.
    """
    tip = rotate_back(rotation, minus(within(rows, r, 0), at(translation, 0)))
    axis = rotate_back(rotation, within(rows, r, 3))
    reading, normal = _meet(tip, axis, rows, r, prepared[r, 0])
    slant = dot(normal, axis)
    normal_R = rotate(rotation, normal)
    put(jacobian, r, 0, over(times(-1.0, normal_R), slant))
    put(jacobian, r, 3, over(times(-reading, normal_R), slant))
    jacobian[r, 6] = 1.0 / slant
    jacobian[r, 7] = 0.0
    x, y = tip[0] + reading * axis[0], tip[1] + reading * axis[1]
    distance = math.sqrt(x * x + y * y)
    for h in range(int(rows[r, 7])):
        cosine, sine = turned_times(x / distance, y / distance, int(rows[r, 8 + 3 * h]))
        jacobian[r, 8 + 3 * h] = 0.0
        jacobian[r, 9 + 3 * h] = cosine / slant
        jacobian[r, 10 + 3 * h] = sine / slant
