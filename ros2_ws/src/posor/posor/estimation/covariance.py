# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Covariance of a solution: random and systematic.

With the rows' derivatives J, the readings' variances R (random, diagonal) and G = (J' R^-1 J)^-1 J' R^-1:

* random covariance ``(J' R^-1 J)^-1`` (JCGM 100, 5.1 for a linear model of uncorrelated readings);
* systematic covariance ``G S G'`` where S is the readings' covariance from the calibration parameters
  (JCGM 100, 5.2: parameters shared by readings correlate them). Each parameter is a sum of standard normal factors: one
  of its own where the calibration states only its standard uncertainty, all those of its block where it states a
  covariance (``calibration.parameter_covariance``). Then S = B B', with B the derivatives of the readings with respect
  to the factors. A factor that reaches only one reading adds to the variance of that reading and needs no column of B.
  Which products are needed is found once for the selected rows and holds as long as the scans read the same rows.
  A shared term of the calibration file (``calibration.shared_terms``) is one more factor; its effect on the pose is
  kept beside the sum, because the chain adds the effects of all joints before it squares them.

Both are turned from the local tangent into ROS order: x, y, z, about X, Y, Z along the axes of R, the small turn
applied on the parent's side at the origin of T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.model.reading_rows import PARAMETERS
from posor.numerics.compiled import in_place
from posor.numerics.matrix import (
    add_outer,
    fill_upper_triangle,
    invert,
    load_factors,
    multiply_vector,
    product_transposed,
)
from posor.numerics.vector import ZERO_MATRIX, ZERO_VECTOR, applied, matrix, plus, put, row_times, times, within

if TYPE_CHECKING:
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray
    from posor.numerics.matrix import Symmetric
    from posor.numerics.vector import Matrix


@in_place
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


@in_place
def _rotated_block(block: Matrix, axes: Matrix) -> Matrix:
    """Return ``R block R'``, R the rotation whose rows are ``axes``."""
    half = row_times(axes[0], block), row_times(axes[1], block), row_times(axes[2], block)
    return product_transposed(half, axes)


@in_place
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


@in_place
def _parameter_of(model: Model, reading: int, k: int) -> int:
    """Return the parameter of derivative k of a reading, first those of its row; -1: none."""
    if k < PARAMETERS:
        return int(model.row_parameters[model.workspace[0].active_rows[reading], k])
    return int(model.linearisation_parameters[reading, k - PARAMETERS])


@in_place
def _uncertain_parameter_of(model: Model, reading: int, k: int) -> int:
    """Return the same, or -1 where the parameter has no uncertainty of its own."""
    parameter = _parameter_of(model, reading, k)
    if parameter >= 0 and model.parameter_factors[parameter].count == 0:
        parameter = -1
    return parameter


@in_place
def _derivative_of(model: Model, reading: int, k: int) -> int:
    """Return the index of derivative k of a reading in ``derivatives``."""
    if k < PARAMETERS:
        return reading * PARAMETERS + k
    columns = model.linearisation_parameters.shape[1]
    return int(model.workspace[0].reading_count * PARAMETERS + reading * columns + k - PARAMETERS)


@in_place
def find_contributions(model: Model) -> None:  # noqa: C901  loops over plain numbers
    """List the derivatives with uncertainty, what each contributes to, and the correlated readings."""
    workspace = model.workspace[0]
    m, length = workspace.reading_count, PARAMETERS + model.linearisation_parameters.shape[1]
    for f in range(model.factor_uses.shape[0]):
        model.factor_uses[f].uses = 0
        model.factor_uses[f].column = -1
    for r in range(m):
        for k in range(length):
            parameter = _uncertain_parameter_of(model, r, k)
            if parameter >= 0:
                use = model.factor_uses[model.parameter_factors[parameter].first_factor]
                use.uses += 1
                use.last_reading = r
    for r in range(m):
        for column in range(model.effects.shape[1]):
            model.effects[r, column] = 0.0
    workspace.contribution_count = 0
    workspace.block_count = 0
    next_coefficient = _add_contributions(model, False, 0)  # noqa: FBT003  kernels take no keywords
    workspace.alone_count = workspace.contribution_count
    _add_contributions(model, True, next_coefficient)  # noqa: FBT003
    for r in range(m):
        workspace.first_correlated[r], workspace.end_correlated[r] = r, r + 1
        for b in range(workspace.block_count):
            block = model.blocks[b]
            if block.first_reading <= r <= block.last_reading:
                workspace.first_correlated[r] = min(workspace.first_correlated[r], block.first_reading)
                workspace.end_correlated[r] = max(workspace.end_correlated[r], block.last_reading + 1)
        everywhere = workspace.unmeasured != 0 or workspace.has_common_effects == 1
        if everywhere or model.shared_readings.shape[1] > 0:  # see estimation.linearise, estimation.ambient
            workspace.first_correlated[r], workspace.end_correlated[r] = 0, m


@in_place
def _add_contributions(model: Model, shared: bool, next_coefficient: int) -> int:  # noqa: FBT001  kernels take no keywords
    """Add the contributions of factors that reach one reading, or of those that are shared."""
    workspace = model.workspace[0]
    next_column = 0
    for r in range(workspace.reading_count):
        for k in range(PARAMETERS + model.linearisation_parameters.shape[1]):
            parameter = _uncertain_parameter_of(model, r, k)
            if parameter < 0:
                continue
            factors = model.parameter_factors[parameter]
            use = model.factor_uses[factors.first_factor]
            if shared == (factors.count == 1 and use.uses == 1):
                continue
            contribution = model.contributions[workspace.contribution_count]
            contribution.reading, contribution.column = r, -1
            contribution.count, contribution.assigns = factors.count, 0
            contribution.derivative = _derivative_of(model, r, k)
            if shared:
                if use.column < 0:
                    use.column = next_column
                    next_column += factors.count
                    _extend_blocks(model, use, r, factors.count)
                contribution.column = use.column
                if model.effects[r, use.column] == 0.0:
                    contribution.assigns = 1
                    model.effects[r, use.column] = 1.0
            for f in range(factors.count):
                model.contribution_coefficients[next_coefficient + f] = model.coefficients[factors.begin + f]
            next_coefficient += factors.count
            workspace.contribution_count += 1
    return next_coefficient


@in_place
def _extend_blocks(model: Model, use: Any, reading: int, count: int) -> None:
    """Add new columns to the last block where they reach the same readings, else to a new block."""
    workspace = model.workspace[0]
    found = workspace.block_count
    if (
        found == 0
        or model.blocks[found - 1].first_reading != reading
        or model.blocks[found - 1].last_reading != use.last_reading
    ):
        block = model.blocks[found]
        block.column, block.count = use.column, 0
        block.first_reading, block.last_reading = reading, use.last_reading
        found += 1
        workspace.block_count = found
    model.blocks[found - 1].count += count


@in_place
def add_systematic_covariance(model: Model) -> None:  # noqa: C901, PLR0912  loops over plain numbers
    """Add the readings' covariance from the calibration parameters to ``systematic_readings`` [m^2].

    ``derivatives`` hold the derivatives of the predictions minus the readings at the pose.
    """
    workspace = model.workspace[0]
    out = workspace.systematic_readings
    total, reading = 0.0, -1
    for c in range(workspace.alone_count):
        contribution = model.contributions[c]
        if contribution.reading != reading:
            if reading >= 0:
                out[reading, reading] += total
            total, reading = 0.0, contribution.reading
        effect = model.derivatives[contribution.derivative] * model.contribution_coefficients[c]
        total += effect * effect
    if reading >= 0:
        out[reading, reading] += total
    first = workspace.alone_count
    for c in range(workspace.alone_count, workspace.contribution_count):
        contribution = model.contributions[c]
        derivative = model.derivatives[contribution.derivative]
        r, column = contribution.reading, contribution.column
        if contribution.assigns:
            for f in range(contribution.count):
                model.effects[r, column + f] = derivative * model.contribution_coefficients[first + f]
        else:
            for f in range(contribution.count):
                model.effects[r, column + f] += derivative * model.contribution_coefficients[first + f]
        first += contribution.count
    for b in range(workspace.block_count):
        block = model.blocks[b]
        for i in range(block.first_reading, block.last_reading + 1):
            for j in range(block.first_reading, i + 1):
                total = _row_product(model.effects, i, j, block.column, block.count)
                out[i, j] += total
                if i != j:
                    out[j, i] += total


@in_place
def _row_product(effects: FloatArray, i: int, j: int, first: int, count: int) -> float:
    """Return the scalar product of parts of two rows; four sums side by side, since each waits for its last term."""
    a = b = c = d = 0.0
    whole = first + count - count % 4
    for k in range(first, whole, 4):
        a += effects[i, k] * effects[j, k]
        b += effects[i, k + 1] * effects[j, k + 1]
        c += effects[i, k + 2] * effects[j, k + 2]
        d += effects[i, k + 3] * effects[j, k + 3]
    for k in range(whole, first + count):
        a += effects[i, k] * effects[j, k]
    return (a + b) + (c + d)


@in_place
def add_shared_terms(model: Model) -> None:
    """Write ``shared_readings`` [m] and add their covariance to ``systematic_readings``.

    Without ``shared_coefficients`` (sensors in plain Python) the caller has done both.
    """
    workspace, by_term = model.workspace[0], model.shared_readings
    m, terms = workspace.reading_count, by_term.shape[1]
    if model.shared_coefficients.shape[0] == 0:
        return
    for r in range(m):
        for t in range(terms):
            by_term[r, t] = 0.0
        for k in range(PARAMETERS + model.linearisation_parameters.shape[1]):
            parameter = _parameter_of(model, r, k)
            if parameter >= 0:  # ``derivatives`` are those of predictions minus readings
                derivative = model.derivatives[_derivative_of(model, r, k)]
                for t in range(terms):
                    by_term[r, t] -= derivative * model.shared_coefficients[parameter, t]
    for r in range(m):
        for q in range(m):
            for t in range(terms):
                workspace.systematic_readings[r, q] += by_term[r, t] * by_term[q, t]


@in_place
def write_shared_effects(model: Model, out: FloatArray) -> None:
    """Write the change of the pose by one standard uncertainty of each shared term, ROS order, (terms, 6)."""
    workspace, by_term = model.workspace[0], model.shared_readings
    axes = matrix(workspace.pose.rotation, 0)
    for t in range(by_term.shape[1]):
        v, w = ZERO_VECTOR, ZERO_VECTOR
        for r in range(workspace.reading_count):
            v = plus(v, times(by_term[r, t], within(workspace.gain, r, 0)))
            w = plus(w, times(by_term[r, t], within(workspace.gain, r, 3)))
        put(out, t, 0, applied(axes, v))
        put(out, t, 3, applied(axes, w))
