# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Distance along the axis of a probe: to the target plane, or to the bumpy ring around the target.

Plane: thesis 5.3.1 (equation 5.3, exact here). With the tip ``o`` and the axis ``a`` seen from T, the plane through
``q`` with normal ``m`` is met at the distance ``g = m.(q - o) / (m.a)``. Row fields (``model.reading_rows``): ``tip``
and ``axis`` in R, ``plane_point`` in T [m], ``tilt`` of the plane about X and Y of T [rad], ``turn`` of the tilt about
Z of T [rad]. The normal toward the probes is ``Rz(turn) Rx(tilt 0) Ry(tilt 1) (0, 0, -1)``. The derivatives also hold
for an axis that is not of unit length.

Ring: the surface is fixed in T and the same at every z. Its radius at the azimuth phi is ``r(phi) = r0 + sum_k (C_k
cos(k phi) + S_k sin(k phi))`` with whole numbers k: bump profile, form errors and eccentricity of the ring. The
reading is the first g at which ``|xy(o + g a)| = r(phi(o + g a))``. Row fields: ``tip`` and ``axis`` in R,
``mean_radius`` r0 [m], ``harmonics`` (how many), ``orders`` k, ``cosines`` C_k and ``sines`` S_k [m]. ``ring_gap``
keeps where the axis meets the surface in the row: the next evaluation of the same scan starts there, and
``ring_parameters`` takes its derivatives from there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    at,
    cross,
    dot,
    minus,
    over,
    plus,
    put,
    rotate,
    rotate_back,
    rotated_about_z,
    store,
    times,
)

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector

MAX_HARMONICS = 32

_NEWTON_STEPS = 30
_TOLERANCE_M = 1e-15


@in_place
def plane_normal(tilt_x: float, tilt_y: float, turn: float) -> Vector:
    """Return the unit normal toward the probes, in T; angles [rad]."""
    normal = -math.sin(tilt_y), math.sin(tilt_x) * math.cos(tilt_y), -math.cos(tilt_x) * math.cos(tilt_y)
    return rotated_about_z(normal, turn)


@in_place
def prepare_gap(row: Any) -> None:
    """Write what does not depend on the pose: the normal in T and its derivatives with respect to the tilts."""
    sx, cx = math.sin(row.tilt[0]), math.cos(row.tilt[0])
    sy, cy = math.sin(row.tilt[1]), math.cos(row.tilt[1])
    store(row.normal, 0, plane_normal(row.tilt[0], row.tilt[1], row.turn))
    store(row.normal_by_tilt_x, 0, rotated_about_z((0.0, cx * cy, sx * cy), row.turn))
    store(row.normal_by_tilt_y, 0, rotated_about_z((-cy, -sx * sy, cx * sy), row.turn))


@in_place
def _meet_plane(row: Any, pose: Any) -> tuple[float, float, Vector]:
    """Return the gap [m], the slant ``m.a``, and the point in T where the axis meets the plane."""
    normal = at(row.normal, 0)
    tip = rotate_back(pose.rotation, minus(at(row.tip, 0), at(pose.translation, 0)))
    axis = rotate_back(pose.rotation, at(row.axis, 0))
    slant = dot(normal, axis)
    reading = dot(normal, minus(at(row.plane_point, 0), tip)) / slant
    return reading, slant, plus(tip, times(reading, axis))


