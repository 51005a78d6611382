"""Error of the linear weighting between the curves of a diode's map, by doubling of the grid (thesis 8.3.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial
from posor.errors import FitError

from posor_calibration.map_basis import UM
from posor_calibration.procedure import Table

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

FEWEST_CURVES = 3
GRID_ERROR_RATIO = 0.25
"""Error of a grid over the error of one of twice the pitch: the error of a linear weighting goes by the square."""


def doubled_grid_errors(curves: FloatArray, at: FloatArray, ratios: FloatArray) -> FloatArray:
    """Return the errors that the weighting would have on a grid of twice the pitch [m], (n - 2, r).

    Each inner curve is left out and weighted from its two neighbours; the error is the weighted less the actual
    position, as in the thesis. It contains the noise of the three fits. ``curves`` are the coefficients of each curve,
    from the constant to the highest power [m], (n, order + 1); ``at`` the ascending positions of the curves across [m],
    (n,); ``ratios`` (r,) those at which the curves are compared. Raises FitError: there are fewer than three curves, or
    their positions do not ascend.
    """
    if len(curves) < FEWEST_CURVES or len(at) != len(curves):
        what = f"{len(curves)} curves at {len(at)} positions"
        raise FitError(what, where="interpolation", expected=f"at least {FEWEST_CURVES} curves, each with its position")
    if not np.all(np.diff(at) > 0.0):
        raise FitError(
            "the positions of the curves do not ascend", where="interpolation", expected="ascending positions"
        )
    values = polynomial.polyval(ratios, curves.T)  # (n, r)
    weights = ((at[1:-1] - at[:-2]) / (at[2:] - at[:-2]))[:, None]
    errors: FloatArray = (1.0 - weights) * values[:-2] + weights * values[2:] - values[1:-1]
    return errors


def tabulate_interpolation(axes: dict[str, FloatArray]) -> Table:
    """Return the estimated error of the grid itself: a quarter of the errors of the doubled grid, by axis."""
    rows = tuple(
        (
            axis,
            GRID_ERROR_RATIO * float(np.sqrt(np.mean(np.square(errors)))) / UM,
            GRID_ERROR_RATIO * float(np.abs(errors).max()) / UM,
        )
        for axis, errors in axes.items()
    )
    title = "interpolation between curves, by doubling of the grid (thesis 8.3.3)"
    return Table(title, ("axis", "root mean square", "largest"), ("", "um", "um"), rows)
