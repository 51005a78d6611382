"""Cholesky factorisation of small symmetric matrices, with a measure of how well they are conditioned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place
from posor_estimator.core.kernels.eight import everywhere

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@in_place
def factor(matrix: FloatArray) -> float:
    """Replace a symmetric matrix by its lower Cholesky factor; return how much of the weakest diagonal entry is left.

    The return value is the least ratio of a pivot to its own diagonal entry: one for a diagonal matrix, near zero where
    an unknown can be made up of the others. Zero means: not positive definite, the contents are of no use. Only the
    lower triangle is read and written.
    """
    n = matrix.shape[0]
    weakest = 1.0
    for j in range(n):
        whole = matrix[j, j]
        pivot = whole
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not everywhere(pivot > 0.0):
            return 0.0
        weakest = min(weakest, pivot / whole)
        root = math.sqrt(pivot)
        matrix[j, j] = root
        for i in range(j + 1, n):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / root
    return weakest


@in_place
def halve(lower: FloatArray, vector: FloatArray) -> None:
    """Solve ``lower @ x = vector`` in place."""
    for i in range(lower.shape[0]):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]
