"""From a diode's contact currents to the linearised spot position, with every way in which a scan can be unfit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.spot_map import INSIDE, spot_position
from posor_estimator.core.kernels.vector import square

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

FINE = 0
NOT_FINITE = 1
DARK = 2
BRIGHT = 3
OUTSIDE_X = 4
OUTSIDE_Y = 5
CODES = 8
"""Codes of diode i are offset by ``CODES * i``."""


@compiled
def linearise_spots(  # noqa: C901  one loop over plain numbers, to be compiled
    currents: FloatArray,
    sums: FloatArray,
    domains: FloatArray,
    noises: FloatArray,
    shapes: IntArray,
    frames: FloatArray,
    maps: FloatArray,
    map_sigmas: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    systematic: FloatArray,
    first: int,
) -> int:
    """Linearise the currents of one scan into rows ``first`` and following: x and y of each diode in turn.

    Args:
        currents: A, B, C, D of each diode [A], shape (d, 4).
        sums: Least and greatest sum A + C, and B + D, that one lit source gives [A], shape (d, 2).
        domains: Calibrated box of the ratios, shape (d, 2, 2): axis, lowest and highest.
        noises: Standard deviation of the two ratios, shape (d, 2).
        shapes: See ``spot_position``, shape (d, 3).
        frames: See ``spot_position``, shape (d, 4).
        maps: Parameters of each map, shape (d, p).
        map_sigmas: Their standard uncertainties, shape (d, p).
        values: Positions [m] to write, shape (m,).
        variances: Their variances from the noise [m^2] to write, shape (m,).
        systematic: Covariance of the readings from the maps' parameters [m^2] to write, shape (m, m).
        first: Row of the first diode's x.

    Returns:
        FINE, or ``code + CODES * diode`` of the first diode that is unfit.

    """
    ratios = np.empty(2)
    slope = np.empty((2, 2))
    by_parameter = np.zeros((2, maps.shape[1]))
    for i in range(currents.shape[0]):
        offset = CODES * i
        for axis in range(2):
            plus, minus = currents[i, axis], currents[i, axis + 2]
            total = plus + minus
            if not math.isfinite(total):
                return NOT_FINITE + offset
            if total < sums[i, 0]:
                return DARK + offset
            if total > sums[i, 1]:
                return BRIGHT + offset
            ratios[axis] = (plus - minus) / total
            if ratios[axis] < domains[i, axis, 0] or ratios[axis] > domains[i, axis, 1]:
                return OUTSIDE_X + axis + offset
        row = first + 2 * i
        outcome = spot_position(shapes[i], frames[i], maps[i], ratios, values[row : row + 2], slope, by_parameter)
        if outcome != INSIDE:
            return OUTSIDE_X + outcome - 1 + offset
        for axis in range(2):
            variances[row + axis] = square(slope[axis, 0] * noises[i, 0]) + square(slope[axis, 1] * noises[i, 1])
            for other in range(2):
                total = 0.0
                for k in range(maps.shape[1]):
                    total += by_parameter[axis, k] * by_parameter[other, k] * map_sigmas[i, k] * map_sigmas[i, k]
                systematic[row + axis, row + other] += total
    return FINE


@compiled
def linearise_all(
    currents: FloatArray,
    sums: FloatArray,
    domains: FloatArray,
    noises: FloatArray,
    shapes: IntArray,
    frames: FloatArray,
    maps: FloatArray,
    map_sigmas: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    systematic: FloatArray,
    first: int,
    codes: IntArray,
) -> None:
    """Do ``linearise_spots`` for every scan whose code is zero so far; readings have a leading axis of scans."""
    for n in range(currents.shape[0]):
        if codes[n] == 0:
            codes[n] = linearise_spots(
                currents[n],
                sums,
                domains,
                noises,
                shapes,
                frames,
                maps,
                map_sigmas,
                values[n],
                variances[n],
                systematic[n],
                first,
            )
