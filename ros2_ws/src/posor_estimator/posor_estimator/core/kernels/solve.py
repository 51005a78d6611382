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
from posor_estimator.core.kernels.gap import PREPARED
from posor_estimator.core.kernels.rows import evaluate, prepare_rows
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
def normal_matrix(jacobian: FloatArray, weights: FloatArray, count: int, out: FloatArray) -> None:
    """Write the lower triangle of ``J' W J`` of the first ``count`` rows into ``out`` (6, 6)."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for r in range(count):
                total += weights[r] * jacobian[r, i] * jacobian[r, j]
            out[i, j] = total


@compiled
def newton(
    kinds: IntArray,
    rows: FloatArray,
    prepared: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    count: int,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
    residuals: FloatArray,
    moved: FloatArray,
    normal: FloatArray,
    step: FloatArray,
    least_share: float,
) -> int:
    """Move the pose (in place) to the weighted least-squares solution of the first ``count`` rows.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Parameters of each row, shape (m, width).
        prepared: What of the rows does not depend on the pose, see ``kernels.rows``, shape (m, PREPARED).
        values: Linearised readings [m], shape (m,).
        weights: Reciprocal variances of the readings [1/m^2], shape (m,).
        count: How many rows are used.
        rotation: Start and result, shape (3, 3).
        translation: Start and result [m], shape (3,).
        jacobian: Result: derivatives of the rows at the solution, shape (m, 6).
        residuals: Result: reading minus prediction at the solution [m], shape (m,).
        moved: Result: sum of all steps, shape (6,).
        normal: Room, shape (6, 6).
        step: Room, shape (6,).
        least_share: Share of an unknown that the others must leave unexplained (``kernels.cholesky``).

    Returns:
        CONVERGED, NOT_CONVERGED or ILL_CONDITIONED.

    """
    for i in range(6):
        moved[i] = 0.0
    settled = False
    for _ in range(ITERATIONS):
        evaluate(kinds, rows, prepared, count, rotation, translation, moved, residuals, jacobian)
        for r in range(count):
            residuals[r] = values[r] - residuals[r]
        if settled:
            return CONVERGED
        normal_matrix(jacobian, weights, count, normal)
        for i in range(6):
            step[i] = 0.0
            for r in range(count):
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
    """Do ``newton`` for all rows, none of them prepared, with room of its own."""
    prepared = np.empty((kinds.shape[0], PREPARED))
    prepare_rows(kinds, rows, kinds.shape[0], prepared)
    return newton(
        kinds,
        rows,
        prepared,
        values,
        weights,
        kinds.shape[0],
        rotation,
        translation,
        jacobian,
        residuals,
        moved,
        np.empty((6, 6)),
        np.empty(6),
        least_share,
    )
