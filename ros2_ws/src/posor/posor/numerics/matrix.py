# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Symmetric matrices for kernels: 6x6 in 3x3 blocks, and Cholesky factors of any size.

The symmetric matrix of the six unknowns of a pose (translation, rotation) is ``(A, B, D)`` for ``[[A, B'], [B, D]]``;
of A and D only the lower triangles are read. It is factorised as ``L diag(pivots) L'`` with a unit diagonal of L: no
square roots, six divisions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    ZERO_MATRIX,
    Matrix,
    Vector,
    applied,
    dot,
    minus,
    plus,
    put,
    row_times,
    times,
    transposed,
    within,
)

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray


@in_place
def cholesky_factorise(matrix: FloatArray, n: int) -> bool:
    """Replace the leading ``n`` x ``n`` block of a symmetric matrix by its lower Cholesky factor.

    Only the lower triangle is read and written. Returns False where the block is not positive definite; the contents
    are then invalid.
    """
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 0.0:
            return False
        root = math.sqrt(pivot)
        matrix[j, j] = root
        for i in range(j + 1, n):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / root
    return True


@in_place
def solve_lower_triangular(lower: FloatArray, n: int, vector: FloatArray) -> None:
    """Solve ``lower[:n, :n] @ x = vector[:n]`` in place."""
    for i in range(n):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]


Symmetric: TypeAlias = tuple[Matrix, Matrix, Matrix]
Lower: TypeAlias = tuple[Vector, Vector]  # of three unknowns: entries 10, 20, 21 of L, and the reciprocal pivots
Factors: TypeAlias = tuple[Lower, Matrix, Lower]
"""Of six unknowns: L of the translation, the rows of L that couple both, L of the rotation."""


@in_place
def add_outer(total: Matrix, a: Vector, b: Vector) -> Matrix:
    """Return ``total + a b'``."""
    return plus(total[0], times(a[0], b)), plus(total[1], times(a[1], b)), plus(total[2], times(a[2], b))


@in_place
def product_transposed(a: Matrix, b: Matrix) -> Matrix:
    """Return ``a b'``."""
    return applied(b, a[0]), applied(b, a[1]), applied(b, a[2])


@in_place
def fill_upper_triangle(a: Matrix) -> Matrix:
    """Return the symmetric matrix whose lower triangle is that of ``a``."""
    return (a[0][0], a[1][0], a[2][0]), (a[1][0], a[1][1], a[2][1]), a[2]


@in_place
def normal_matrix(jacobian: FloatArray, weights: FloatArray, count: int) -> Symmetric:
    """Return ``J' W J`` of the first ``count`` rows of ``jacobian`` (m, 6), ``weights`` (m,)."""
    a, b, d = ZERO_MATRIX, ZERO_MATRIX, ZERO_MATRIX
    for r in range(count):
        by_translation, by_rotation = within(jacobian, r, 0), within(jacobian, r, 3)
        weighted = times(weights[r], by_rotation)
        a = add_outer(a, times(weights[r], by_translation), by_translation)
        b = add_outer(b, weighted, by_translation)
        d = add_outer(d, weighted, by_rotation)
    return a, b, d


@in_place
def reciprocal(pivot: float) -> float:
    """Return the reciprocal of a pivot, NaN where it is not positive."""
    return 1.0 / (pivot if pivot > 0.0 else math.nan)


@in_place
def factorise_block(a: Matrix) -> tuple[Lower, float, float, float]:
    """Return the factor of a symmetric matrix and its pivots."""
    first = a[0][0]
    by_first = reciprocal(first)
    l10, l20 = a[1][0] * by_first, a[2][0] * by_first
    second = a[1][1] - l10 * a[1][0]
    by_second = reciprocal(second)
    rest = a[2][1] - l20 * a[1][0]
    l21 = rest * by_second
    third = a[2][2] - l20 * a[2][0] - l21 * rest
    return ((l10, l20, l21), (by_first, by_second, reciprocal(third))), first, second, third


@in_place
def forward(lower: Lower, a: Vector) -> Vector:
    """Return x of ``L x = a``."""
    ones = lower[0]
    second = a[1] - ones[0] * a[0]
    return a[0], second, a[2] - ones[1] * a[0] - ones[2] * second


@in_place
def back(lower: Lower, a: Vector) -> Vector:
    """Return x of ``L' x = a``."""
    ones = lower[0]
    second = a[1] - ones[2] * a[2]
    return a[0] - ones[0] * second - ones[1] * a[2], second, a[2]


