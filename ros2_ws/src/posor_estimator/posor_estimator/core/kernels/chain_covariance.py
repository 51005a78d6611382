"""A covariance on its way along the chain: carried from point to point, and grown by each joint and beam.

It is that of a point of the arm: x, y, z [m], about X, Y, Z [rad], axes of the base, the small turn applied on the
base's side at the point. Only its upper triangle counts, in and out, until ``mirror`` fills in the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import Vector, cross, rotate, within

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@compiled
def carry(covariance: FloatArray, lever: Vector) -> None:
    """Make it, shape (6, 6), that of another point of the same body, ``lever`` [m] away, in place.

    A small turn w moves that point by w x lever more.
    """
    x, y, z = within(covariance, 3, 3)
    before_x, before_y, before_z = (
        cross(within(covariance, 0, 3), lever),
        cross(within(covariance, 1, 3), lever),
        cross(within(covariance, 2, 3), lever),
    )
    by_x = cross((x, y, z), lever)
    by_y = cross((y, covariance[4, 4], covariance[4, 5]), lever)
    by_z = cross((z, covariance[4, 5], covariance[5, 5]), lever)
    for i in range(3):
        covariance[i, 3] += by_x[i]
        covariance[i, 4] += by_y[i]
        covariance[i, 5] += by_z[i]
    after_x, after_y, after_z = (
        cross(within(covariance, 0, 3), lever),
        cross(within(covariance, 1, 3), lever),
        cross(within(covariance, 2, 3), lever),
    )
    covariance[0, 0] += before_x[0] + after_x[0]
    covariance[0, 1] += before_y[0] + after_x[1]
    covariance[0, 2] += before_z[0] + after_x[2]
    covariance[1, 1] += before_y[1] + after_y[1]
    covariance[1, 2] += before_z[1] + after_y[2]
    covariance[2, 2] += before_z[2] + after_z[2]


@compiled
def add_turned(covariance: FloatArray, rotation: FloatArray, own: FloatArray) -> None:
    """Add the covariance of one more transform, ``own`` (6, 6), whose axes ``rotation`` (3, 3) turns to the base's."""
    _add_block(
        covariance,
        0,
        0,
        rotation,
        (own[0, 0], own[0, 1], own[0, 2]),
        (own[0, 1], own[1, 1], own[1, 2]),
        (own[0, 2], own[1, 2], own[2, 2]),
    )
    _add_block(
        covariance,
        0,
        3,
        rotation,
        (own[0, 3], own[1, 3], own[2, 3]),
        (own[0, 4], own[1, 4], own[2, 4]),
        (own[0, 5], own[1, 5], own[2, 5]),
    )
    _add_block(
        covariance,
        3,
        3,
        rotation,
        (own[3, 3], own[3, 4], own[3, 5]),
        (own[3, 4], own[4, 4], own[4, 5]),
        (own[3, 5], own[4, 5], own[5, 5]),
    )


@compiled
def _add_block(
    covariance: FloatArray, top: int, left: int, rotation: FloatArray, x: Vector, y: Vector, z: Vector
) -> None:
    """Add ``rotation @ block @ rotation.T`` from an entry on; x, y, z are the columns of the block."""
    x, y, z = rotate(rotation, x), rotate(rotation, y), rotate(rotation, z)
    for j in range(3):
        a, b, c = within(rotation, j)
        for i in range(3):
            covariance[top + i, left + j] += a * x[i] + b * y[i] + c * z[i]


@compiled
def add_along(covariance: FloatArray, shift: Vector, turn: Vector) -> None:
    """Add that of one standard deviation along a shift [m] and a turn [rad], axes of the base, fully correlated."""
    for i in range(3):
        for j in range(3):
            covariance[i, j] += shift[i] * shift[j]
            covariance[i, 3 + j] += shift[i] * turn[j]
            covariance[3 + i, 3 + j] += turn[i] * turn[j]


@compiled
def mirror(covariance: FloatArray) -> None:
    """Make the lower triangle that of a symmetric matrix, in place."""
    for i in range(1, 6):
        for j in range(i):
            covariance[i, j] = covariance[j, i]
