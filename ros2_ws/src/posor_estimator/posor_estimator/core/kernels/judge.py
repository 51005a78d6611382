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

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.blocks import (
    NONE,
    NOTHING,
    inverse,
    kept_factors,
    product_transposed,
    times_symmetric,
    whole,
    with_outer,
)
from posor_estimator.core.kernels.cholesky import factor as factor_table
from posor_estimator.core.kernels.cholesky import halve
from posor_estimator.core.kernels.eight import chosen, everywhere
from posor_estimator.core.kernels.matrix import matrix, row_times
from posor_estimator.core.kernels.tables import (
    BLIND,
    FACTORS,
    GAIN,
    JACOBIAN,
    LINES,
    REACH,
    READINGS,
    RESIDUALS,
    SPREAD,
    WEIGHTS,
    line,
    table,
)
from posor_estimator.core.kernels.vector import dot, plus, put, times, within

if TYPE_CHECKING:
    from posor_estimator.core.kernels.blocks import Symmetric
    from posor_estimator.core.kernels.matrix import Matrix
    from posor_estimator.core.kernels.vector import Vector
    from posor_estimator.core.types import FloatArray, IntArray


@inlined
def covariances(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    m: int,
    rotation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
) -> None:
    """Write the random and the systematic covariance of the pose, ROS order, into the last two arrays (6, 6).

    JACOBIAN, the weights and FACTORS hold those at the solution, READINGS S of the m readings, which come first. GAIN
    is written.
    """
    jacobian, weights = table(places, floats, JACOBIAN), line(places, floats, LINES, WEIGHTS)
    gain, systematic_readings = table(places, floats, GAIN), table(places, floats, READINGS)
    reach, axes = table(places, ints, REACH), matrix(rotation, 0)
    local = inverse(kept_factors(table(places, floats, FACTORS)))
    to_parent(local, axes, random)
    for r in range(m):
        v, w = times_symmetric(local, within(jacobian, r, 0), within(jacobian, r, 3))
        put(gain, r, 0, times(weights[r], v))
        put(gain, r, 3, times(weights[r], w))
    a, b, d = NONE, NONE, NONE
    for r in range(m):
        v, w = NOTHING, NOTHING
        for q in range(reach[r, 0], reach[r, 1]):
            v = plus(v, times(systematic_readings[r, q], within(gain, q, 0)))
            w = plus(w, times(systematic_readings[r, q], within(gain, q, 3)))
        a = with_outer(a, within(gain, r, 0), v)
        b = with_outer(b, within(gain, r, 3), v)
        d = with_outer(d, within(gain, r, 3), w)
    to_parent((whole(a), b, whole(d)), axes, systematic)


@inlined
def turned_block(block: Matrix, axes: Matrix) -> Matrix:
    """Return ``R block R'``, R the rotation whose rows are ``axes``."""
    half = row_times(axes[0], block), row_times(axes[1], block), row_times(axes[2], block)
    return product_transposed(half, axes)


@inlined
def to_parent(local: Symmetric, axes: Matrix, out: FloatArray) -> None:
    """Write a covariance of the local tangent, turned block by block into the parent's axes, into ``out`` (6, 6)."""
    a, b, d = whole(turned_block(local[0], axes)), turned_block(local[1], axes), whole(turned_block(local[2], axes))
    put(out, 0, 0, a[0])
    put(out, 1, 0, a[1])
    put(out, 2, 0, a[2])
    put(out, 3, 0, b[0])
    put(out, 4, 0, b[1])
    put(out, 5, 0, b[2])
    put(out, 0, 3, (b[0][0], b[1][0], b[2][0]))
    put(out, 1, 3, (b[0][1], b[1][1], b[2][1]))
    put(out, 2, 3, (b[0][2], b[1][2], b[2][2]))
    put(out, 3, 3, d[0])
    put(out, 4, 3, d[1])
    put(out, 5, 3, d[2])


