"""Cholesky factorisation of small symmetric matrices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.numerics.compiled import in_place

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
