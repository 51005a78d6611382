"""A covariance on its way along the chain: carried from point to point, and grown by each joint and beam.

It is that of a point of the arm: x, y, z [m], about X, Y, Z [rad], axes of the base, the small turn applied on the
base's side at the point. Its blocks are kept apart: of the place, of place and turn, of the turn; of a symmetric one
the upper triangle, row by row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.matrix import Matrix, applied, transposed
from posor_estimator.core.kernels.vector import Vector, cross, plus, put, times

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

Half: TypeAlias = tuple[float, float, float, float, float, float]
Blocks: TypeAlias = tuple[Half, Matrix, Half]

NO_HALF: Half = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NOTHING: Blocks = (NO_HALF, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), NO_HALF)


@inlined
def carried(blocks: Blocks, lever: Vector) -> Blocks:
    """Return it for another point of the same body, ``lever`` [m] away.

    A small turn w moves that point by w x lever more.
    """
    place, cross_block, turn = blocks
    xx, xy, xz, yy, yz, zz = place
    x, y, z = cross_block
    a, b, c, d, e, f = turn
    before_x, before_y, before_z = cross(x, lever), cross(y, lever), cross(z, lever)
    by = transposed((cross((a, b, c), lever), cross((b, d, e), lever), cross((c, e, f), lever)))
    x, y, z = plus(x, by[0]), plus(y, by[1]), plus(z, by[2])
    after_x, after_y, after_z = cross(x, lever), cross(y, lever), cross(z, lever)
    place = (
        xx + (before_x[0] + after_x[0]),
        xy + (before_y[0] + after_x[1]),
        xz + (before_z[0] + after_x[2]),
        yy + (before_y[1] + after_y[1]),
        yz + (before_z[1] + after_y[2]),
        zz + (before_z[2] + after_z[2]),
    )
    return place, (x, y, z), turn


@inlined
def with_turned(blocks: Blocks, rotation: Matrix, own: FloatArray) -> Blocks:
    """Return it with that of one more transform, ``own`` (6, 6), whose axes ``rotation`` turns to the base's.

    Of ``own`` only the upper triangle counts.
    """
    place, cross_block, turn = blocks
    add = _turned(
        rotation,
        (own[0, 0], own[0, 1], own[0, 2]),
        (own[0, 1], own[1, 1], own[1, 2]),
        (own[0, 2], own[1, 2], own[2, 2]),
    )
    place = _with(place, add)
    x, y, z = _turned(
        rotation,
        (own[0, 3], own[1, 3], own[2, 3]),
        (own[0, 4], own[1, 4], own[2, 4]),
        (own[0, 5], own[1, 5], own[2, 5]),
    )
    cross_block = plus(cross_block[0], x), plus(cross_block[1], y), plus(cross_block[2], z)
    add = _turned(
        rotation,
        (own[3, 3], own[3, 4], own[3, 5]),
        (own[3, 4], own[4, 4], own[4, 5]),
        (own[3, 5], own[4, 5], own[5, 5]),
    )
    return place, cross_block, _with(turn, add)


@inlined
def _turned(rotation: Matrix, x: Vector, y: Vector, z: Vector) -> Matrix:
    """Return ``rotation @ block @ rotation.T``; x, y, z are the columns of the block."""
    a, b, c = transposed((applied(rotation, x), applied(rotation, y), applied(rotation, z)))
    return applied(rotation, a), applied(rotation, b), applied(rotation, c)


@inlined
def _with(half: Half, add: Matrix) -> Half:
    """Return a symmetric block with another added."""
    a, b, c, d, e, f = half
    x, y, z = add
    return a + x[0], b + x[1], c + x[2], d + y[1], e + y[2], f + z[2]


@inlined
def with_one_along(blocks: Blocks, shift: Vector, turn: Vector) -> Blocks:
    """Return it with that of one standard deviation along a shift [m] and a turn [rad], axes of the base."""
    place, cross_block, turns = blocks
    x, y, z = cross_block
    return (
        _with(place, (times(shift[0], shift), times(shift[1], shift), times(shift[2], shift))),
        (plus(x, times(shift[0], turn)), plus(y, times(shift[1], turn)), plus(z, times(shift[2], turn))),
        _with(turns, (times(turn[0], turn), times(turn[1], turn), times(turn[2], turn))),
    )


@inlined
def write_covariance(blocks: Blocks, covariance: FloatArray) -> None:
    """Write it as a matrix, (6, 6)."""
    place, cross_block, turn = blocks
    put(covariance, 0, 0, (place[0], place[1], place[2]))
    covariance[1, 1], covariance[1, 2], covariance[2, 2] = place[3], place[4], place[5]
    put(covariance, 3, 3, (turn[0], turn[1], turn[2]))
    covariance[4, 4], covariance[4, 5], covariance[5, 5] = turn[3], turn[4], turn[5]
    put(covariance, 0, 3, cross_block[0])
    put(covariance, 1, 3, cross_block[1])
    put(covariance, 2, 3, cross_block[2])
    for i in range(1, 6):
        for j in range(i):
            covariance[i, j] = covariance[j, i]
