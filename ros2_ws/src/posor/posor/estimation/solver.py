# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weighted Gauss-Newton on SE(3) for one scan.

The unknown is ``T_R_T``; the tangent is pinocchio's local one (``model.reading_rows``). Each iteration solves the
normal equations by a factorisation, which also shows whether the readings determine the pose.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.model.reading_rows import predict_readings, prepare_row, turn_row
from posor.numerics.compiled import in_place
from posor.numerics.matrix import factorise, normal_matrix, solve, store_factors
from posor.numerics.vector import ZERO_VECTOR, dot, move, orthonormalise, plus, theta_in_kernel, times, within, wrapped

if TYPE_CHECKING:
    from posor.estimation.workspace import Model
    from posor.numerics.vector import Vector

CONVERGED = 0
NOT_CONVERGED = 1
ILL_CONDITIONED = 2

LENGTH = 0.05  # lever [m] that makes a rotation comparable to a translation in the size of a step
EXACT = 1e-15  # converged where the next step would be below this [m], extrapolated from the shrinkage of the last one
TOLERANCE = 1e-9  # below this [m] also converged where a step is hardly smaller than the last: the rest is rounding
STALLED = 0.1  # a ratio of successive steps that counts as hardly smaller; assumed for the first step
SHARP = 1e-11  # after a last step below this [m] the derivatives before the step are right to 1e-9 of their size
ITERATIONS = 25
SINGULAR = 1e-10  # at a smaller pivot ratio (``numerics.matrix``) the readings do not determine the pose
TURN_TOLERANCE = 1e-14  # change of theta [rad] below which the lagging turn of the tilts has converged


@in_place
def _right_side(workspace: Any, count: int) -> tuple[Vector, Vector]:
    """Return ``J' W e`` of the first ``count`` rows: translation, rotation."""
    translation, rotation = ZERO_VECTOR, ZERO_VECTOR
    jacobian, weights, residuals = workspace.jacobian, workspace.weights, workspace.residuals
    for r in range(count):
        translation = plus(translation, times(residuals[r], times(weights[r], within(jacobian, r, 0))))
        rotation = plus(rotation, times(residuals[r], times(weights[r], within(jacobian, r, 3))))
    return translation, rotation


@in_place
def _largest(a: Vector) -> float:
    """Return the largest absolute value of three; infinite where one is not finite."""
    largest = max(abs(a[0]), abs(a[1]), abs(a[2]))
    return largest if math.isfinite(a[0] + a[1] + a[2]) else math.inf


@in_place
def iterate(workspace: Any, count: int, least_ratio: float) -> int:
    """Move the pose (in place) to the weighted least-squares solution of the first ``count`` rows.

    Rows, values and weights are read; jacobian and residuals at the solution, the sum of all steps, and the factors of
    the normal matrix are written. ``workspace``: record of dtype WORKSPACE; ``count``: how many rows are used;
    ``least_ratio``: smallest ratio of a pivot to its diagonal entry that counts as determined (``numerics.matrix``).
    Return CONVERGED, NOT_CONVERGED or ILL_CONDITIONED.
    """
    pose, jacobian, residuals, step_sum = workspace.pose, workspace.jacobian, workspace.residuals, workspace.step_sum
    for i in range(6):
        step_sum[i] = 0.0
    converged, previous = False, math.nan
    for _ in range(ITERATIONS):
        predict_readings(workspace.rows, count, pose, step_sum, residuals, jacobian)
        for r in range(count):
            residuals[r] = workspace.values[r] - residuals[r]
        factors, ratio = factorise(normal_matrix(jacobian, workspace.weights, count))
        if not ratio > least_ratio:
            return ILL_CONDITIONED
        if converged:
            store_factors(factors, workspace.factors)
            return CONVERGED
        v, w = _right_side(workspace, count)
        v, w = solve(factors, v, w)
        step = max(_largest(v), LENGTH * _largest(w))
        if not step < math.inf:
            return NOT_CONVERGED
        for i in range(3):
            step_sum[i] += v[i]
            step_sum[3 + i] += w[i]
        move(pose.rotation, pose.translation, v, w)
        orthonormalise(pose.rotation)
        shrinkage = min(1.0, step / previous) if previous > 0.0 else STALLED
        converged = step * shrinkage < EXACT or (step < TOLERANCE and shrinkage > STALLED)
        previous = step
        if converged and step < SHARP:
            for r in range(count):
                residuals[r] -= dot(within(jacobian, r, 0), v) + dot(within(jacobian, r, 3), w)
            store_factors(factors, workspace.factors)
            return CONVERGED
    return NOT_CONVERGED


@in_place
def solve_pose(workspace: Any, count: int, least_ratio: float, lag_theta: float) -> int:
    """Solve the first ``count`` rows from ``workspace.pose`` on; see ``iterate``.

    Where ``lag_theta`` is finite, the tilts are turned as at that theta [rad] (``TiltAngle.PREVIOUS_SCAN``).
    """
    turn = 0.0
    for _ in range(ITERATIONS):
        outcome = iterate(workspace, count, least_ratio)
        if outcome != CONVERGED or not math.isfinite(lag_theta):
            return outcome
        change = wrapped(lag_theta - theta_in_kernel(workspace.pose.rotation)) - turn
        if abs(change) < TURN_TOLERANCE:
            return outcome
        turn += change
        for r in range(count):
            turn_row(workspace.rows[r], turn)
    return NOT_CONVERGED


@in_place
def solve_start(model: Model, least_ratio: float) -> int:
    """Solve the readings of ``model.workspace`` from its pose on, with weights from the noise."""
    workspace = model.workspace[0]
    for r in range(workspace.reading_count):
        prepare_row(workspace.rows[r])
        workspace.weights[r] = 1.0 / workspace.variances[r]
    return iterate(workspace, workspace.reading_count, least_ratio)
