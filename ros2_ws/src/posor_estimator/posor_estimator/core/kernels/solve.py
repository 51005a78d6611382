"""Weighted Gauss-Newton on SE(3) for one scan.

The unknown is ``T_R_T``; the tangent is pinocchio's local one (see the package's docstring). Each iteration solves the
normal equations by a Cholesky factorisation with the rotation columns scaled by a length, so that all six unknowns are
of one unit; the same factorisation tells whether the readings determine the pose at all.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.gap import gap
from posor_estimator.core.kernels.spot import spot
from posor_estimator.core.kernels.vector import apply_tangent, orthonormalise

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

GAP = 0
SPOT_X = 1
SPOT_Y = 2

CONVERGED = 0
NOT_CONVERGED = 1
ILL_CONDITIONED = 2

SMALLEST_PIVOT_RATIO = 1e-10
"""Smallest over largest squared Cholesky pivot of the scaled normal matrix; below it the pose is not determined."""


@compiled
def evaluate_row(
    kind: int, row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray
) -> float:
    """Return what the row reads at the pose [m] and write its tangent derivative into ``jacobian`` (6)."""
    if kind == GAP:
        return gap(row, rotation, translation, jacobian)
    return spot(row, rotation, translation, kind - SPOT_X, jacobian)


@compiled
def factor(matrix: FloatArray) -> float:
    """Replace a symmetric matrix by its lower Cholesky factor; return the ratio of smallest to largest pivot.

    A ratio of zero means: not positive definite, the contents are of no use.
    """
    n = matrix.shape[0]
    smallest = math.inf
    largest = 0.0
    for j in range(n):
        pivot = matrix[j, j]
        scale = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        largest = max(largest, scale)
        if not pivot > 0.0:
            return 0.0
        smallest = min(smallest, pivot)
        root = math.sqrt(pivot)
        matrix[j, j] = root
        for i in range(j + 1, n):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / root
    return smallest / largest


@compiled
def substitute(lower: FloatArray, vector: FloatArray) -> None:
    """Solve ``lower @ lower.T @ x = vector`` in place."""
    n = lower.shape[0]
    for i in range(n):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]
    for j in range(n):
        i = n - 1 - j
        for k in range(i + 1, n):
            vector[i] -= lower[k, i] * vector[k]
        vector[i] /= lower[i, i]


@compiled
def gauss_newton(  # noqa: C901  one loop over plain numbers, to be compiled
    kinds: IntArray,
    rows: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
    residuals: FloatArray,
    length: float,
    tolerance: float,
    iterations: int,
) -> int:
    """Move the pose (in place) to the weighted least-squares solution of one scan.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Geometry of each row, shape (m, P).
        values: Linearised readings [m], shape (m,).
        weights: Reciprocal variances of the readings [1/m^2], shape (m,).
        rotation: Start and result, shape (3, 3).
        translation: Start and result [m], shape (3,).
        jacobian: Result: derivatives of the rows at the solution, shape (m, 6).
        residuals: Result: reading minus prediction at the solution [m], shape (m,).
        length: Lever that makes a rotation comparable to a translation [m].
        tolerance: Largest last step [m] (rotations times ``length``) that counts as settled.
        iterations: Most iterations to spend.

    Returns:
        CONVERGED, NOT_CONVERGED or ILL_CONDITIONED.

    """
    m = kinds.shape[0]
    normal = np.empty((6, 6))
    step = np.empty(6)
    settled = False
    for _ in range(iterations):
        for r in range(m):
            residuals[r] = values[r] - evaluate_row(kinds[r], rows[r], rotation, translation, jacobian[r])
        if settled:
            return CONVERGED
        for i in range(6):
            step[i] = 0.0
            for j in range(i + 1):
                normal[i, j] = 0.0
        for r in range(m):
            for i in range(6):
                scaled = jacobian[r, i] if i < 3 else jacobian[r, i] / length  # noqa: PLR2004
                step[i] += weights[r] * scaled * residuals[r]
                for j in range(i + 1):
                    other = jacobian[r, j] if j < 3 else jacobian[r, j] / length  # noqa: PLR2004
                    normal[i, j] += weights[r] * scaled * other
        if not factor(normal) > SMALLEST_PIVOT_RATIO:
            return ILL_CONDITIONED
        substitute(normal, step)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(step[i]))
            if i >= 3:  # noqa: PLR2004
                step[i] /= length
        if not largest < math.inf:
            return NOT_CONVERGED
        apply_tangent(rotation, translation, step)
        orthonormalise(rotation)
        settled = largest < tolerance
    return NOT_CONVERGED
