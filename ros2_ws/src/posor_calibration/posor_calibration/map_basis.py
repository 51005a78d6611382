# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Diode positions as functions of the current ratios: least squares, the choice of the order, error between curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from posor.errors import FitError

from posor_calibration.fit_report import table_row
from posor_calibration.least_squares import Fit, Loss, fit_linear
from posor_calibration.procedure import Table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

WORTHWHILE = 0.95  # a higher order must reduce the leave-one-out residual to this share to be chosen
COEFFICIENT_SCALE = 1e-3  # typical size of a coefficient [m]
SATURATED_LEVERAGE = 1e-9  # a reading with less than this share of its own residual left determines the fit alone
FEWEST_CURVES = 3  # curves from which the error between them can be estimated
GRID_ERROR_RATIO = 0.25
"""Error of a grid over the error of one of twice the pitch: the error of a linear weighting goes by the square."""
UM = 1e-6


@dataclass(frozen=True)
class Design:
    """The functions whose linear combination gives the positions along one axis."""

    matrix: FloatArray  # value of each function at each dwell, (d, c)
    names: tuple[str, ...]  # of the coefficients, (c,)


def surface_design(scaled: FloatArray, order: int) -> Design:
    """Return Chebyshev functions of both ratios up to a total order; ratios (d, 2) scaled to [-1, 1]."""
    functions = [chebyshev.chebvander(scaled[:, axis], order) for axis in range(2)]
    terms = surface_terms(order)
    matrix = np.column_stack([functions[0][:, i] * functions[1][:, j] for i, j in terms])
    return Design(matrix, tuple(f"T{i} T{j}" for i, j in terms))


def surface_terms(order: int) -> list[tuple[int, int]]:
    """Return the pairs (i, j) of a surface's functions, i + j up to the order."""
    return [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]


def curve_design(ratios: FloatArray, lines: IntArray, order: int) -> Design:
    """Return powers of one ratio (d,), separately for each line of the grid; ``lines``: line of each dwell, (d,)."""
    count = int(lines.max()) + 1
    matrix = np.zeros((len(ratios), count, order + 1))
    matrix[np.arange(len(ratios)), lines] = polynomial.polyvander(ratios, order)
    names = tuple(f"line {line + 1} power {k}" for line in range(count) for k in range(order + 1))
    return Design(matrix.reshape(len(ratios), -1), names)


def leave_one_out_residuals(design: Design, positions: FloatArray) -> FloatArray:
    """Return the distance of each position from the fit to all others [m], (d,); infinite if these do not suffice."""
    q, r = np.linalg.qr(design.matrix)
    if np.min(np.abs(np.diag(r))) <= 1e-12 * np.max(np.abs(np.diag(r))):
        return np.full(len(positions), np.inf)
    free = 1.0 - np.sum(np.square(q), axis=1)
    residuals = positions - q @ (q.T @ positions)
    return np.where(free > SATURATED_LEVERAGE, residuals / np.maximum(free, SATURATED_LEVERAGE), np.inf)


def choose_order(
    design: Callable[[int, int], Design], positions: FloatArray, orders: Sequence[int], title: str
) -> tuple[int, Table]:
    """Return the lowest order whose leave-one-out residual is nearly the least, and the table against order.

    The residual is the root mean square over both axes; it may be 1 / ``WORTHWHILE`` times the least. ``design`` is
    called with an order and an axis (0, 1); ``positions`` [m] are (d, 2). Raises FitError: there are too few dwells for
    any of the orders.
    """
    rows, scores = [], []
    for order in orders:
        fitted, left_out = [], []
        for axis in range(2):
            candidate = design(order, axis)
            freedoms = len(positions) - candidate.matrix.shape[1]
            if freedoms <= 0:
                break
            residuals = (
                positions[:, axis]
                - candidate.matrix @ np.linalg.lstsq(candidate.matrix, positions[:, axis], rcond=None)[0]
            )
            fitted.append(np.sqrt(np.sum(np.square(residuals)) / freedoms))
            left_out.append(np.sqrt(np.mean(np.square(leave_one_out_residuals(candidate, positions[:, axis])))))
        else:
            scores.append(float(np.hypot(*left_out)))
            rows.append(table_row(order, np.array([*fitted, *left_out]) / UM))
    if not scores or not np.isfinite(scores).any():
        raise FitError(
            f"{len(positions)} dwells are too few for order {orders[0]}",
            where=title,
            expected="more dwells in the grid",
        )
    best = next(i for i, score in enumerate(scores) if score * WORTHWHILE <= min(scores))
    columns = ("order", "residual x", "residual y", "left out x", "left out y")
    return orders[best], Table(title, columns, ("", *["um"] * 4), tuple(rows))


def fit_positions(
    design: Design, positions: FloatArray, sigmas: FloatArray, axis: str, *, what: str
) -> tuple[Fit, BoolArray]:
    """Return the fit of coefficients [m] to positions (d,) with standard uncertainties (d,) [m], and the outliers (d,).

    Outliers of a robust fit are left out. The uncertainty follows the residuals of the others, so the misfit of
    the functions counts as scatter.
    """
    names = [f"{axis} {name}" for name in design.names]

    def fit(valid: BoolArray, loss: Loss) -> Fit:
        matrix, goal, own = design.matrix[valid], positions[valid], sigmas[valid]
        start = np.asarray(np.linalg.lstsq(matrix / own[:, None], goal / own, rcond=None)[0], dtype=float)
        scales = np.full(len(names), COEFFICIENT_SCALE)
        return fit_linear(
            matrix, goal, own, start, names, ["m"] * len(names), scales, loss=loss, trust_sigmas=False, what=what
        )

    outliers = fit(np.ones(len(positions), dtype=bool), "soft_l1").outliers()
    return fit(~outliers, "linear"), outliers


def doubled_grid_errors(curves: FloatArray, at: FloatArray, ratios: FloatArray) -> FloatArray:
    """Return the errors that the weighting would have on a grid of twice the pitch [m], (n - 2, r).

    Each inner curve is left out and weighted from its two neighbours; the error is the weighted less the actual
    position, as in thesis 8.3.3. It contains the noise of the three fits. ``curves`` are the coefficients of each
    curve, from the constant to the highest power [m], (n, order + 1); ``at`` the ascending positions of the curves
    across [m], (n,); ``ratios`` (r,) those at which the curves are compared. Raises FitError: there are fewer than
    three curves, or their positions do not ascend.
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
