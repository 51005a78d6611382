"""Light spot on a lateral effect diode: where the source's ray meets the diode's plane.

Thesis 5.3.2 (exact here): the ray from the source, ``P + r D`` in R, meets the plane ``q + x u + y v``; x and y are the
spot's coordinates along the diode's own axes, which need not be orthogonal.

Row parameters (16): diode origin in R [m] 0:3, x axis u in R 3:6, y axis v in R 6:9, source origin in T [m] 9:12, ray
direction in T 12:15, extra turn of the direction about Z of T [rad] 15. The lengths of u and v scale the reading; the
length of the direction has no effect.

Prepared (6), what does not depend on the pose: the turned direction in T 0:3, ``u x v`` in R 3:6.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.vector import (
    at,
    cross,
    dot,
    minus,
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

PARAMETERS = 16
PREPARED = 6


@in_place
def prepare_spot(rows: FloatArray, r: int, prepared: FloatArray) -> None:
    """Write what does not depend on the pose into row r of ``prepared``."""
    put(prepared, r, 0, turned(within(rows, r, 12), rows[r, 15]))
    put(prepared, r, 3, cross(within(rows, r, 3), within(rows, r, 6)))


@inlined
def meet(
    rows: FloatArray, r: int, prepared: FloatArray, rotation: FloatArray, translation: FloatArray
) -> tuple[float, float, float, Vector, Vector]:
    """Solve ``[u v -D] (x, y, r) = P - q``.

    Returns x [m], y [m], the ray's parameter r, and the rows of the inverse that give x and y.
    """
    u, v = within(rows, r, 3), within(rows, r, 6)
    ray = rotate(rotation, within(prepared, r, 0))
    offset = minus(plus(rotate(rotation, within(rows, r, 9)), at(translation, 0)), within(rows, r, 0))
    v_ray = cross(v, ray)
    ray_u = cross(ray, u)
    volume = dot(u, v_ray)
    x = dot(v_ray, offset) / volume
    y = dot(ray_u, offset) / volume
    along = -dot(within(prepared, r, 3), offset) / volume
    return x, y, along, times(1.0 / volume, v_ray), times(1.0 / volume, ray_u)


@inlined
def spot_tangent(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    along: float,
    dual: Vector,
    jacobian: FloatArray,
    to: int,
) -> None:
    """Write the tangent derivative of the coordinate that belongs to ``dual`` into row ``to`` of ``jacobian``."""
    dual_T = rotate_back(rotation, dual)
    put(jacobian, to, 0, dual_T)
    put(jacobian, to, 3, cross(plus(within(rows, r, 9), times(along, within(prepared, r, 0))), dual_T))


@inlined
def spot_parameters(
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    x: float,
    y: float,
    along: float,
    dual: Vector,
    jacobian: FloatArray,
    to: int,
) -> None:
    """Write the derivative with respect to the 16 parameters likewise; ``x``, ``y``, ``along`` as from ``meet``."""
    dual_T = rotate_back(rotation, dual)
    direction = within(prepared, r, 0)
    put(jacobian, to, 0, times(-1.0, dual))
    put(jacobian, to, 3, times(-x, dual))
    put(jacobian, to, 6, times(-y, dual))
    put(jacobian, to, 9, dual_T)
    put(jacobian, to, 12, times(along, turned(dual_T, -rows[r, 15])))
    jacobian[to, 15] = along * (dual_T[1] * direction[0] - dual_T[0] * direction[1])
