# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the contact currents of a lateral effect diode to the ratios of currents, with every way to be invalid.

The ratios are ``(A - C)/(A + C)`` along x and ``(B - D)/(B + D)`` along y (thesis 4.3 and 5.4.1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.model.scan import CONTACTS
from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

VALID, NOT_FINITE, DARK, BRIGHT, OUTSIDE_X, OUTSIDE_Y = range(6)
CODES = 8  # a code of diode i is ``code + CODES * i``

MAX_MAP_LENGTH = 32  # largest number of functions of one ratio in a tensor map

DIODE = np.dtype(  # the calibration of one diode, its map parameters excepted
    [
        ("least_sum", "f8"),  # of A + C and of B + D with one light source lit [A]
        ("greatest_sum", "f8"),
        ("domain", "f8", (2, 2)),  # calibrated box of the ratios: lowest, highest of x, then of y
        ("noise", "f8", (2,)),  # standard deviation of the ratios
        ("center", "f8", (2,)),  # centre and scale of the ratios for tensor maps
        ("scale", "f8", (2,)),
        ("map_kind", "i8"),  # see model.spot_map
        ("map_lengths", "i8", (2,)),  # of a tensor map: both lengths of its tables; of curves: curves, coefficients
    ],
    align=True,
)

SPOT_POSITION = np.dtype(  # ratios and position of one spot, with memory for the basis functions of its map
    [
        ("ratios", "f8", (2,)),
        ("position", "f8", (2,)),  # [m]
        ("slope", "f8", (2, 2)),  # derivative of the position with respect to the ratios [m]
        ("basis", "f8", (4, MAX_MAP_LENGTH)),  # functions of the x ratio, their derivatives, the same for y
    ],
    align=True,
)


@in_place
def find_ratios(currents: FloatArray, i: int, diode: Any, spot: Any) -> int:
    """Write the ratios of the contact currents (4 d,) [A] of diode i; return VALID or why there are none."""
    for axis in range(2):
        plus, minus = currents[CONTACTS * i + axis], currents[CONTACTS * i + axis + 2]
        total = plus + minus
        if not math.isfinite(total):
            return NOT_FINITE
        if total < diode.least_sum:
            return DARK
        if total > diode.greatest_sum:
            return BRIGHT
        ratio = (plus - minus) / total
        spot.ratios[axis] = ratio
        if ratio < diode.domain[axis, 0] or ratio > diode.domain[axis, 1]:
            return OUTSIDE_X + axis
    return VALID
