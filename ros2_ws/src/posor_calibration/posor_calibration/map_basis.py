"""Linear least squares of diode positions on functions of the current ratios, and the choice of their order."""

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

WORTHWHILE = 0.95
"""A higher order must reduce the leave-one-out residual to this share to be chosen."""
COEFFICIENT_SCALE = 1e-3
"""Typical size of a coefficient [m]."""
SATURATED_LEVERAGE = 1e-9
"""A reading with less than this share of its own residual left determines the fit alone."""
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
