"""Rows: one scalar reading each, of any kind, with one way to evaluate them all.

What of a row does not depend on the pose is prepared once (``prepare_row``); a diode's two rows, where they stand side
by side, are evaluated as one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled, in_place, inlined
from posor_estimator.core.kernels.gap import PREPARED, gap, gap_parameters, prepare_gap
from posor_estimator.core.kernels.ring import prepare_ring, ring_gap, ring_parameters
from posor_estimator.core.kernels.spot import PARAMETERS as SPOT_PARAMETERS
from posor_estimator.core.kernels.spot import meet, prepare_spot, spot_parameters, spot_tangent

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

GAP = 0
SPOT_X = 1
SPOT_Y = 2
RING = 3
AFFINE = 4
"""A reading known by its value and derivative at one pose: parameters h, dh/dtangent (1 + 6), see ``evaluate``."""
SPOT = 5
"""Row r and the next are x and y of one spot; made of SPOT_X and SPOT_Y by ``pair_spots``, SECOND is the next."""
SECOND = 6

AFFINE_PARAMETERS = 7


@in_place
def prepare_row(kind: int, rows: FloatArray, r: int, prepared: FloatArray) -> None:
    """Write what of row r does not depend on the pose into that of ``prepared`` (m, PREPARED)."""
    if kind == GAP:
        prepare_gap(rows, r, prepared)
    elif kind in (SPOT_X, SPOT_Y, SPOT, SECOND):
        prepare_spot(rows, r, prepared)
    elif kind == RING:
        prepare_ring(r, prepared)


@in_place
def prepare_rows(kinds: IntArray, rows: FloatArray, count: int, prepared: FloatArray) -> None:
    """Do ``prepare_row`` for the first ``count`` rows."""
    for r in range(count):
        prepare_row(kinds[r], rows, r, prepared)


@in_place
def turn_row(kind: int, turn: float, rows: FloatArray, r: int, prepared: FloatArray) -> None:
    """Turn what row r has fixed in the target by an angle [rad] about Z of T; rings and affine rows stay."""
    if kind == GAP:
        rows[r, 11] = turn
    elif kind in (SPOT_X, SPOT_Y, SPOT, SECOND):
        rows[r, 15] = turn
    prepare_row(kind, rows, r, prepared)


@in_place
def pair_spots(kinds: IntArray, rows: FloatArray, count: int) -> None:
    """Mark, in ``kinds``, which of the first ``count`` rows are x and y of one spot, so that it is found once."""
    for r in range(count - 1):
        if kinds[r] == SPOT_X and kinds[r + 1] == SPOT_Y:
            same = True
            for k in range(SPOT_PARAMETERS):
                same = same and rows[r, k] == rows[r + 1, k]
            if same:
                kinds[r], kinds[r + 1] = SPOT, SECOND


@inlined
def evaluate(
    kinds: IntArray,
    rows: FloatArray,
    prepared: FloatArray,
    count: int,
    rotation: FloatArray,
    translation: FloatArray,
    moved: FloatArray,
    predicted: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write what the first ``count`` rows read at a pose, and the tangent derivatives, into the last two arrays.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Parameters of each row, shape (m, width).
        prepared: See ``prepare_row``, shape (m, PREPARED).
        count: How many rows to evaluate.
        rotation: R_R_T, shape (3, 3).
        translation: Of ``T_R_T`` [m], shape (3,).
        moved: Sum of the tangent steps since the pose at which affine rows were expanded, shape (6,): they read ``h +
            dh.moved``, which is exact once the expansion has been repeated until ``moved`` stays zero.
        predicted: Readings to write, shape (m,).
        jacobian: Their derivatives to write, shape (m, 6).

    """
    for r in range(count):
        kind = kinds[r]
        if kind == GAP:
            predicted[r] = gap(rows, r, prepared, rotation, translation, jacobian)
        elif kind in (SPOT, SPOT_X, SPOT_Y):
            evaluate_spot(kind, rows, r, prepared, rotation, translation, predicted, jacobian)
        elif kind == RING:
            predicted[r] = ring_gap(rows, r, prepared, rotation, translation, jacobian)
        elif kind == AFFINE:
            reading = rows[r, 0]
            for i in range(6):
                jacobian[r, i] = rows[r, 1 + i]
                reading += rows[r, 1 + i] * moved[i]
            predicted[r] = reading


