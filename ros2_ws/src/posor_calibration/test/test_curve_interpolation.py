# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error between the curves of a diode's map: exact for a parabola, right for a smooth map, wrong curves refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import polynomial
from posor.errors import FitError
from posor.numerics.array_types import FloatArray
from posor_calibration.map_basis import GRID_ERROR_RATIO, doubled_grid_errors, tabulate_interpolation

RATIOS = np.linspace(-0.8, 0.8, 21)
AT = np.linspace(-6.35e-3, 6.35e-3, 15)  # positions of fifteen curves over half an inch, as in 1985


def curves_of(at: FloatArray) -> FloatArray:
    """Return curves whose cubic coefficient changes smoothly across a simulated diode."""
    zero = np.zeros(len(at))
    return np.column_stack([zero, zero + 7e-3, zero, 1e-3 * np.cos(at / 4e-3)])


@pytest.mark.parametrize("at", [AT, np.array([-5e-3, -1e-3, 0.0, 3e-3])])
def test_curves_that_change_as_a_parabola_have_its_error(at: FloatArray) -> None:
    bend = 3.0
    curves = np.column_stack([bend * at**2 + 0.01 * at, 7e-3 + 0.1 * at])  # a linear change has no error
    expected = bend * (at[1:-1] - at[:-2]) * (at[2:] - at[1:-1])
    assert doubled_grid_errors(curves, at, RATIOS) == pytest.approx(np.tile(expected[:, None], len(RATIOS)))


def test_a_quarter_is_the_error_of_the_grid_itself() -> None:
    """Between the curves, the weighting of 1985 is compared with the simulated diode itself."""
    values = polynomial.polyval(RATIOS, curves_of(AT).T)
    middle = 0.5 * (AT[1:] + AT[:-1])
    weighted = np.array([np.interp(middle, AT, column) for column in values.T]).T
    actual = weighted - polynomial.polyval(RATIOS, curves_of(middle).T)
    table = tabulate_interpolation({"x": doubled_grid_errors(curves_of(AT), AT, RATIOS)})
    (axis, root_mean_square, largest), *_ = table.rows
    assert axis == "x"
    assert root_mean_square == pytest.approx(1e6 * np.sqrt(np.mean(actual**2)), rel=0.1)
    assert largest == pytest.approx(1e6 * np.abs(actual).max(), rel=0.02)
    halved = np.linspace(AT[0], AT[-1], 29)
    finer = doubled_grid_errors(curves_of(halved), halved, RATIOS)
    coarse = doubled_grid_errors(curves_of(AT), AT, RATIOS)
    assert np.abs(finer).max() / np.abs(coarse).max() == pytest.approx(GRID_ERROR_RATIO, rel=0.02)


@pytest.mark.parametrize(
    ("curves", "at", "message"),
    [
        (curves_of(AT)[:2], AT[:2], r"interpolation: 2 curves at 2 positions; expected at least 3 curves"),
        (curves_of(AT), AT[:5], "15 curves at 5 positions"),
        (curves_of(AT), AT[::-1], r"the positions of the curves do not ascend; expected ascending positions\."),
        (curves_of(AT), np.full(15, np.nan), "the positions of the curves do not ascend"),
    ],
)
def test_curves_without_a_grid_are_refused(curves: FloatArray, at: FloatArray, message: str) -> None:
    with pytest.raises(FitError, match=message):
        doubled_grid_errors(curves, at, RATIOS)
