"""Gap probe: distance along the probe's axis to the target plane.

Thesis 5.3.1 (equation 5.3, exact here): with the tip ``o`` and the axis ``a`` seen from T, the plane through ``q`` with
normal ``m`` is met at the distance ``g = m.(q - o) / (m.a)``.

Row parameters (12): tip in R [m] 0:3, axis in R 3:6, plane point in T [m] 6:9, tilt of the plane about X and Y of T
[rad] 9:11, extra turn of the tilt about Z of T [rad] 11. The normal toward the probes is ``Rz(turn) Rx(tilt 0) Ry(tilt
1) (0, 0, -1)``. The axis need not be of unit length for the derivatives to hold; with a unit axis the reading is in
metres.

Prepared (9), what does not depend on the pose: the normal in T 0:3, its derivatives with respect to the tilts 3:6, 6:9.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
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
    turned,
    within,
)

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

PARAMETERS = 12
PREPARED = 9


@in_place
def plane_normal(tilt_x: float, tilt_y: float, turn: float) -> Vector:
    """Return the unit normal toward the probes, in T; angles [rad]."""
    normal = -math.sin(tilt_y), math.sin(tilt_x) * math.cos(tilt_y), -math.cos(tilt_x) * math.cos(tilt_y)
    return turned(normal, turn)


@in_place
def prepare_gap(rows: FloatArray, r: int, prepared: FloatArray) -> None:
    """Write what does not depend on the pose into row r of ``prepared``."""
    sx, cx = math.sin(rows[r, 9]), math.cos(rows[r, 9])
    sy, cy = math.sin(rows[r, 10]), math.cos(rows[r, 10])
    put(prepared, r, 0, plane_normal(rows[r, 9], rows[r, 10], rows[r, 11]))
    put(prepared, r, 3, turned((0.0, cx * cy, sx * cy), rows[r, 11]))
    put(prepared, r, 6, turned((-cy, -sx * sy, cx * sy), rows[r, 11]))


@inlined
def _meet(
    rows: FloatArray, r: int, normal: Vector, rotation: FloatArray, translation: FloatArray
) -> tuple[float, float, Vector, Vector]:
    """Return the gap [m], the slant ``m.a``, and tip and axis in T."""
    tip = rotate_back(rotation, minus(within(rows, r, 0), at(translation, 0)))
    axis = rotate_back(rotation, within(rows, r, 3))
    slant = dot(normal, axis)
    return dot(normal, minus(within(rows, r, 6), tip)) / slant, slant, tip, axis


@inlined
def gap(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Return the gap [m] of row r and write its derivative with respect to the local tangent into that of ``jacobian``.

    Shapes: rows (m, 12 or more), prepared (m, 9 or more), jacobian (m, 6).
    """
    normal = within(prepared, r, 0)
    reading, slant, tip, axis = _meet(rows, r, normal, rotation, translation)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(plus(tip, times(reading, axis)), normal), slant))
    return reading


@inlined
def gap_parameters(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write the derivative of the gap of row r with respect to its parameters into that of ``jacobian`` (m, 12+)."""
    normal = within(prepared, r, 0)
    reading, slant, tip, axis = _meet(rows, r, normal, rotation, translation)
    normal_R = rotate(rotation, normal)
    put(jacobian, r, 0, over(times(-1.0, normal_R), slant))
    put(jacobian, r, 3, over(times(-reading, normal_R), slant))
    put(jacobian, r, 6, over(normal, slant))
    beyond = times(1.0 / slant, minus(within(rows, r, 6), plus(tip, times(reading, axis))))
    jacobian[r, 9] = dot(beyond, within(prepared, r, 3))
    jacobian[r, 10] = dot(beyond, within(prepared, r, 6))
    jacobian[r, 11] = beyond[1] * normal[0] - beyond[0] * normal[1]
