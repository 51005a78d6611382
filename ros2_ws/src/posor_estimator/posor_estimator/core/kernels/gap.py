"""Gap probe: distance along the probe's axis to the target plane.

Thesis 5.3.1 (equation 5.3, exact here): with the tip ``o`` and the axis ``a`` seen from T, the plane through ``q`` with
normal ``m`` is met at the distance ``g = m.(q - o) / (m.a)``.

Row parameters (12): tip in R [m] 0:3, axis in R 3:6, plane point in T [m] 6:9, tilt of the plane about X and Y of T
[rad] 9:11, extra turn of the tilt about Z of T [rad] 11. The normal toward the probes is ``Rz(turn) Rx(tilt 0) Ry(tilt
1) (0, 0, -1)``. The axis need not be of unit length for the derivatives to hold; with a unit axis the reading is in
metres.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import at, cross, dot, minus, plus, rotate, rotate_back, times, turned

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

PARAMETERS = 12


@compiled
def plane_normal(tilt_x: float, tilt_y: float, turn: float) -> Vector:
    """Return the unit normal toward the probes, in T; angles [rad]."""
    normal = -math.sin(tilt_y), math.sin(tilt_x) * math.cos(tilt_y), -math.cos(tilt_x) * math.cos(tilt_y)
    return turned(normal, turn)


@compiled
def gap(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into ``jacobian`` (6)."""
    tip = rotate_back(rotation, minus(at(row, 0), at(translation, 0)))
    axis = rotate_back(rotation, at(row, 3))
    normal = plane_normal(row[9], row[10], row[11])
    slant = dot(normal, axis)
    reading = dot(normal, minus(at(row, 6), tip)) / slant
    lever = cross(plus(tip, times(reading, axis)), normal)
    for i in range(3):
        jacobian[i] = normal[i] / slant
        jacobian[3 + i] = lever[i] / slant
    return reading


@compiled
def gap_parameters(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> None:
    """Write the derivative of the gap with respect to the row's twelve parameters into ``jacobian`` (12)."""
    tip = rotate_back(rotation, minus(at(row, 0), at(translation, 0)))
    axis = rotate_back(rotation, at(row, 3))
    normal = plane_normal(row[9], row[10], row[11])
    normal_R = rotate(rotation, normal)
    slant = dot(normal, axis)
    reading = dot(normal, minus(at(row, 6), tip)) / slant
    for i in range(3):
        jacobian[i] = -normal_R[i] / slant
        jacobian[3 + i] = -reading * normal_R[i] / slant
        jacobian[6 + i] = normal[i] / slant
    beyond = times(1.0 / slant, minus(at(row, 6), plus(tip, times(reading, axis))))
    sx, cx = math.sin(row[9]), math.cos(row[9])
    sy, cy = math.sin(row[10]), math.cos(row[10])
    jacobian[9] = dot(beyond, turned((0.0, cx * cy, sx * cy), row[11]))
    jacobian[10] = dot(beyond, turned((-cy, -sx * sy, cx * sy), row[11]))
    jacobian[11] = beyond[1] * normal[0] - beyond[0] * normal[1]
