"""Covariance of a solution: random and systematic.

With the rows' derivatives J, the readings' variances R (random, diagonal) and G = (J' R^-1 J)^-1 J' R^-1:

* random covariance ``(J' R^-1 J)^-1`` (JCGM 100, 5.1 for a linear model of uncorrelated readings);
* systematic covariance ``G S G'`` where S is the readings' covariance from the calibration parameters
  (``estimation.parameter_effects``; JCGM 100, 5.2: parameters shared by readings correlate them).

Both are turned from the local tangent into ROS order: x, y, z, about X, Y, Z along the axes of R, the small turn
applied on the parent's side at the origin of T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.numerics.compiled import inlined
from posor.numerics.matrix import matrix, row_times
from posor.numerics.symmetric import (
    ZERO_MATRIX,
    ZERO_VECTOR,
    add_outer,
    fill_upper_triangle,
    invert,
    load_factors,
    multiply_vector,
    product_transposed,
)
from posor.numerics.vector import plus, put, times, within

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.matrix import Matrix
    from posor.numerics.symmetric import Symmetric


@inlined
def write_covariances(workspace: Any, random: FloatArray, systematic: FloatArray) -> None:
    """Write the random and the systematic covariance of the solution, ROS order, (6, 6) each; ``gain`` is written."""
    jacobian, weights, gain = workspace.jacobian, workspace.weights, workspace.gain
    m, axes = workspace.reading_count, matrix(workspace.pose.rotation, 0)
    local = invert(load_factors(workspace.factors))
    _write_in_parent_axes(local, axes, random)
    for r in range(m):
        v, w = multiply_vector(local, within(jacobian, r, 0), within(jacobian, r, 3))
        put(gain, r, 0, times(weights[r], v))
        put(gain, r, 3, times(weights[r], w))
    a, b, d = ZERO_MATRIX, ZERO_MATRIX, ZERO_MATRIX
    for r in range(m):
        v, w = ZERO_VECTOR, ZERO_VECTOR
        for q in range(workspace.first_correlated[r], workspace.end_correlated[r]):
            v = plus(v, times(workspace.systematic_readings[r, q], within(gain, q, 0)))
            w = plus(w, times(workspace.systematic_readings[r, q], within(gain, q, 3)))
        a = add_outer(a, within(gain, r, 0), v)
        b = add_outer(b, within(gain, r, 3), v)
        d = add_outer(d, within(gain, r, 3), w)
    _write_in_parent_axes((fill_upper_triangle(a), b, fill_upper_triangle(d)), axes, systematic)


@inlined
def _rotated_block(block: Matrix, axes: Matrix) -> Matrix:
    """Return ``R block R'``, R the rotation whose rows are ``axes``."""
    half = row_times(axes[0], block), row_times(axes[1], block), row_times(axes[2], block)
    return product_transposed(half, axes)


@inlined
def _write_in_parent_axes(local: Symmetric, axes: Matrix, out: FloatArray) -> None:
    """Write a covariance of the local tangent, rotated block by block into the parent's axes, into ``out`` (6, 6)."""
    a = fill_upper_triangle(_rotated_block(local[0], axes))
    b = _rotated_block(local[1], axes)
    d = fill_upper_triangle(_rotated_block(local[2], axes))
    for i in range(3):
        put(out, i, 0, a[i])
        put(out, 3 + i, 0, b[i])
        put(out, i, 3, (b[0][i], b[1][i], b[2][i]))
        put(out, 3 + i, 3, d[i])
