"""From the ratios of a diode's contact currents to the spot's position on the diode, by a two-dimensional map.

Two kinds of map:

* TENSOR: ``x = sum_ij X_ij B_i(u) B_j(v)``, y likewise, with (u, v) = (ratios - center) / scale and B the powers or the
  Chebyshev polynomials. Parameters: all X_ij, then all Y_ij (row by row).
* CURVES, the map of 1985 (thesis 7.4.3): x is a polynomial of the x ratio on each of n lines of constant y, y one of
  the y ratio on each of n lines of constant x; between neighbouring lines the curves are weighted linearly, and since
  each coordinate needs the other, both are found by fixed-point iteration. Parameters: coefficients of the n curves of
  x, of the n curves of y, positions in y of the curves of x, positions in x of the curves of y (positions ascending).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled, in_place, inlined

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

POWER = 0
CHEBYSHEV = 1
CURVES = 2

INSIDE = 0
OUTSIDE_X = 1
OUTSIDE_Y = 2

_ROUNDS = 60
_SETTLED_M = 1e-15


@inlined
def _basis(kind: int, value: float, count: int, basis: FloatArray, row: int) -> None:
    """Write the basis functions at ``value`` into a row of ``basis`` (4, longest), their derivatives into the next."""
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


@inlined
def tensor(
    kind: int,
    shape: IntArray,
    frame: FloatArray,
    parameters: FloatArray,
    ratios: FloatArray,
    position: FloatArray,
    slope: FloatArray,
    less_by: FloatArray,
    basis: FloatArray,
) -> None:
    """Do ``spot_position`` for a map that is no CURVES."""
    n, m = shape[1], shape[2]
    _basis(kind, (ratios[0] - frame[0]) / frame[2], n, basis, 0)
    _basis(kind, (ratios[1] - frame[1]) / frame[3], m, basis, 2)
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
            less_by[0, k] = less_by[1, half + k] = -fu * fv
        x += along_x * fu
        y += along_y * fu
        x_u += along_x * du
        y_u += along_y * du
        x_v += across_x * fu
        y_v += across_y * fu
    position[0], position[1] = x, y
    slope[0, 0], slope[0, 1] = x_u / frame[2], x_v / frame[3]
    slope[1, 0], slope[1, 1] = y_u / frame[2], y_v / frame[3]


@inlined
def _curve(parameters: FloatArray, start: int, order: int, ratio: float) -> tuple[float, float]:
    """Return the polynomial whose coefficients begin at ``start``, and its slope."""
    value = 0.0
    slope = 0.0
    for k in range(order - 1, -1, -1):
        slope = slope * ratio + value
        value = value * ratio + parameters[start + k]
    return value, slope


@in_place
def _between(parameters: FloatArray, start: int, count: int, where: float) -> int:
    """Return the interval of the ascending positions at ``start`` that holds ``where``, the end ones for outside."""
    i = 0
    while i < count - 2 and where > parameters[start + i + 1]:
        i += 1
    return i


@in_place
def _curves(  # noqa: C901  one loop over plain numbers, to be compiled
    shape: IntArray,
    parameters: FloatArray,
    ratios: FloatArray,
    position: FloatArray,
    slope: FloatArray,
    less_by: FloatArray,
    room: FloatArray,
) -> int:
    count, order = shape[1], shape[2]
    size = count * order
    # Of coordinate a: its curves begin at a * size, their positions (along the other coordinate) at 2 size + a * count.
    position[1] = 0.5 * (parameters[2 * size] + parameters[2 * size + count - 1])
    cross, by_ratio = room[0], room[1]
    for round_ in range(_ROUNDS):
        largest = 0.0
        for axis in range(2):
            lines = 2 * size + axis * count
            other = position[1 - axis]
            i = _between(parameters, lines, count, other)
            below, above = parameters[lines + i], parameters[lines + i + 1]
            weight = (other - below) / (above - below)
            first, first_slope = _curve(parameters, axis * size + i * order, order, ratios[axis])
            second, second_slope = _curve(parameters, axis * size + (i + 1) * order, order, ratios[axis])
            new = first + weight * (second - first)
            largest = max(largest, abs(new - position[axis])) if round_ > 0 or axis == 1 else math.inf
            position[axis] = new
            cross[axis] = (second - first) / (above - below)
            by_ratio[axis] = first_slope + weight * (second_slope - first_slope)
        if largest < _SETTLED_M:
            break
    # With x = F(rx, y) and y = G(ry, x): dx = (Fr drx + Fy Gr dry) / (1 - Fy Gx), dy likewise; parameters act like F,
    # G.
    whole = 1.0 - cross[0] * cross[1]
    for k in range(less_by.shape[1]):
        less_by[0, k] = 0.0
        less_by[1, k] = 0.0
    for axis in range(2):
        own, seen = 1.0 / whole, cross[1 - axis] / whole
        slope[axis, axis] = own * by_ratio[axis]
        slope[1 - axis, axis] = seen * by_ratio[axis]
        lines = 2 * size + axis * count
        i = _between(parameters, lines, count, position[1 - axis])
        below, above = parameters[lines + i], parameters[lines + i + 1]
        weight = (position[1 - axis] - below) / (above - below)
        power = 1.0
        for k in range(order):
            for which, share in ((i, 1.0 - weight), (i + 1, weight)):
                at = axis * size + which * order + k
                less_by[axis, at] = -own * share * power
                less_by[1 - axis, at] = -seen * share * power
            power *= ratios[axis]
        for at, share in ((lines + i, -(1.0 - weight)), (lines + i + 1, -weight)):
            less_by[axis, at] = -own * share * cross[axis]
            less_by[1 - axis, at] = -seen * share * cross[axis]
    for axis in range(2):
        lines = 2 * size + axis * count
        if position[1 - axis] < parameters[lines] or position[1 - axis] > parameters[lines + count - 1]:
            return OUTSIDE_Y if axis == 0 else OUTSIDE_X
    return INSIDE


@inlined
def spot_position(
    shape: IntArray,
    frame: FloatArray,
    parameters: FloatArray,
    ratios: FloatArray,
    position: FloatArray,
    slope: FloatArray,
    less_by: FloatArray,
    basis: FloatArray,
) -> int:
    """Map one diode's ratios to the spot's position.

    Args:
        shape: Kind of map, then the two lengths of its tables (tensor) or number of curves and coefficients, shape
            (3,).
        frame: Centre and scale of the ratios (tensor maps), shape (4,).
        parameters: Of the map, shape (p,).
        ratios: (x, y), shape (2,).
        position: (x, y) [m] to write, shape (2,).
        slope: Derivative of the position with respect to the ratios [m] to write, shape (2, 2).
        less_by: What the position falls by for each parameter to write, shape (2, p or more); of a tensor map only
            each coordinate's own half is written.
        basis: Room for tensor maps, shape (4, longest length of a table or more).

    Returns:
        INSIDE, or OUTSIDE_X or OUTSIDE_Y where a coordinate lies beyond the outermost curves.

    """
    if shape[0] == CURVES:
        return _curves(shape, parameters, ratios, position, slope, less_by, basis)
    tensor(shape[0], shape, frame, parameters, ratios, position, slope, less_by, basis)
    return INSIDE


@compiled
def ratios_of_positions(
    shape: IntArray,
    frame: FloatArray,
    parameters: FloatArray,
    domain: FloatArray,
    positions: FloatArray,
    ratios: FloatArray,
) -> None:
    """Write the ratios (n, 2) at which one diode's map gives positions (n, 2) [m]; NaN where none does."""
    position = np.empty(2)
    slope = np.empty((2, 2))
    less_by = np.zeros((2, parameters.shape[0]))
    basis = np.empty((4, parameters.shape[0]))
    for n in range(positions.shape[0]):
        ratio = ratios[n]
        for axis in range(2):
            ratio[axis] = 0.5 * (domain[axis, 0] + domain[axis, 1])
        for _ in range(_ROUNDS):
            spot_position(shape, frame, parameters, ratio, position, slope, less_by, basis)
            ex, ey = positions[n, 0] - position[0], positions[n, 1] - position[1]
            whole = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
            step_x = (slope[1, 1] * ex - slope[0, 1] * ey) / whole
            step_y = (slope[0, 0] * ey - slope[1, 0] * ex) / whole
            for axis, step in ((0, step_x), (1, step_y)):
                reach = domain[axis, 1] - domain[axis, 0]
                ratio[axis] = min(max(ratio[axis] + step, domain[axis, 0] - reach), domain[axis, 1] + reach)
            if not max(abs(ex), abs(ey)) > _SETTLED_M:
                break
        for axis in range(2):
            if not domain[axis, 0] <= ratio[axis] <= domain[axis, 1]:
                ratio[:] = math.nan
