"""Weighted Gauss-Newton on SE(3) for one scan.

The unknown is ``T_R_T``; the tangent is pinocchio's local one (see the package's docstring). Each iteration solves the
normal equations by a Cholesky factorisation, which also tells whether the readings determine the pose at all.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.cholesky import factor, substitute
from posor_estimator.core.kernels.rows import evaluate_row
from posor_estimator.core.kernels.vector import apply_tangent, orthonormalise

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

CONVERGED = 0
NOT_CONVERGED = 1
ILL_CONDITIONED = 2

LENGTH = 0.05
"""Lever [m] that makes a rotation comparable to a translation where the size of a step is judged."""
TOLERANCE = 1e-9
"""A last step below this [m] leaves an error of about its square over LENGTH, far below a picometre."""
ITERATIONS = 25


@compiled
def normal_matrix(jacobian: FloatArray, weights: FloatArray, out: FloatArray) -> None:
    """Write the lower triangle of ``J' W J`` into ``out`` (6, 6)."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for r in range(weights.shape[0]):
                total += weights[r] * jacobian[r, i] * jacobian[r, j]
            out[i, j] = total


@compiled
def gauss_newton(
    kinds: IntArray,
    rows: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
    residuals: FloatArray,
    moved: FloatArray,
    least_share: float,
) -> int:
    """Move the pose (in place) to the weighted least-squares solution of one scan.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Parameters of each row, shape (m, width).
        values: Linearised readings [m], shape (m,).
        weights: Reciprocal variances of the readings [1/m^2], shape (m,).
        rotation: Start and result, shape (3, 3).
        translation: Start and result [m], shape (3,).
        jacobian: Result: derivatives of the rows at the solution, shape (m, 6).
        residuals: Result: reading minus prediction at the solution [m], shape (m,).
        moved: Result: sum of all steps, shape (6,).
        least_share: Share of an unknown that the others must leave unexplained (``kernels.cholesky``).

    Returns:
        CONVERGED, NOT_CONVERGED or ILL_CONDITIONED.

    """
    normal = np.empty((6, 6))
    step = np.empty(6)
    for i in range(6):
        moved[i] = 0.0
    settled = False
    for _ in range(ITERATIONS):
        for r in range(kinds.shape[0]):
            predicted = evaluate_row(kinds[r], rows[r], rotation, translation, moved, jacobian[r])
            residuals[r] = values[r] - predicted
        if settled:
            return CONVERGED
        normal_matrix(jacobian, weights, normal)
        for i in range(6):
            step[i] = 0.0
            for r in range(kinds.shape[0]):
                step[i] += weights[r] * jacobian[r, i] * residuals[r]
        if not factor(normal) > least_share:
            return ILL_CONDITIONED
        substitute(normal, step)
        largest = 0.0
        for i in range(6):
            if not math.isfinite(step[i]):
                return NOT_CONVERGED
            largest = max(largest, abs(step[i]) * (1.0 if i < 3 else LENGTH))  # noqa: PLR2004  translation, then rotation
            moved[i] += step[i]
        apply_tangent(rotation, translation, step)
        orthonormalise(rotation)
        settled = largest < TOLERANCE
    return NOT_CONVERGED
