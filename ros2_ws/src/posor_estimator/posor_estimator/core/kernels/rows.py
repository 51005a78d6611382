"""Rows: one scalar reading each, of any kind, with one way to evaluate them all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.gap import gap, gap_parameters
from posor_estimator.core.kernels.ring import ring_gap, ring_parameters
from posor_estimator.core.kernels.spot import spot, spot_parameters

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

GAP = 0
SPOT_X = 1
SPOT_Y = 2
RING = 3
AFFINE = 4
"""A reading known by its value and derivative at one pose: parameters h, dh/dtangent (1 + 6), see ``evaluate_row``."""

AFFINE_PARAMETERS = 7


@compiled
def evaluate_row(
    kind: int,
    row: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    moved: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Return what the row reads at the pose and write its tangent derivative into ``jacobian`` (6).

    ``moved`` (6) is the sum of the tangent steps since the pose at which affine rows were expanded: they read ``h +
    dh.moved``, which is exact once the expansion has been repeated until ``moved`` stays zero.
    """
    if kind == GAP:
        return gap(row, rotation, translation, jacobian)
    if kind == RING:
        return ring_gap(row, rotation, translation, jacobian)
    if kind == AFFINE:
        reading = row[0]
        for i in range(6):
            jacobian[i] = row[1 + i]
            reading += row[1 + i] * moved[i]
        return float(reading)
    return spot(row, rotation, translation, kind - SPOT_X, jacobian)


@compiled
def row_parameters(
    kind: int, row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray
) -> None:
    """Write the derivative of the row's reading with respect to its own parameters into ``jacobian`` (width)."""
    for i in range(jacobian.shape[0]):
        jacobian[i] = 0.0
    if kind == GAP:
        gap_parameters(row, rotation, translation, jacobian)
    elif kind == RING:
        ring_parameters(row, rotation, translation, jacobian)
    elif kind in (SPOT_X, SPOT_Y):
        spot_parameters(row, rotation, translation, kind - SPOT_X, jacobian)


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
    still = np.zeros(6)
    jacobian = np.empty(6)
    for n in range(chosen.shape[0]):
        for r in range(chosen.shape[1]):
            k = chosen[n, r]
            out[n, r] = evaluate_row(kinds[k], pool[k], rotations[n], translations[n], still, jacobian)