@in_place
def divide_by_pivots(lower: Lower, a: Vector) -> Vector:
    """Return a vector divided by the pivots."""
    return a[0] * lower[1][0], a[1] * lower[1][1], a[2] * lower[1][2]


@in_place
def factorise(matrix: Symmetric) -> tuple[Factors, float]:
    """Return the factors of a symmetric matrix and its smallest ratio of a pivot to the diagonal entry.

    The ratio is one for a diagonal matrix and near zero where one unknown is a combination of the others. A ratio that
    is not positive means: not positive definite, the factors are invalid.
    """
    a, b, d = matrix
    upper, a_0, a_1, a_2 = factorise_block(a)
    half = forward(upper, b[0]), forward(upper, b[1]), forward(upper, b[2])
    joint = divide_by_pivots(upper, half[0]), divide_by_pivots(upper, half[1]), divide_by_pivots(upper, half[2])
    left = (
        (d[0][0] - dot(joint[0], half[0]), 0.0, 0.0),
        (d[1][0] - dot(joint[1], half[0]), d[1][1] - dot(joint[1], half[1]), 0.0),
        minus(d[2], (dot(joint[2], half[0]), dot(joint[2], half[1]), dot(joint[2], half[2]))),
    )
    lower, d_0, d_1, d_2 = factorise_block(left)
    weakest = 0.0
    if a_0 > 0.0 and a_1 > 0.0 and a_2 > 0.0 and d_0 > 0.0 and d_1 > 0.0 and d_2 > 0.0:
        weakest = min(1.0, a_1 / a[1][1])
        weakest = min(weakest, a_2 / a[2][2])
        weakest = min(weakest, d_0 / d[0][0])
        weakest = min(weakest, d_1 / d[1][1])
        weakest = min(weakest, d_2 / d[2][2])
    return (upper, joint, lower), weakest


@in_place
def solve(factors: Factors, a: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Return the solution of the equations with right sides ``a`` and ``d``."""
    upper, joint, lower = factors
    half = forward(upper, a)
    d = back(lower, divide_by_pivots(lower, forward(lower, minus(d, applied(joint, half)))))
    return back(upper, minus(divide_by_pivots(upper, half), row_times(d, joint))), d


@in_place
def store_factors(factors: Factors, kept: FloatArray) -> None:
    """Write factors into an array (7, 3)."""
    upper, joint, lower = factors
    put(kept, 0, 0, upper[0])
    put(kept, 1, 0, upper[1])
    put(kept, 2, 0, joint[0])
    put(kept, 3, 0, joint[1])
    put(kept, 4, 0, joint[2])
    put(kept, 5, 0, lower[0])
    put(kept, 6, 0, lower[1])


@in_place
def load_factors(kept: FloatArray) -> Factors:
    """Return the factors that ``store_factors`` has written."""
    joint = within(kept, 2), within(kept, 3), within(kept, 4)
    return (within(kept, 0), within(kept, 1)), joint, (within(kept, 5), within(kept, 6))


@in_place
def invert_block(lower: Lower) -> Matrix:
    """Return the inverse of the symmetric matrix that a factor is of."""
    ones, (p, q, r) = lower
    to_last = ones[0] * ones[2] - ones[1]
    m20, m21, m10 = to_last * r, -ones[2] * r, -ones[0] * q - ones[2] * (to_last * r)
    return ((p + ones[0] * ones[0] * q + to_last * m20, m10, m20), (m10, q - ones[2] * m21, m21), (m20, m21, r))


@in_place
def invert(factors: Factors) -> Symmetric:
    """Return the inverse of the matrix that the factors are of."""
    upper, joint, lower = factors
    d = invert_block(lower)
    # The rotation that a translation is taken for, and back.
    taken = back(upper, joint[0]), back(upper, joint[1]), back(upper, joint[2])
    columns = transposed(taken)
    b = applied(columns, d[0]), applied(columns, d[1]), applied(columns, d[2])
    a = invert_block(upper)
    for_a = product_transposed(columns, transposed(b))
    return (
        (plus(a[0], for_a[0]), plus(a[1], for_a[1]), plus(a[2], for_a[2])),
        (times(-1.0, b[0]), times(-1.0, b[1]), times(-1.0, b[2])),
        d,
    )


@in_place
def multiply_vector(matrix: Symmetric, a: Vector, d: Vector) -> tuple[Vector, Vector]:
    """Return the product with the vector of parts ``a`` and ``d``; A and D must be whole."""
    return plus(applied(matrix[0], a), row_times(d, matrix[1])), plus(applied(matrix[1], a), applied(matrix[2], d))
