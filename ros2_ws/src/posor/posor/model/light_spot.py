# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Light spot on a lateral effect diode: where the ray of a light source meets the plane of the diode.

Thesis 5.4.1 (exact here): the ray from the source, ``P + r D`` in R, meets the plane ``q + x u + y v``; x and y are the
spot's coordinates along the diode's own axes, which need not be orthogonal.

Row fields (``model.reading_rows``): ``diode_origin`` q, ``x_axis`` u and ``y_axis`` v in R, ``source_origin`` P and
``ray_direction`` D in T, ``ray_turn`` of the direction about Z of T [rad]. The lengths of u and v scale the reading;
the length of the direction has no effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    Vector,
    at,
    cross,
    dot,
    minus,
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


class Spot(NamedTuple):
    """Solution of ``[u v -D] (x, y, r) = P - q``: x, y [m], the ray parameter r, the rows of the inverse for x, y."""

    x: float
    y: float
    along_ray: float
    inverse_x: Vector
    inverse_y: Vector


@in_place
def prepare_spot(row: Any) -> None:
    """Write what does not depend on the pose: the turned ray direction in T, and ``u x v`` in R."""
    store(row.turned_ray, 0, rotated_about_z(at(row.ray_direction, 0), row.ray_turn))
    store(row.axes_product, 0, cross(at(row.x_axis, 0), at(row.y_axis, 0)))


@in_place
def find_spot(row: Any, pose: Any) -> Spot:
    """Return the light spot at a pose."""
    u, v = at(row.x_axis, 0), at(row.y_axis, 0)
    ray = rotate(pose.rotation, at(row.turned_ray, 0))
    source = plus(rotate(pose.rotation, at(row.source_origin, 0)), at(pose.translation, 0))
    offset = minus(source, at(row.diode_origin, 0))
    v_ray = cross(v, ray)
    ray_u = cross(ray, u)
    volume = dot(u, v_ray)
    return Spot(
        dot(v_ray, offset) / volume,
        dot(ray_u, offset) / volume,
        -dot(at(row.axes_product, 0), offset) / volume,
        times(1.0 / volume, v_ray),
        times(1.0 / volume, ray_u),
    )


@in_place
def spot_tangent(row: Any, pose: Any, along_ray: float, inverse: Vector, jacobian: FloatArray, r: int) -> None:
    """Write the tangent derivative of the coordinate that belongs to ``inverse`` into row r of ``jacobian``."""
    inverse_T = rotate_back(pose.rotation, inverse)
    point = plus(at(row.source_origin, 0), times(along_ray, at(row.turned_ray, 0)))
    put(jacobian, r, 0, inverse_T)
    put(jacobian, r, 3, cross(point, inverse_T))


@in_place
def spot_parameters(row: Any, pose: Any, spot: Spot, inverse: Vector, derivatives: Any) -> None:
    """Write the derivatives of the coordinate that belongs to ``inverse`` by the parameters of its row."""
    inverse_T = rotate_back(pose.rotation, inverse)
    store(derivatives.diode_origin, 0, times(-1.0, inverse))
    store(derivatives.x_axis, 0, times(-spot.x, inverse))
    store(derivatives.y_axis, 0, times(-spot.y, inverse))
    store(derivatives.source_origin, 0, inverse_T)
    store(derivatives.ray_direction, 0, times(spot.along_ray, rotated_about_z(inverse_T, -row.ray_turn)))
    derivatives.ray_turn = spot.along_ray * (inverse_T[1] * row.turned_ray[0] - inverse_T[0] * row.turned_ray[1])
