"""Light spot on a lateral effect diode: where the source's ray meets the diode's plane.

Thesis 5.3.2 (exact here): the ray from the source, ``P + r D`` in R, meets the plane ``q + x u + y v``; x and y are the
spot's coordinates along the diode's own axes, which need not be orthogonal.

Row parameters (16): diode origin in R [m] 0:3, x axis u in R 3:6, y axis v in R 6:9, source origin in T [m] 9:12, ray
direction in T 12:15, extra turn of the direction about Z of T [rad] 15. The lengths of u and v scale the reading; the
length of the direction has no effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import at, cross, dot, minus, plus, rotate, rotate_back, times, turned

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray

PARAMETERS = 16


@compiled
def _meet(
    row: FloatArray, rotation: FloatArray, translation: FloatArray, which: int
) -> tuple[float, float, float, Vector]:
    """Solve ``[u v -D] (x, y, r) = P - q``.

    Returns x [m], y [m], the ray's parameter r, and the row of the inverse that gives coordinate ``which``.
    """
    u, v = at(row, 3), at(row, 6)
    ray = rotate(rotation, turned(at(row, 12), row[15]))
    offset = minus(plus(rotate(rotation, at(row, 9)), at(translation, 0)), at(row, 0))
    v_ray = cross(v, ray)
    ray_u = cross(ray, u)
    volume = dot(u, v_ray)
    x = dot(v_ray, offset) / volume
    y = dot(ray_u, offset) / volume
    along = -dot(cross(u, v), offset) / volume
    return x, y, along, times(1.0 / volume, v_ray if which == 0 else ray_u)


@compiled
def spot(row: FloatArray, rotation: FloatArray, translation: FloatArray, which: int, jacobian: FloatArray) -> float:
    """Return spot coordinate ``which`` (0: x, 1: y) [m] and write its tangent derivative into ``jacobian`` (6)."""
    x, y, along, dual = _meet(row, rotation, translation, which)
    dual_T = rotate_back(rotation, dual)
    lever = cross(plus(at(row, 9), times(along, turned(at(row, 12), row[15]))), dual_T)
    for i in range(3):
        jacobian[i] = dual_T[i]
        jacobian[3 + i] = lever[i]
    return x if which == 0 else y


@compiled
def spot_parameters(
    row: FloatArray, rotation: FloatArray, translation: FloatArray, which: int, jacobian: FloatArray
) -> None:
    """Write the derivative of coordinate ``which`` with respect to the row's parameters into ``jacobian`` (16)."""
    x, y, along, dual = _meet(row, rotation, translation, which)
    dual_T = rotate_back(rotation, dual)
    by_direction = turned(dual_T, -row[15])
    direction = turned(at(row, 12), row[15])
    for i in range(3):
        jacobian[i] = -dual[i]
        jacobian[3 + i] = -x * dual[i]
        jacobian[6 + i] = -y * dual[i]
        jacobian[9 + i] = dual_T[i]
        jacobian[12 + i] = along * by_direction[i]
    jacobian[15] = along * (dual_T[1] * direction[0] - dual_T[0] * direction[1])
