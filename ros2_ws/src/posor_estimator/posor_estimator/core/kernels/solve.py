"""Weighted Gauss-Newton on SE(3) for one scan.

The unknown is ``T_R_T``; the tangent is pinocchio's local one (see the package's docstring). Each iteration solves the
normal equations by a factorisation, which also tells whether the readings determine the pose at all.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled, inlined
from posor_estimator.core.kernels.blocks import NOTHING, factor, keep_factors, normal_matrix, solve
from posor_estimator.core.kernels.eight import chosen
from posor_estimator.core.kernels.gap import PREPARED
from posor_estimator.core.kernels.rows import evaluate, prepare_rows
from posor_estimator.core.kernels.vector import dot, move, orthonormalise, plus, times, within

if TYPE_CHECKING:
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray, IntArray

CONVERGED = 0
NOT_CONVERGED = 1
ILL_CONDITIONED = 2

LENGTH = 0.05
"""Lever [m] that makes a rotation comparable to a translation where the size of a step is judged."""
EXACT = 1e-15
"""The solution is found where the next step would be below this [m], going by how much the last one has shrunk."""
TOLERANCE = 1e-9
"""Below this [m] it is also found where a step is not much smaller than the former: rounding makes up the rest."""
STALLED = 0.1
"""What is not much smaller; of the first step it is not known, and taken to be this."""
SHARP = 1e-11
"""After a last step below this [m] the derivatives are those before it, to 1e-9 of their size or less."""
ITERATIONS = 25


@inlined
def right_side(jacobian: FloatArray, weights: FloatArray, residuals: FloatArray, count: int) -> tuple[Vector, Vector]:
    """Return ``J' W e`` of the first ``count`` rows: translation, rotation."""
    translation, rotation = NOTHING, NOTHING
    for r in range(count):
        translation = plus(translation, times(residuals[r], times(weights[r], within(jacobian, r, 0))))
        rotation = plus(rotation, times(residuals[r], times(weights[r], within(jacobian, r, 3))))
    return translation, rotation


@inlined
def largest_of(a: Vector) -> float:
    """Return the largest absolute value of three; infinite where one is no number."""
    largest = max(abs(a[0]), abs(a[1]))
    largest = max(largest, abs(a[2]))
    return chosen(abs(a[0] + a[1] + a[2]) < math.inf, largest, math.inf)


@inlined
def size_of(v: Vector, w: Vector) -> float:
    """Return the size of a step [m]; infinite where one of its numbers is none."""
    return max(largest_of(v), LENGTH * largest_of(w))


@inlined
def has_settled(largest: float, rate: float) -> bool:
    """Return whether the pose is found after a step of this size [m], which has shrunk to ``rate`` of the former."""
    return (largest * rate < EXACT) | ((largest < TOLERANCE) & (rate > STALLED))


@inlined
def follow(jacobian: FloatArray, residuals: FloatArray, count: int, v: Vector, w: Vector) -> None:
    """Take what a last step explains off the residuals of the first ``count`` rows, by their derivatives."""
    for r in range(count):
        residuals[r] -= dot(within(jacobian, r, 0), v) + dot(within(jacobian, r, 3), w)


@inlined
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
    kept: FloatArray,
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
        kept: Result: factors of the normal matrix at the solution (``kernels.blocks.keep_factors``), shape (7, 3).
        least_share: Share of an unknown that the others must leave unexplained (``kernels.blocks``).

    Returns:
        CONVERGED, NOT_CONVERGED or ILL_CONDITIONED.

    """
    for i in range(6):
        moved[i] = 0.0
    settled, before = False, math.nan
    for _ in range(ITERATIONS):
        evaluate(kinds, rows, prepared, count, rotation, translation, moved, residuals, jacobian)
        for r in range(count):
            residuals[r] = values[r] - residuals[r]
        factors, weakest = factor(normal_matrix(jacobian, weights, count))
        if not weakest > least_share:
            return ILL_CONDITIONED
        if settled:
            keep_factors(factors, kept)
            return CONVERGED
        v, w = right_side(jacobian, weights, residuals, count)
        v, w = solve(factors, v, w)
        largest = size_of(v, w)
        if not largest < math.inf:
            return NOT_CONVERGED
        for i in range(3):
            moved[i] += v[i]
            moved[3 + i] += w[i]
        move(rotation, translation, v, w)
        orthonormalise(rotation)
        rate = min(1.0, largest / before) if before > 0.0 else STALLED
        settled = has_settled(largest, rate)
        before = largest
        if settled and largest < SHARP:
            follow(jacobian, residuals, count, v, w)
            keep_factors(factors, kept)
            return CONVERGED
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
        np.empty((7, 3)),
        least_share,
    )