@in_place
def gap(row: Any, pose: Any, jacobian: FloatArray, r: int) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into row r of ``jacobian``."""
    normal = at(row.normal, 0)
    reading, slant, point = _meet_plane(row, pose)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(point, normal), slant))
    return reading


@in_place
def gap_parameters(row: Any, pose: Any, derivatives: Any) -> None:
    """Write the derivatives of the gap with respect to the parameters of its row."""
    normal = at(row.normal, 0)
    reading, slant, point = _meet_plane(row, pose)
    normal_R = rotate(pose.rotation, normal)
    store(derivatives.tip, 0, over(times(-1.0, normal_R), slant))
    store(derivatives.axis, 0, over(times(-reading, normal_R), slant))
    store(derivatives.plane_point, 0, over(normal, slant))
    beyond = times(1.0 / slant, minus(at(row.plane_point, 0), point))
    derivatives.tilt[0] = dot(beyond, at(row.normal_by_tilt_x, 0))
    derivatives.tilt[1] = dot(beyond, at(row.normal_by_tilt_y, 0))
    derivatives.turn = beyond[1] * normal[0] - beyond[0] * normal[1]


@in_place
def multiple_angle(cosine: float, sine: float, k: int) -> tuple[float, float]:
    """Return cosine and sine of k times an angle given by its cosine and sine, k zero or more.

    By repeated squaring: the rounding is that of an angle multiplied by k, the cost a third.
    """
    c, s = 1.0, 0.0
    while k > 0:
        if k % 2 == 1:
            c, s = c * cosine - s * sine, c * sine + s * cosine
        cosine, sine = cosine * cosine - sine * sine, 2.0 * cosine * sine
        k //= 2
    return c, s


@in_place
def radius_and_slope(row: Any, cosine: float, sine: float) -> tuple[float, float]:
    """Return r(phi) [m] and dr/dphi [m/rad], by cosine and sine of phi; keep those of each k phi in the row."""
    radius = row.mean_radius
    slope = 0.0
    k, c, s = 0.0, 1.0, 0.0
    step, step_c, step_s = 0.0, 1.0, 0.0
    for h in range(int(row.harmonics)):
        # From the previous order on: each further harmonic of the bumps takes one product.
        difference = row.orders[h] - k
        if difference == k:
            step_c, step_s = c, s
        elif difference != step:
            step_c, step_s = multiple_angle(cosine, sine, int(abs(difference)))
            step_s = math.copysign(step_s, step_s * difference)
        k, step = row.orders[h], difference
        c, s = c * step_c - s * step_s, c * step_s + s * step_c
        row.multiple_cosines[h], row.multiple_sines[h] = c, s
        radius += row.cosines[h] * c + row.sines[h] * s
        slope += k * (row.sines[h] * c - row.cosines[h] * s)
    return radius, slope


@in_place
def _meet_ring(tip: Vector, axis: Vector, row: Any) -> None:
    """Write the distance [m] from the tip to the surface, and the gradient of the surface there, into the row.

    All in T. The search starts at the distance found before in the same scan, or at the mean circle. The distance is
    NaN where the probe misses the ring.
    """
    reading, normal = row.gap, (1.0, 0.0, 0.0)
    if not math.isfinite(reading):
        reading = _distance_to_circle(tip, axis, row.mean_radius)
    for _ in range(_NEWTON_STEPS):
        x = tip[0] + reading * axis[0]
        y = tip[1] + reading * axis[1]
        distance = math.sqrt(x * x + y * y)
        cosine, sine = x / distance, y / distance
        radius, slope = radius_and_slope(row, cosine, sine)
        normal = ((x + slope * sine) / distance, (y - slope * cosine) / distance, 0.0)
        step = (radius - distance) / dot(normal, axis)
        reading += step
        if not abs(step) > _TOLERANCE_M:
            break
    row.gap = reading
    store(row.surface_normal, 0, normal)


@in_place
def _distance_to_circle(tip: Vector, axis: Vector, radius: float) -> float:
    """Return the distance [m] from the tip to a circle, NaN where the probe misses it."""
    a = axis[0] * axis[0] + axis[1] * axis[1]
    b = tip[0] * axis[0] + tip[1] * axis[1]
    c = tip[0] * tip[0] + tip[1] * tip[1] - radius * radius
    discriminant = b * b - a * c
    return (-b - math.sqrt(discriminant)) / a if discriminant > 0.0 and a > 0.0 else math.nan


@in_place
def ring_gap(row: Any, pose: Any, jacobian: FloatArray, r: int) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into row r of ``jacobian``."""
    tip = rotate_back(pose.rotation, minus(at(row.tip, 0), at(pose.translation, 0)))
    axis = rotate_back(pose.rotation, at(row.axis, 0))
    _meet_ring(tip, axis, row)
    normal = at(row.surface_normal, 0)
    slant = dot(normal, axis)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(plus(tip, times(row.gap, axis)), normal), slant))
    return float(row.gap)


@in_place
def ring_parameters(row: Any, pose: Any, derivatives: Any) -> None:
    """Write the derivatives of the gap that ``ring_gap`` found with respect to the parameters of its row.

    The derivatives by the orders are zero.
    """
    normal = at(row.surface_normal, 0)
    axis = rotate_back(pose.rotation, at(row.axis, 0))
    slant = dot(normal, axis)
    normal_R = rotate(pose.rotation, normal)
    store(derivatives.tip, 0, over(times(-1.0, normal_R), slant))
    store(derivatives.axis, 0, over(times(-row.gap, normal_R), slant))
    derivatives.mean_radius = 1.0 / slant
    for h in range(int(row.harmonics)):
        derivatives.cosines[h] = row.multiple_cosines[h] / slant
        derivatives.sines[h] = row.multiple_sines[h] / slant
