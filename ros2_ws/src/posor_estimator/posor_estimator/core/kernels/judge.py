"""What a solution is worth: its covariance, random and systematic, and the chi-square of its redundant readings.

With the rows' derivatives J, the readings' variances R (random, diagonal) and G = (J' R^-1 J)^-1 J' R^-1:

* random covariance ``(J' R^-1 J)^-1`` (JCGM 100, 5.1 for a linear model of uncorrelated readings);
* systematic covariance ``G S G'`` where S is the readings' covariance from the calibration parameters
  (``kernels.effects``; JCGM 100, 5.2: parameters shared by readings correlate them);
* chi-square ``e' (R + S)^+ e`` of the residuals e over the space that no pose can explain.

Both covariances are turned from the local tangent into ROS order: x, y, z, about X, Y, Z along the axes of R, the small
turn applied on the parent's side at the origin of T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.cholesky import factor, halve, invert
from posor_estimator.core.kernels.solve import normal_matrix
from posor_estimator.core.kernels.tables import (
    GAIN,
    JACOBIAN,
    LINES,
    RESIDUALS,
    SIDES,
    SQUARES,
    TOTAL,
    WEIGHTS,
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@compiled
def covariances(  # noqa: C901  loops over plain numbers, to be compiled
    places: IntArray,
    floats: FloatArray,
    used: int,
    systematic_readings: FloatArray,
    rotation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
) -> None:
    """Write the random and the systematic covariance of the pose, ROS order, into the last two arrays (6, 6).

    JACOBIAN and the weights hold those of the ``used`` rows, at the solution.
    """
    jacobian, weights = table(places, floats, JACOBIAN), line(places, floats, LINES, WEIGHTS)
    gain, squares = table(places, floats, GAIN), table(places, floats, SQUARES)
    lower, local, half = squares[0:6], squares[6:12], squares[12:18]
    normal_matrix(jacobian, weights, used, lower)
    factor(lower)
    invert(lower)
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 6):
                total += lower[k, i] * lower[k, j]
            local[i, j] = local[j, i] = total
    pushed = gain[used : 2 * used]
    for r in range(used):
        for i in range(6):
            total = 0.0
            for k in range(6):
                total += jacobian[r, k] * local[k, i]
            gain[r, i] = weights[r] * total
    for r in range(used):
        a = b = c = d = e = f = 0.0
        for q in range(used):
            of_q = systematic_readings[r, q]
            a += of_q * gain[q, 0]
            b += of_q * gain[q, 1]
            c += of_q * gain[q, 2]
            d += of_q * gain[q, 3]
            e += of_q * gain[q, 4]
            f += of_q * gain[q, 5]
        pushed[r, 0], pushed[r, 1], pushed[r, 2] = a, b, c
        pushed[r, 3], pushed[r, 4], pushed[r, 5] = d, e, f
    to_parent(local, rotation, half, random)
    for i in range(6):
        a = b = c = d = e = f = 0.0
        for r in range(used):
            of_r = gain[r, i]
            a += of_r * pushed[r, 0]
            b += of_r * pushed[r, 1]
            c += of_r * pushed[r, 2]
            d += of_r * pushed[r, 3]
            e += of_r * pushed[r, 4]
            f += of_r * pushed[r, 5]
        local[i, 0], local[i, 1], local[i, 2] = a, b, c
        local[i, 3], local[i, 4], local[i, 5] = d, e, f
    to_parent(local, rotation, half, systematic)


@compiled
def to_parent(local: FloatArray, rotation: FloatArray, half: FloatArray, out: FloatArray) -> None:
    """Write a covariance of the local tangent, turned block by block into the parent's axes, into ``out`` (6, 6)."""
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
def chi_square(  # noqa: C901  loops over plain numbers, to be compiled
    places: IntArray, floats: FloatArray, m: int, systematic_readings: FloatArray
) -> float:
    """Return the chi-square of the m redundant readings, their whole uncertainty taken into account.

    The readings' total covariance is C = R + S. The residuals of the fit weighted by C^-1 need not be computed by a
    second fit: chi-square is ``e' C^-1 e - e' C^-1 J (J' C^-1 J)^-1 J' C^-1 e`` for the residuals e of any fit.
    JACOBIAN, the weights and the residuals hold those of the fit.
    """
    jacobian, weights = table(places, floats, JACOBIAN), line(places, floats, LINES, WEIGHTS)
    residuals, sides = line(places, floats, LINES, RESIDUALS), table(places, floats, SIDES)
    total, normal = table(places, floats, TOTAL), table(places, floats, SQUARES)[0:6]
    for r in range(m):
        for q in range(r + 1):
            total[r, q] = systematic_readings[r, q]
        total[r, r] += 1.0 / weights[r]
        for i in range(6):
            sides[r, i] = jacobian[r, i]
        sides[r, 6] = residuals[r]
    if not factor(total) > 0.0:
        return math.nan
    # With C = L L': columns L^-1 J and L^-1 e; what a fit of the one to the other leaves.
    halve(total, sides, 7)
    right = table(places, floats, SQUARES)[6:12]
    out = 0.0
    for r in range(m):
        out += sides[r, 6] * sides[r, 6]
    for i in range(6):
        total_i = 0.0
        for r in range(m):
            total_i += sides[r, i] * sides[r, 6]
        right[i, 0] = total_i
        for j in range(i + 1):
            total_ij = 0.0
            for r in range(m):
                total_ij += sides[r, i] * sides[r, j]
            normal[i, j] = total_ij
    if not factor(normal) > 0.0:
        return math.nan
    halve(normal, right, 1)
    for i in range(6):
        out -= right[i, 0] * right[i, 0]
    return max(out, 0.0)
