"""Covariance of a point of the arm, propagated from joint to joint.

The quantity is x, y, z [m], about X, Y, Z [rad], axes of the base, the small turn applied on the base's side at the
point. Its blocks are stored separately: position, position and turn, turn. Symmetric blocks are stored as their upper
triangle, row by row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from posor.numerics.compiled import inlined
from posor.numerics.matrix import Matrix, applied, transposed
from posor.numerics.vector import Vector, cross, plus, put, times

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

UpperTriangle: TypeAlias = tuple[float, float, float, float, float, float]
Blocks: TypeAlias = tuple[UpperTriangle, Matrix, UpperTriangle]

_ZERO_TRIANGLE: UpperTriangle = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ZERO_MATRIX: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
ZERO_COVARIANCE: Blocks = (_ZERO_TRIANGLE, _ZERO_MATRIX, _ZERO_TRIANGLE)


@inlined
def moved_along(blocks: Blocks, lever: Vector) -> Blocks:
    """Return the covariance of another point of the same body, ``lever`` [m] away.

    A small turn w moves that point by w x lever in addition.
    """
    position, mixed, turn = blocks
    xx, xy, xz, yy, yz, zz = position
    x, y, z = mixed
    a, b, c, d, e, f = turn
    before_x, before_y, before_z = cross(x, lever), cross(y, lever), cross(z, lever)
    by_turn = transposed((cross((a, b, c), lever), cross((b, d, e), lever), cross((c, e, f), lever)))
    x, y, z = plus(x, by_turn[0]), plus(y, by_turn[1]), plus(z, by_turn[2])
    after_x, after_y, after_z = cross(x, lever), cross(y, lever), cross(z, lever)
    position = (
        xx + (before_x[0] + after_x[0]),
        xy + (before_y[0] + after_x[1]),
        xz + (before_z[0] + after_x[2]),
        yy + (before_y[1] + after_y[1]),
        yz + (before_z[1] + after_y[2]),
        zz + (before_z[2] + after_z[2]),
    )
    return position, (x, y, z), turn


@inlined
def add_rotated(blocks: Blocks, rotation: Matrix, own: FloatArray) -> Blocks:
    """Return the sum with the covariance of one more transform.

    ``rotation`` turns the axes of ``own`` (6, 6) to those of the base. Only the upper triangle of ``own`` is read.
    """
    position, mixed, turn = blocks
    position_part = _rotated(
        rotation,
        (own[0, 0], own[0, 1], own[0, 2]),
        (own[0, 1], own[1, 1], own[1, 2]),
        (own[0, 2], own[1, 2], own[2, 2]),
    )
    x, y, z = _rotated(
        rotation,
        (own[0, 3], own[1, 3], own[2, 3]),
        (own[0, 4], own[1, 4], own[2, 4]),
        (own[0, 5], own[1, 5], own[2, 5]),
    )
    turn_part = _rotated(
        rotation,
        (own[3, 3], own[3, 4], own[3, 5]),
        (own[3, 4], own[4, 4], own[4, 5]),
        (own[3, 5], own[4, 5], own[5, 5]),
    )
    mixed = plus(mixed[0], x), plus(mixed[1], y), plus(mixed[2], z)
    return _added(position, position_part), mixed, _added(turn, turn_part)


@inlined
def _rotated(rotation: Matrix, x: Vector, y: Vector, z: Vector) -> Matrix:
    """Return ``rotation @ block @ rotation.T``; x, y, z are the columns of the block."""
    a, b, c = transposed((applied(rotation, x), applied(rotation, y), applied(rotation, z)))
    return applied(rotation, a), applied(rotation, b), applied(rotation, c)


@inlined
def _added(triangle: UpperTriangle, block: Matrix) -> UpperTriangle:
    """Return the sum of two symmetric blocks."""
    a, b, c, d, e, f = triangle
    x, y, z = block
    return a + x[0], b + x[1], c + x[2], d + y[1], e + y[2], f + z[2]


@inlined
def add_outer_product(blocks: Blocks, shift: Vector, turn: Vector) -> Blocks:
    """Return the sum with the covariance of one standard deviation along a shift [m] and a turn [rad], axes of base."""
    position, mixed, turns = blocks
    x, y, z = mixed
    return (
        _added(position, (times(shift[0], shift), times(shift[1], shift), times(shift[2], shift))),
        (plus(x, times(shift[0], turn)), plus(y, times(shift[1], turn)), plus(z, times(shift[2], turn))),
        _added(turns, (times(turn[0], turn), times(turn[1], turn), times(turn[2], turn))),
    )


@inlined
def write_covariance(blocks: Blocks, covariance: FloatArray) -> None:
    """Write the covariance as a full matrix, (6, 6)."""
    position, mixed, turn = blocks
    put(covariance, 0, 0, (position[0], position[1], position[2]))
    covariance[1, 1], covariance[1, 2], covariance[2, 2] = position[3], position[4], position[5]
    put(covariance, 3, 3, (turn[0], turn[1], turn[2]))
    covariance[4, 4], covariance[4, 5], covariance[5, 5] = turn[3], turn[4], turn[5]
    put(covariance, 0, 3, mixed[0])
    put(covariance, 1, 3, mixed[1])
    put(covariance, 2, 3, mixed[2])
    for i in range(1, 6):
        for j in range(i):
            covariance[i, j] = covariance[j, i]
