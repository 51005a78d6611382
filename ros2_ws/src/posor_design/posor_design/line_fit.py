# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Straight line through points: by least squares, and in the middle of the narrowest band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.errors import ParameterError
from scipy.optimize import linprog

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray


@dataclass(frozen=True)
class Line:
    """Straight line y = intercept + slope x through points."""

    intercept: float  # intercept of the least squares line
    slope: float  # slope of the least squares line
    standard_deviation: float  # standard deviation of the residuals, with n - 2 degrees of freedom
    largest_residual: float  # largest absolute residual
    peak_to_valley: float  # largest less least residual
    band: float  # width along y of the narrowest band between two parallel lines that holds all points


def fit_line(x: Sequence[float], y: Sequence[float], x_name: str) -> Line:
    """Return the straight lines through three points or more; ``x_name`` is for errors.

    Raises ParameterError: all x are equal.
    """
    middle, half = (max(x) + min(x)) / 2.0, (max(x) - min(x)) / 2.0
    if half <= 0.0:
        raise ParameterError("all values are equal", where=x_name, expected="different values")
    along = (np.asarray(x, dtype=float) - middle) / half  # -1 to 1: neither solution depends on unit and origin
    basis = np.column_stack([np.ones(len(along)), along])
    coefficients = np.linalg.lstsq(basis, np.asarray(y, dtype=float), rcond=None)[0]
    residuals = np.asarray(y, dtype=float) - basis @ coefficients
    slope = float(coefficients[1]) / half
    return Line(
        intercept=float(coefficients[0]) - slope * middle,
        slope=slope,
        standard_deviation=float(np.sqrt(np.sum(residuals**2) / (len(x) - 2))),
        largest_residual=float(np.abs(residuals).max()),
        peak_to_valley=float(np.ptp(residuals)),
        band=_narrowest_band(basis, residuals),
    )


def _narrowest_band(basis: FloatArray, residuals: FloatArray) -> float:
    """Return the least width of a band of any slope that holds all residuals, by linear programming."""
    scale = float(np.abs(residuals).max())
    if scale == 0.0:
        return 0.0
    goal = residuals / scale
    ones = np.ones((len(goal), 1))
    found: Any = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.block([[basis, -ones], [-basis, -ones]]),
        b_ub=np.concatenate([goal, -goal]),
        bounds=[(None, None), (None, None), (0.0, None)],
    )
    return 2.0 * scale * float(found.fun)
