"""What a solution is worth: its covariance, random and systematic, and the chi-square of its redundant readings.

With the rows' derivatives J, the readings' variances R (random, diagonal) and G = (J' R^-1 J)^-1 J' R^-1:

* random covariance ``(J' R^-1 J)^-1`` (JCGM 100, 5.1 for a linear model of uncorrelated readings);
* systematic covariance ``G S G'`` where S, the readings' covariance from the calibration parameters, is ``D V D'``
  with D the derivative of each residual with respect to each parameter (JCGM 100, 5.2: parameters shared by readings
  correlate them);
* chi-square ``e' (R + S)^+ e`` of the residuals e over the space that no pose can explain.

Both covariances are turned from the local tangent into ROS order: x, y, z, about X, Y, Z along the axes of R, the small
turn applied on the parent's side at the origin of T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.cholesky import factor, substitute
from posor_estimator.core.kernels.rows import row_parameters
from posor_estimator.core.kernels.solve import normal_matrix

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@compiled
def reading_covariance(
    kinds: IntArray,
    rows: FloatArray,
    ids: IntArray,
    sigmas: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    work: FloatArray,
    out: FloatArray,
) -> None:
    """Add the readings' covariance from the rows' geometry to ``out`` (m, m) [m^2].

    Rows that share a parameter have it in the same column: rows of one kind share what is common to a sensor.

    Args:
        kinds: Kind of each row, shape (m,).
        rows: Parameters of each row, shape (m, width).
        ids: Which parameter of the POSOR each row parameter is, shape (m, width); negative: exact.
        sigmas: Standard uncertainty of each row parameter, shape (m, width).
        rotation: R_R_T, shape (3, 3).
        translation: Of ``T_R_T`` [m], shape (3,).
        work: Room for the derivatives, shape (m, width).
        out: Covariance to add to, shape (m, m).

    """
    m, width = ids.shape
    for r in range(m):
        row_parameters(kinds[r], rows[r], rotation, translation, work[r])
        for k in range(width):
            work[r, k] *= sigmas[r, k]
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(width):
                if ids[i, k] >= 0 and ids[i, k] == ids[j, k]:
                    total += work[i, k] * work[j, k]
            out[i, j] += total
            if i != j:
                out[j, i] += total


@compiled
def covariances(
    jacobian: FloatArray,
    weights: FloatArray,
    systematic_readings: FloatArray,
    rotation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
) -> None:
    """Write the random and the systematic covariance of the pose, ROS order, into the last two arrays (6, 6)."""
    m = weights.shape[0]
    lower = np.empty((6, 6))
    normal_matrix(jacobian, weights, lower)
    factor(lower)
    local = np.zeros((6, 6))
    gain = np.empty((m, 6))
    for i in range(6):
        local[i, i] = 1.0
        substitute(lower, local[i])
    for r in range(m):
        for i in range(6):
            gain[r, i] = weights[r] * jacobian[r, i]
        substitute(lower, gain[r])
    pushed = np.empty((m, 6))
    for r in range(m):
        for i in range(6):
            total = 0.0
            for q in range(m):
                total += systematic_readings[r, q] * gain[q, i]
            pushed[r, i] = total
    of_parameters = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            total = 0.0
            for r in range(m):
                total += gain[r, i] * pushed[r, j]
            of_parameters[i, j] = total
    to_parent(local, rotation, random)
    to_parent(of_parameters, rotation, systematic)


@compiled
def to_parent(local: FloatArray, rotation: FloatArray, out: FloatArray) -> None:
    """Write a covariance of the local tangent, turned block by block into the parent's axes, into ``out`` (6, 6)."""
    half = np.empty((6, 6))
    for block in range(0, 6, 3):
        for i in range(3):
            for j in range(6):
                total = 0.0
                for k in range(3):
                    total += rotation[i, k] * local[block + k, j]
                half[block + i, j] = total
    for block in range(0, 6, 3):
        for i in range(6):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += half[i, block + k] * rotation[j, k]
                out[i, block + j] = total


@compiled
def chi_square(  # noqa: C901  one loop over plain numbers, to be compiled
    jacobian: FloatArray, weights: FloatArray, residuals: FloatArray, systematic_readings: FloatArray
) -> float:
    """Return the chi-square of the redundant readings, their whole uncertainty taken into account.

    The readings' total covariance is C = R + S. The residuals of the fit weighted by C^-1 need not be computed by a
    second fit: chi-square is ``e' C^-1 e - e' C^-1 J (J' C^-1 J)^-1 J' C^-1 e`` for the residuals e of any fit.
    """
    m = weights.shape[0]
    total = systematic_readings.copy()
    for r in range(m):
        total[r, r] += 1.0 / weights[r]
    if not factor(total) > 0.0:
        return math.nan
    solved = np.empty((6, m))
    for i in range(6):
        for r in range(m):
            solved[i, r] = jacobian[r, i]
        substitute(total, solved[i])
    weighed = residuals.copy()
    substitute(total, weighed)
    normal = np.empty((6, 6))
    right = np.empty(6)
    for i in range(6):
        right[i] = 0.0
        for r in range(m):
            right[i] += solved[i, r] * residuals[r]
        for j in range(i + 1):
            entry = 0.0
            for r in range(m):
                entry += solved[i, r] * jacobian[r, j]
            normal[i, j] = entry
    if not factor(normal) > 0.0:
        return math.nan
    explained = right.copy()
    substitute(normal, explained)
    out = 0.0
    for r in range(m):
        out += residuals[r] * weighed[r]
    for i in range(6):
        out -= right[i] * explained[i]
    return max(out, 0.0)
