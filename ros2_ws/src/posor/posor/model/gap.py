"""Gap probe: distance along the probe's axis to the target plane.

Thesis 5.3.1 (equation 5.3, exact here): with the tip ``o`` and the axis ``a`` seen from T, the plane through ``q`` with
normal ``m`` is met at the distance ``g = m.(q - o) / (m.a)``.

Row fields (``model.reading_rows``): ``tip`` and ``axis`` in R, ``plane_point`` in T [m], ``tilt`` of the plane about X
and Y of T [rad], ``turn`` of the tilt about Z of T [rad]. The normal toward the probes is ``Rz(turn) Rx(tilt 0)
Ry(tilt 1) (0, 0, -1)``. The derivatives also hold for an axis that is not of unit length.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.numerics.compiled import in_place, inlined
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


@inlined
def _intersection(row: Any, pose: Any) -> tuple[float, float, Vector]:
    """Return the gap [m], the slant ``m.a``, and the point in T where the axis meets the plane."""
    normal = at(row.normal, 0)
    tip = rotate_back(pose.rotation, minus(at(row.tip, 0), at(pose.translation, 0)))
    axis = rotate_back(pose.rotation, at(row.axis, 0))
    slant = dot(normal, axis)
    reading = dot(normal, minus(at(row.plane_point, 0), tip)) / slant
    return reading, slant, plus(tip, times(reading, axis))


@inlined
def gap(row: Any, pose: Any, jacobian: FloatArray, r: int) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into row r of ``jacobian``."""
    normal = at(row.normal, 0)
    reading, slant, point = _intersection(row, pose)
    put(jacobian, r, 0, over(normal, slant))
    put(jacobian, r, 3, over(cross(point, normal), slant))
    return reading


@inlined
def gap_parameters(row: Any, pose: Any, derivatives: Any) -> None:
    """Write the derivatives of the gap with respect to the parameters of its row."""
    normal = at(row.normal, 0)
    reading, slant, point = _intersection(row, pose)
    normal_R = rotate(pose.rotation, normal)
    store(derivatives.tip, 0, over(times(-1.0, normal_R), slant))
    store(derivatives.axis, 0, over(times(-reading, normal_R), slant))
    store(derivatives.plane_point, 0, over(normal, slant))
    beyond = times(1.0 / slant, minus(at(row.plane_point, 0), point))
    derivatives.tilt[0] = dot(beyond, at(row.normal_by_tilt_x, 0))
    derivatives.tilt[1] = dot(beyond, at(row.normal_by_tilt_y, 0))
    derivatives.turn = beyond[1] * normal[0] - beyond[0] * normal[1]