@inlined
def chi_square(places: IntArray, ints: IntArray, floats: FloatArray, m: int) -> float:
    """Return the chi-square of the m redundant readings, their whole uncertainty taken into account.

    The residuals e of the fit lie, as far as no pose explains them, along as many directions Z as readings are
    redundant, ``J' Z = 0``. Along these they spread by ``Z' (R + S) Z``; so chi-square is ``u' (Z' (R + S) Z)^-1 u``
    with ``u = Z' e``. JACOBIAN, the weights and the residuals hold those of the fit, GAIN its G'.
    """
    residuals, systematic_readings = line(places, floats, LINES, RESIDUALS), table(places, floats, READINGS)
    directions, spread = table(places, floats, BLIND), table(places, floats, SPREAD)
    along, reach = directions[:, m], table(places, ints, REACH)
    if not find_directions(places, floats, m):
        return math.nan
    for t in range(directions.shape[0]):
        along[t] = 0.0
        for s in range(t):
            spread[t, s] = 0.0
        spread[t, t] = 1.0
        for r in range(m):
            along[t] += directions[t, r] * residuals[r]
            pushed = 0.0
            for q in range(reach[r, 0], reach[r, 1]):
                pushed += systematic_readings[r, q] * directions[t, q]
            for s in range(t + 1):
                spread[t, s] += directions[s, r] * pushed
    if not everywhere(factor_table(spread) > 0.0):
        return math.nan
    halve(spread, along)
    out = 0.0
    for t in range(directions.shape[0]):
        out += along[t] * along[t]
    return out


@inlined
def find_directions(places: IntArray, floats: FloatArray, m: int) -> bool:
    """Write the directions Z that no pose explains into BLIND (m - 6, m + 1), such that ``Z' R Z = 1``.

    The columns of ``R^-1 (R - J (J' R^-1 J)^-1 J')`` are such directions; of these the pivoted Cholesky factorisation
    takes those that differ most. Returns whether there are as many. See ``chi_square``.
    """
    jacobian, weights = table(places, floats, JACOBIAN), line(places, floats, LINES, WEIGHTS)
    gain, directions = table(places, floats, GAIN), table(places, floats, BLIND)
    for t in range(directions.shape[0]):
        largest, which, weight, v, w = 0.0, -1.0, 0.0, NOTHING, NOTHING
        for r in range(m):
            own_v, own_w = within(jacobian, r, 0), within(jacobian, r, 3)
            left = 1.0 - explained(own_v, own_w, gain, r)
            for s in range(t):
                left -= directions[s, r] * directions[s, r] / weights[r]
            more = left > largest
            largest, which, weight = (
                chosen(more, left, largest),
                chosen(more, r, which),
                chosen(more, weights[r], weight),
            )
            v, w = chosen_of(more, own_v, v), chosen_of(more, own_w, w)
        if not everywhere(largest > 0.0):
            return False
        scale = math.sqrt(weight / largest)
        for r in range(m):
            left = chosen(which == r, 1.0, 0.0) - explained(v, w, gain, r)
            for s in range(t):
                left -= directions[s, r] * entry_of(which, directions, s, m) / weight
            directions[t, r] = scale * left
    return True


@inlined
def chosen_of(condition: bool, a: Vector, b: Vector) -> Vector:  # noqa: FBT001  kernels take no keywords
    """Return one of two vectors."""
    return chosen(condition, a[0], b[0]), chosen(condition, a[1], b[1]), chosen(condition, a[2], b[2])


@inlined
def entry_of(which: float, rows: FloatArray, row: int, count: int) -> float:
    """Return entry ``which``, one of the first ``count``, of a row."""
    out = 0.0
    for r in range(count):
        out = chosen(which == r, rows[row, r], out)
    return out


@inlined
def explained(v: Vector, w: Vector, gain: FloatArray, by: int) -> float:
    """Return how far a reading with derivatives v and w follows, by the pose, when reading ``by`` changes.

    It is an entry of ``J G``.
    """
    return dot(v, within(gain, by, 0)) + dot(w, within(gain, by, 3))