@inlined
def evaluate_spot(
    kind: int,
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    predicted: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Do ``evaluate`` for row r, of kind SPOT_X or SPOT_Y, or for it and the next, of kind SPOT."""
    x, y, along, for_x, for_y = meet(rows, r, prepared, rotation, translation)
    if kind != SPOT_Y:
        predicted[r] = x
        spot_tangent(rows, r, prepared, rotation, along, for_x, jacobian, r)
    if kind != SPOT_X:
        to = r + 1 if kind == SPOT else r
        predicted[to] = y
        spot_tangent(rows, r, prepared, rotation, along, for_y, jacobian, to)


@inlined
def by_parameters(
    kinds: IntArray,
    rows: FloatArray,
    prepared: FloatArray,
    count: int,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write the derivatives of the first ``count`` rows with respect to their own parameters into ``jacobian``.

    Its shape is (m, width); what a row's kind has no parameter for is left as it is. Others as ``evaluate``.
    """
    for r in range(count):
        kind = kinds[r]
        if kind == GAP:
            gap_parameters(rows, r, prepared, rotation, translation, jacobian)
        elif kind in (SPOT, SPOT_X, SPOT_Y):
            spot_by_parameters(kind, rows, r, prepared, rotation, translation, jacobian)
        elif kind == RING:
            ring_parameters(rows, r, prepared, rotation, translation, jacobian)


@inlined
def spot_by_parameters(
    kind: int,
    rows: FloatArray,
    r: int,
    prepared: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Do ``by_parameters`` for row r, of kind SPOT_X or SPOT_Y, or for it and the next, of kind SPOT."""
    x, y, along, for_x, for_y = meet(rows, r, prepared, rotation, translation)
    if kind != SPOT_Y:
        spot_parameters(rows, r, prepared, rotation, x, y, along, for_x, jacobian, r)
    if kind != SPOT_X:
        to = r + 1 if kind == SPOT else r
        spot_parameters(rows, r, prepared, rotation, x, y, along, for_y, jacobian, to)


@compiled
def evaluate_row(
    kind: int,
    row: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    moved: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Return what one row (width,) reads at a pose and write its tangent derivative into ``jacobian`` (6)."""
    kinds, rows, prepared = _alone(kind, row)
    reading, derivative = np.empty(1), np.empty((1, 6))
    evaluate(kinds, rows, prepared, 1, rotation, translation, moved, reading, derivative)
    jacobian[:] = derivative[0]
    return float(reading[0])


@compiled
def row_parameters(
    kind: int, row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray
) -> None:
    """Write the derivative of one row's reading with respect to its own parameters into ``jacobian`` (width)."""
    kinds, rows, prepared = _alone(kind, row)
    derivative = np.zeros((1, jacobian.shape[0]))
    by_parameters(kinds, rows, prepared, 1, rotation, translation, derivative)
    jacobian[:] = derivative[0]


@compiled
def _alone(kind: int, row: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return kinds, rows and what is prepared of one row as of a whole scan."""
    kinds, rows, prepared = np.empty(1, dtype=np.int64), np.empty((1, row.shape[0])), np.empty((1, PREPARED))
    kinds[0] = kind
    rows[0, :] = row
    prepare_row(kind, rows, 0, prepared)
    return kinds, rows, prepared


@compiled
def evaluate_all(
    kinds: IntArray,
    pool: FloatArray,
    chosen: IntArray,
    rotations: FloatArray,
    translations: FloatArray,
    out: FloatArray,
) -> None:
    """Write what the chosen rows (n, m) of a pool read at n poses into ``out`` (n, m) [m]; no affine rows."""
    m = chosen.shape[1]
    here = np.full(m, -1, dtype=np.int64)
    kinds_here, rows, prepared = np.empty(m, dtype=np.int64), np.empty((m, pool.shape[1])), np.empty((m, PREPARED))
    still = np.zeros(6)
    jacobian = np.empty((m, 6))
    for n in range(chosen.shape[0]):
        if not are_here(chosen, n, here):
            take_rows(kinds, pool, chosen, n, here, kinds_here, rows, prepared)
        evaluate(kinds_here, rows, prepared, m, rotations[n], translations[n], still, out[n], jacobian)


@inlined
def are_here(chosen: IntArray, n: int, here: IntArray) -> bool:
    """Return whether rows ``chosen[n]`` of a pool are those that have been taken last (``here``, shape (m,))."""
    same = True
    for r in range(here.shape[0]):
        same &= here[r] == chosen[n, r]
    return same


@in_place
def take_rows(
    pool_kinds: IntArray,
    pool: FloatArray,
    chosen: IntArray,
    n: int,
    here: IntArray,
    kinds: IntArray,
    rows: FloatArray,
    prepared: FloatArray,
) -> None:
    """Take rows ``chosen[n]`` out of a pool, prepare them, and say so in ``here``."""
    for r in range(here.shape[0]):
        k = chosen[n, r]
        here[r] = k
        kinds[r] = pool_kinds[k]
        for i in range(pool.shape[1]):
            rows[r, i] = pool[k, i]
        prepare_row(kinds[r], rows, r, prepared)
    pair_spots(kinds, rows, here.shape[0])
