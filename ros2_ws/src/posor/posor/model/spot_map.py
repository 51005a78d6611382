# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the ratios of a diode's contact currents to the spot's position on the diode, by a two-dimensional map.

Two kinds of map:

* tensor (POWER, CHEBYSHEV): ``x = sum_ij X_ij B_i(u) B_j(v)``, y likewise, with (u, v) = (ratios - center) / scale and
  B the powers or the Chebyshev polynomials. Parameters: all X_ij, then all Y_ij (row by row).
* CURVES, the map of 1985 (thesis 7.4.2, 8.3.3): x is a polynomial of the x ratio on each of n lines of constant y, y a
  polynomial of the y ratio on each of n lines of constant x; between neighbouring lines the curves are weighted
  linearly. Each coordinate needs the other, so both are found by fixed-point iteration. Parameters: coefficients of the
  n curves of x, of the n curves of y, positions in y of the curves of x, positions in x of the curves of y (ascending).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray

POWER, CHEBYSHEV, CURVES = 0, 1, 2
INSIDE, OUTSIDE_X, OUTSIDE_Y = 0, 1, 2

_ITERATIONS = 60
_TOLERANCE_M = 1e-15


@in_place
def spot_position(diode: Any, parameters: FloatArray, spot: Any, residual_derivatives: FloatArray, row: int) -> int:
    """Map the ratios of a spot to its position and slope.

    ``diode``: record of dtype DIODE. ``parameters``: of the map, shape (p,). ``spot``: record of dtype SPOT_POSITION;
    position and slope are written. ``residual_derivatives``: derivatives of prediction minus reading by the parameters
    to write, x into ``row``, y into the next, shape (m, p or more). Of a tensor map only each coordinate's own half is
    written. ``row``: reading of the x coordinate. Returns INSIDE, or OUTSIDE_X or OUTSIDE_Y where a coordinate lies
    beyond the outermost curves.
    """
    if diode.map_kind == CURVES:
        _find_on_curves(diode, parameters, spot)
        return _write_curve_derivatives(diode, parameters, spot, residual_derivatives, row)
    _evaluate_tensor(diode, parameters, spot, residual_derivatives, row)
    return INSIDE


@in_place
def _write_basis(kind: int, value: float, count: int, basis: FloatArray, row: int) -> None:
    """Write the basis functions at ``value`` into a row of ``basis``, their derivatives into the next row."""
    for i in range(count):
        if i == 0:
            basis[row, i], basis[row + 1, i] = 1.0, 0.0
        elif i == 1:
            basis[row, i], basis[row + 1, i] = value, 1.0
        elif kind == POWER:
            basis[row, i], basis[row + 1, i] = basis[row, i - 1] * value, i * basis[row, i - 1]
        else:
            basis[row, i] = 2.0 * value * basis[row, i - 1] - basis[row, i - 2]
            basis[row + 1, i] = 2.0 * basis[row, i - 1] + 2.0 * value * basis[row + 1, i - 1] - basis[row + 1, i - 2]


@in_place
def _evaluate_tensor(diode: Any, parameters: FloatArray, spot: Any, residual_derivatives: FloatArray, row: int) -> None:
    n, m = diode.map_lengths[0], diode.map_lengths[1]
    basis, scale = spot.basis, diode.scale
    _write_basis(diode.map_kind, (spot.ratios[0] - diode.center[0]) / scale[0], n, basis, 0)
    _write_basis(diode.map_kind, (spot.ratios[1] - diode.center[1]) / scale[1], m, basis, 2)
    half = n * m
    x = y = x_u = x_v = y_u = y_v = 0.0
    for i in range(n):
        fu, du = basis[0, i], basis[1, i]
        along_x = along_y = across_x = across_y = 0.0
        for j in range(m):
            fv, dv = basis[2, j], basis[3, j]
            k = i * m + j
            along_x += parameters[k] * fv
            along_y += parameters[half + k] * fv
            across_x += parameters[k] * dv
            across_y += parameters[half + k] * dv
            residual_derivatives[row, k] = residual_derivatives[row + 1, half + k] = -fu * fv
        x += along_x * fu
        y += along_y * fu
        x_u += along_x * du
        y_u += along_y * du
        x_v += across_x * fu
        y_v += across_y * fu
    spot.position[0], spot.position[1] = x, y
    spot.slope[0, 0], spot.slope[0, 1] = x_u / scale[0], x_v / scale[1]
    spot.slope[1, 0], spot.slope[1, 1] = y_u / scale[0], y_v / scale[1]


@in_place
def _curve(parameters: FloatArray, start: int, order: int, ratio: float) -> tuple[float, float]:
    """Return the polynomial whose coefficients begin at ``start``, and its slope."""
    value = 0.0
    slope = 0.0
    for k in range(order - 1, -1, -1):
        slope = slope * ratio + value
        value = value * ratio + parameters[start + k]
    return value, slope


@in_place
def _interval(parameters: FloatArray, start: int, count: int, position: float) -> tuple[int, float, float]:
    """Return the interval of the ascending positions at ``start`` that holds a position, its width, and the weight.

    Positions outside belong to the outermost interval.
    """
    i = 0
    while i < count - 2 and position > parameters[start + i + 1]:
        i += 1
    width = parameters[start + i + 1] - parameters[start + i]
    return i, width, (position - parameters[start + i]) / width


