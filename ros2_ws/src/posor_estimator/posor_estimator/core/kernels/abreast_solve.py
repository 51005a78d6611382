"""Gauss-Newton for a scan of each of eight POSORs, see ``kernels.abreast``: each ends where it would end alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.blocks import factor, keep_factors, normal_matrix, solve
from posor_estimator.core.kernels.eight import anywhere, chosen, everywhere, opposite
from posor_estimator.core.kernels.gap import gap, gap_parameters
from posor_estimator.core.kernels.reshaped import part
from posor_estimator.core.kernels.rows import GAP, SECOND, evaluate_spot, spot_by_parameters
from posor_estimator.core.kernels.solve import ITERATIONS, SHARP, STALLED, follow, has_settled, right_side, size_of
from posor_estimator.core.kernels.tables import (
    BY_ROW,
    FACTORS,
    JACOBIAN,
    KINDS,
    LINES,
    PREPARED,
    RESIDUALS,
    ROTATION,
    ROWS,
    TRANSLATION,
    VALUES,
    WEIGHTS,
    line,
    table,
)
from posor_estimator.core.kernels.vector import SERIES_BELOW, dot, move_by, orthonormalise, series

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

OF_A_ROW, OF_ALL = 7, 21
"""Room for a step: numbers for each reading, and beside those."""


@inlined
def evaluate_abreast(
    kinds: IntArray,
    rows: FloatArray,
    prepared: FloatArray,
    m: int,
    rotation: FloatArray,
    translation: FloatArray,
    predicted: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Do ``kernels.rows.evaluate`` for rows of gap probes and spots."""
    for r in range(m):
        if kinds[r] == GAP:
            predicted[r] = gap(rows, r, prepared, rotation, translation, jacobian)
        elif kinds[r] != SECOND:
            evaluate_spot(kinds[r], rows, r, prepared, rotation, translation, predicted, jacobian)


@inlined
def by_parameters_abreast(
    places: IntArray, ints: IntArray, floats: FloatArray, m: int, rotation: FloatArray, translation: FloatArray
) -> None:
    """Do ``kernels.rows.by_parameters`` for rows of gap probes and spots; BY_ROW is written."""
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    by_row = table(places, floats, BY_ROW)
    for r in range(m):
        if kinds[r] == GAP:
            gap_parameters(rows, r, prepared, rotation, translation, by_row)
        elif kinds[r] != SECOND:
            spot_by_parameters(kinds[r], rows, r, prepared, rotation, translation, by_row)


@inlined
def keep(condition: bool, numbers: FloatArray, kept: FloatArray, count: int) -> None:  # noqa: FBT001  no keywords
    """Keep the first ``count`` numbers of those for which the condition holds."""
    for k in range(count):
        kept[k] = chosen(condition, numbers[k], kept[k])


@inlined
def newton_abreast(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    m: int,
    least_share: float,
    trial: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
) -> bool:
    """Do ``kernels.solve.newton``; return whether all have converged.

    Args:
        places: See ``kernels.tables``.
        ints: Of any of the POSORs.
        floats: Eights. ROTATION and TRANSLATION hold the starts; JACOBIAN, residuals and FACTORS are written, as at
            each solution.
        m: How many readings there are.
        least_share: See ``newton``, of each.
        trial: Room for a step, 7 m + 21 eights.
        rotation: Solutions to write, shape (3, 3).
        translation: Solutions to write, shape (3,).

    """
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    values, weights = line(places, floats, LINES, VALUES), line(places, floats, LINES, WEIGHTS)
    at, shift = table(places, floats, ROTATION), line(places, floats, TRANSLATION, 0)
    jacobian, residuals = part(trial, 0, m, 6), trial[6 * m : OF_A_ROW * m]
    factors_here = trial[OF_A_ROW * m : OF_A_ROW * m + OF_ALL]
    sought = least_share > 0.0
    settled, before = opposite(sought), math.nan * least_share
    for _ in range(ITERATIONS):
        evaluate_abreast(kinds, rows, prepared, m, at, shift, residuals, jacobian)
        for r in range(m):
            residuals[r] = values[r] - residuals[r]
        factors, weakest = factor(normal_matrix(jacobian, weights, m))
        keep_factors(factors, part(factors_here, 0, 7, 3))
        v, w = right_side(jacobian, weights, residuals, m)
        v, w = solve(factors, v, w)
        largest, angle_squared = size_of(v, w), dot(w, w)
        if not everywhere((weakest > least_share) & (largest < math.inf) & (angle_squared < SERIES_BELOW)):
            return False
        ended = sought & settled
        if anywhere(ended):
            _keep_all(ended, places, floats, m, trial, rotation, translation)
            sought &= opposite(ended)
            if not anywhere(sought):
                return True
        move_by(at, shift, v, w, series(angle_squared))
        orthonormalise(at)
        rate = chosen(before > 0.0, min(1.0, largest / before), STALLED)
        settled = has_settled(largest, rate)
        before = largest
        ended = sought & settled & (largest < SHARP)
        if anywhere(ended):
            follow(jacobian, residuals, m, v, w)
            _keep_all(ended, places, floats, m, trial, rotation, translation)
            sought &= opposite(ended)
            if not anywhere(sought):
                return True
    return False


@inlined
def _keep_all(
    condition: bool,  # noqa: FBT001  kernels take no keywords
    places: IntArray,
    floats: FloatArray,
    m: int,
    trial: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
) -> None:
    """Take what stands in ``trial``, ROTATION and TRANSLATION for the solution where the condition holds."""
    at, shift = table(places, floats, ROTATION), line(places, floats, TRANSLATION, 0)
    jacobian, kept = table(places, floats, JACOBIAN), table(places, floats, FACTORS)
    residuals = line(places, floats, LINES, RESIDUALS)
    for r in range(m):
        keep(condition, trial[6 * r : 6 * r + 6], jacobian[r], 6)
    keep(condition, trial[6 * m : OF_A_ROW * m], residuals, m)
    for r in range(7):
        keep(condition, trial[OF_A_ROW * m + 3 * r : OF_A_ROW * m + 3 * r + 3], kept[r], 3)
    for i in range(3):
        keep(condition, at[i], rotation[i], 3)
    keep(condition, shift, translation, 3)
