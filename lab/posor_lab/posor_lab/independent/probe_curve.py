# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From the distance that a probe measures to its voltage, by a table of its curve."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

FloatArray = NDArray[np.float64]

TABLE_POINTS = 257
"""Points of the table. A curve of six volts to either side is then inverted to better than 1e-10 V."""


class ProbeCurve:
    """Voltage of one probe. The file states the gap by the voltage: a polynomial, and linear effects of surroundings.

    A change of the supply or the temperature moves the reading as a change of the gap by ``sensitivity`` times the
    deviation from ``reference`` would.
    """

    def __init__(
        self, span: FloatArray, coefficients: FloatArray, zero_shift: float, supply: FloatArray, temperature: FloatArray
    ) -> None:
        """Tabulate the curve.

        ``span``: lowest and highest shifted voltage; ``coefficients``: of the gap [m/V^k]; ``zero_shift``: [V], added
        to a voltage before it; ``supply``, ``temperature``: sensitivity [m/V], [m/K] and reference [V], [K].
        """
        volts = np.linspace(span[0], span[1], TABLE_POINTS)
        gaps = polynomial.polyval(volts, coefficients)
        slopes = 1.0 / polynomial.polyval(volts, polynomial.polyder(coefficients))
        order = slice(None, None, 1 if gaps[0] < gaps[-1] else -1)
        self._curve = CubicHermiteSpline(gaps[order], volts[order], slopes[order], extrapolate=False)
        self._zero_shift, self._supply, self._temperature = zero_shift, supply, temperature

    def voltages(self, gaps: FloatArray, supplies: FloatArray, temperatures: FloatArray) -> FloatArray:
        """Return the voltages at gaps [m], (n,); NaN outside the span, and no effect where surroundings are NaN."""
        for values, (sensitivity, reference) in ((supplies, self._supply), (temperatures, self._temperature)):
            gaps = gaps - np.where(np.isfinite(values), sensitivity * (values - reference), 0.0)
        return np.asarray(self._curve(gaps) - self._zero_shift)