@in_place
def _find_on_curves(diode: Any, parameters: FloatArray, spot: Any) -> None:
    """Find the position by fixed-point iteration; leave dx/dy, dy/dx and both slopes of the curves in ``basis``."""
    count, order = diode.map_lengths[0], diode.map_lengths[1]
    size = count * order
    # Of coordinate a: its curves begin at a * size, their positions (along the other coordinate) at 2 size + a * count.
    position, by_other, by_ratio = spot.position, spot.basis[0], spot.basis[1]
    position[1] = 0.5 * (parameters[2 * size] + parameters[2 * size + count - 1])
    for iteration in range(_ITERATIONS):
        largest = 0.0
        for axis in range(2):
            i, width, weight = _interval(parameters, 2 * size + axis * count, count, position[1 - axis])
            ratio = spot.ratios[axis]
            first, first_slope = _curve(parameters, axis * size + i * order, order, ratio)
            second, second_slope = _curve(parameters, axis * size + (i + 1) * order, order, ratio)
            new = first + weight * (second - first)
            largest = max(largest, abs(new - position[axis])) if iteration > 0 or axis == 1 else math.inf
            position[axis] = new
            by_other[axis] = (second - first) / width
            by_ratio[axis] = first_slope + weight * (second_slope - first_slope)
        if largest < _TOLERANCE_M:
            break


@in_place
def _write_curve_derivatives(
    diode: Any, parameters: FloatArray, spot: Any, residual_derivatives: FloatArray, row: int
) -> int:
    """Write slope and derivatives of a position that ``_find_on_curves`` found; return INSIDE or where it is outside.

    With x = F(rx, y) and y = G(ry, x): dx = (Fr drx + Fy Gr dry) / (1 - Fy Gx), dy likewise; parameters act as F, G.
    """
    count, order = diode.map_lengths[0], diode.map_lengths[1]
    size = count * order
    position, by_other, by_ratio = spot.position, spot.basis[0], spot.basis[1]
    whole = 1.0 - by_other[0] * by_other[1]
    for k in range(2 * (size + count)):
        residual_derivatives[row, k] = 0.0
        residual_derivatives[row + 1, k] = 0.0
    for axis in range(2):
        own, other = 1.0 / whole, by_other[1 - axis] / whole
        to_own, to_other = row + axis, row + 1 - axis
        spot.slope[axis, axis] = own * by_ratio[axis]
        spot.slope[1 - axis, axis] = other * by_ratio[axis]
        lines = 2 * size + axis * count
        i, _, weight = _interval(parameters, lines, count, position[1 - axis])
        power = 1.0
        for k in range(order):
            for which, share in ((i, 1.0 - weight), (i + 1, weight)):
                at = axis * size + which * order + k
                residual_derivatives[to_own, at] = -own * share * power
                residual_derivatives[to_other, at] = -other * share * power
            power *= spot.ratios[axis]
        for at, share in ((lines + i, -(1.0 - weight)), (lines + i + 1, -weight)):
            residual_derivatives[to_own, at] = -own * share * by_other[axis]
            residual_derivatives[to_other, at] = -other * share * by_other[axis]
    for axis in range(2):
        lines = 2 * size + axis * count
        if position[1 - axis] < parameters[lines] or position[1 - axis] > parameters[lines + count - 1]:
            return OUTSIDE_Y if axis == 0 else OUTSIDE_X
    return INSIDE


@in_place
def position_of_ratios(
    diodes: NDArray[np.void], parameters: FloatArray, spots: NDArray[np.void], residual_derivatives: FloatArray
) -> int:
    """Do ``spot_position`` for the only diode and spot of records (1,)."""
    return spot_position(diodes[0], parameters, spots[0], residual_derivatives, 0)


@in_place
def ratios_of_positions(
    diodes: NDArray[np.void], parameters: FloatArray, positions: FloatArray, spots: NDArray[np.void], work: FloatArray
) -> None:
    """Write the ratios at which the map of one diode gives positions (n, 2) [m]; NaN where no ratio in the domain does.

    ``diodes``: the diode, shape (1,), dtype DIODE. ``parameters``: of its map, shape (p,). ``positions``: wanted
    positions [m], shape (n, 2). ``spots``: where the ratios are written, shape (n,), dtype SPOT_POSITION. ``work``:
    memory for derivatives, shape (2, p).
    """
    diode = diodes[0]
    for n in range(positions.shape[0]):
        spot = spots[n]
        for axis in range(2):
            spot.ratios[axis] = 0.5 * (diode.domain[axis, 0] + diode.domain[axis, 1])
        for _ in range(_ITERATIONS):
            spot_position(diode, parameters, spot, work, 0)
            ex, ey = positions[n, 0] - spot.position[0], positions[n, 1] - spot.position[1]
            slope = spot.slope
            whole = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
            step_x = (slope[1, 1] * ex - slope[0, 1] * ey) / whole
            step_y = (slope[0, 0] * ey - slope[1, 0] * ex) / whole
            for axis, step in ((0, step_x), (1, step_y)):
                low, high = diode.domain[axis, 0], diode.domain[axis, 1]
                reach = high - low
                spot.ratios[axis] = min(max(spot.ratios[axis] + step, low - reach), high + reach)
            if not max(abs(ex), abs(ey)) > _TOLERANCE_M:
                break
        for axis in range(2):
            if not diode.domain[axis, 0] <= spot.ratios[axis] <= diode.domain[axis, 1]:
                spot.ratios[0] = spot.ratios[1] = math.nan
