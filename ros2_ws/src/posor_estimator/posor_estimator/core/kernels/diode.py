"""From a diode's contact currents to the linearised spot position, with every way in which a scan can be unfit.

Diode numbers (12 + p): least and greatest sum A + C, and B + D, that one lit source gives [A] 0:2; calibrated box of
the ratios, lowest and highest of x, then of y, 2:6; standard deviation of the two ratios 6:8; centre and scale of the
ratios for the map 8:12; the map's parameters. Room for one diode (4, 2): ratios, position [m], slopes (two rows).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled, inlined
from posor_estimator.core.kernels.spot_map import INSIDE, spot_position
from posor_estimator.core.kernels.vector import square

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

CONTACTS = 4

FINE = 0
NOT_FINITE = 1
DARK = 2
BRIGHT = 3
OUTSIDE_X = 4
OUTSIDE_Y = 5
CODES = 8
"""Codes of diode i are offset by ``CODES * i``."""

SUMS, DOMAIN, NOISES, FRAME, MAP = 0, 2, 6, 8, 12


@inlined
def linearise_spots(
    currents: FloatArray,
    diodes: FloatArray,
    shapes: IntArray,
    begin: int,
    values: FloatArray,
    variances: FloatArray,
    less_by: FloatArray,
    first: int,
    room: FloatArray,
    basis: FloatArray,
) -> int:
    """Linearise the currents of one scan into readings ``first`` and following: x and y of each diode in turn.

    Args:
        currents: A, B, C, D of each diode in turn [A], shape (4 d,).
        diodes: Numbers of each diode, see the module, shape (D, 12 + p).
        shapes: See ``spot_position``, shape (D, 3).
        begin: Which of these the first diode is.
        values: Positions [m] to write, shape (m,).
        variances: Their variances from the noise [m^2] to write, shape (m,).
        less_by: What they fall by for each of the map's parameters to write, see ``spot_position``, shape (m, p or
            more).
        first: Reading of the first diode's x.
        room: See the module.
        basis: See ``spot_position``.

    Returns:
        FINE, or ``code + CODES * diode`` of the first diode that is unfit.

    """
    ratios, slope = room[0], room[2:4]
    for i in range(currents.shape[0] // CONTACTS):
        d, offset = begin + i, CODES * i
        for axis in range(2):
            plus, minus = currents[CONTACTS * i + axis], currents[CONTACTS * i + axis + 2]
            total = plus + minus
            if not math.isfinite(total):
                return NOT_FINITE + offset
            if total < diodes[d, SUMS]:
                return DARK + offset
            if total > diodes[d, SUMS + 1]:
                return BRIGHT + offset
            ratios[axis] = (plus - minus) / total
            lowest = DOMAIN + 2 * axis
            if ratios[axis] < diodes[d, lowest] or ratios[axis] > diodes[d, lowest + 1]:
                return OUTSIDE_X + axis + offset
        row = first + 2 * i
        outcome = spot_position(
            shapes[d],
            diodes[d, FRAME:MAP],
            diodes[d, MAP:],
            ratios,
            values[row : row + 2],
            slope,
            less_by[row : row + 2],
            basis,
        )
        if outcome != INSIDE:
            return OUTSIDE_X + outcome - 1 + offset
        write_variances(diodes, d, slope, variances, row)
    return FINE


@inlined
def write_variances(diodes: FloatArray, d: int, slope: FloatArray, variances: FloatArray, row: int) -> None:
    """Write the variances of the position on diode d [m^2] from its slopes (2, 2), into entry ``row`` and the next."""
    for axis in range(2):
        by_x, by_y = slope[axis, 0] * diodes[d, NOISES], slope[axis, 1] * diodes[d, NOISES + 1]
        variances[row + axis] = square(by_x) + square(by_y)


@compiled
def linearise_all(
    currents: FloatArray,
    diodes: FloatArray,
    shapes: IntArray,
    values: FloatArray,
    variances: FloatArray,
    first: int,
    codes: IntArray,
) -> None:
    """Do ``linearise_spots`` for every scan whose code is zero so far; readings have a leading axis of scans."""
    less_by = np.empty((values.shape[1], diodes.shape[1]))
    room, basis = np.empty((4, 2)), np.empty((4, diodes.shape[1]))
    for n in range(currents.shape[0]):
        if codes[n] == 0:
            codes[n] = linearise_spots(
                currents[n], diodes, shapes, 0, values[n], variances[n], less_by, first, room, basis
            )
