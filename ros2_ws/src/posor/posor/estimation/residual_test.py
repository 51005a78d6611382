"""Chi-square of the redundant readings, their whole uncertainty taken into account.

The residuals e of the fit lie, as far as no pose explains them, in the residual space (parity space) Z of the
readings, ``J' Z = 0``, which has as many directions as readings are redundant. There they have the covariance ``Z' (R +
S) Z``, so chi-square is ``u' (Z' (R + S) Z)^-1 u`` with ``u = Z' e`` (R random, S systematic covariance).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.numerics.cholesky import cholesky_factorise, solve_lower_triangular
from posor.numerics.compiled import inlined
from posor.numerics.symmetric import ZERO_VECTOR
from posor.numerics.vector import dot, within

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector


@inlined
def chi_square(workspace: Any) -> float:
    """Return the chi-square of the solution in the workspace, NaN where the residual space cannot be found."""
    m, redundant = workspace.reading_count, workspace.redundant_count
    space, components = workspace.residual_space, workspace.residual_components
    covariance, systematic = workspace.residual_covariance, workspace.systematic_readings
    if not _find_residual_space(workspace):
        return math.nan
    for t in range(redundant):
        components[t] = 0.0
        for s in range(t):
            covariance[t, s] = 0.0
        covariance[t, t] = 1.0
        for r in range(m):
            components[t] += space[t, r] * workspace.residuals[r]
            pushed = 0.0
            for q in range(workspace.first_correlated[r], workspace.end_correlated[r]):
                pushed += systematic[r, q] * space[t, q]
            for s in range(t + 1):
                covariance[t, s] += space[s, r] * pushed
    if not cholesky_factorise(covariance, redundant):
        return math.nan
    solve_lower_triangular(covariance, redundant, components)
    out = 0.0
    for t in range(redundant):
        out += components[t] * components[t]
    return out


@inlined
def _find_residual_space(workspace: Any) -> bool:
    """Write directions Z with ``J' Z = 0`` and ``Z' R Z = 1`` into ``residual_space``; return whether there are enough.

    The columns of ``R^-1 (R - J (J' R^-1 J)^-1 J')`` are such directions; the pivoted Cholesky factorisation selects
    those that differ most.
    """
    jacobian, weights, gain, space = workspace.jacobian, workspace.weights, workspace.gain, workspace.residual_space
    m = workspace.reading_count
    for t in range(workspace.redundant_count):
        largest, pivot, v, w = 0.0, 0, ZERO_VECTOR, ZERO_VECTOR
        for r in range(m):
            own_v, own_w = within(jacobian, r, 0), within(jacobian, r, 3)
            rest = 1.0 - _explained(own_v, own_w, gain, r)
            for s in range(t):
                rest -= space[s, r] * space[s, r] / weights[r]
            if rest > largest:
                largest, pivot, v, w = rest, r, own_v, own_w
        if not largest > 0.0:
            return False
        weight = weights[pivot]
        scale = math.sqrt(weight / largest)
        for r in range(m):
            rest = (1.0 if r == pivot else 0.0) - _explained(v, w, gain, r)
            for s in range(t):
                rest -= space[s, r] * space[s, pivot] / weight
            space[t, r] = scale * rest
    return True


@inlined
def _explained(v: Vector, w: Vector, gain: FloatArray, r: int) -> float:
    """Return an entry of ``J G``: how a reading with derivatives v, w follows a change of reading r."""
    return dot(v, within(gain, r, 0)) + dot(w, within(gain, r, 3))
