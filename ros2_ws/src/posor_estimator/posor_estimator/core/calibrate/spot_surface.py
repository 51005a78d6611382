"""Linear least squares of a diode's positions on functions of its ratios, and which order of these to take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev, polynomial

from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.procedure import Table
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

WORTH = 0.95
"""An order is worth its coefficients if it brings the leave-one-out residual down to this part of a lower order's."""
SCALE = 1e-3
"""Typical size of a coefficient [m]."""
UM = 1e-6


@dataclass(frozen=True)
class Design:
    """What the positions along one axis are a linear function of.

    Attributes:
        matrix: Value of each function at each stop, (d, c).
        names: Of the coefficients, (c,).

    """

    matrix: FloatArray
    names: tuple[str, ...]


def smooth_design(scaled: FloatArray, order: int) -> Design:
    """Return Chebyshev functions of both ratios up to a total order; ratios (d, 2) scaled to [-1, 1]."""
    functions = [chebyshev.chebvander(scaled[:, axis], order) for axis in range(2)]
    terms = smooth_terms(order)
    matrix = np.column_stack([functions[0][:, i] * functions[1][:, j] for i, j in terms])
    return Design(matrix, tuple(f"T{i} T{j}" for i, j in terms))


def smooth_terms(order: int) -> list[tuple[int, int]]:
    """Return the pairs (i, j) of a surface's functions, i + j up to the order."""
    return [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]


def curve_design(ratios: FloatArray, lines: IntArray, order: int) -> Design:
    """Return powers of one ratio (d,) on each line by itself; ``lines`` (d,) says which line a stop is on."""
    count = int(lines.max()) + 1
    powers = polynomial.polyvander(ratios, order)
    matrix = np.zeros((len(ratios), count, order + 1))
    matrix[np.arange(len(ratios)), lines] = powers
    names = tuple(f"line {line + 1} power {k}" for line in range(count) for k in range(order + 1))
    return Design(matrix.reshape(len(ratios), -1), names)


def left_out_residuals(design: Design, positions: FloatArray) -> FloatArray:
    """Return how far each position lies from the fit to all others [m], (d,); infinite where those do not suffice."""
    q, r = np.linalg.qr(design.matrix)
    if np.min(np.abs(np.diag(r))) <= 1e-12 * np.max(np.abs(np.diag(r))):
        return np.full(len(positions), np.inf)
    leverage = np.sum(np.square(q), axis=1)
    free = 1.0 - leverage
    residuals = positions - q @ (q.T @ positions)
    return np.where(free > 1e-9, residuals / np.maximum(free, 1e-9), np.inf)  # noqa: PLR2004


def chosen_order(
    design: Callable[[int, int], Design], positions: FloatArray, orders: Sequence[int], title: str
) -> tuple[int, Table]:
    """Return the order that predicts stops left out best, and the table of residual against order.

    Args:
        design: Of an order and an axis (0, 1).
        positions: [m], (d, 2).
        orders: To choose from, ascending.
        title: Of the table.

    Returns:
        The lowest order whose leave-one-out residual (root mean square over both axes) is not worse than 1 / ``WORTH``
        times the least, and the table.

    Raises:
        FitError: There are too few stops for any of the orders.

    """
    rows, scores = [], []
    for order in orders:
        fitted, left_out = [], []
        for axis in range(2):
            matrix = design(order, axis)
            if matrix.matrix.shape[1] >= len(positions):
                break
            found = np.linalg.lstsq(matrix.matrix, positions[:, axis], rcond=None)[0]
            freedoms = len(positions) - matrix.matrix.shape[1]
            fitted.append(np.sqrt(np.sum(np.square(positions[:, axis] - matrix.matrix @ found)) / freedoms))
            left_out.append(np.sqrt(np.mean(np.square(left_out_residuals(matrix, positions[:, axis])))))
        else:
            scores.append(float(np.hypot(*left_out)))
            rows.append((order, *(float(value) / UM for value in (*fitted, *left_out))))
    if not scores or not np.isfinite(scores).any():
        raise FitError(
            f"{len(positions)} stops are too few for order {orders[0]}", where=title, expected="more stops in the grid"
        )
    best = next(i for i, score in enumerate(scores) if score * WORTH <= min(scores))
    columns = ("order", "residual x", "residual y", "left out x", "left out y")
    return orders[best], Table(title, columns, ("", *["um"] * 4), tuple(rows))


def linear_fit(
    design: Design, positions: FloatArray, sigmas: FloatArray, axis: str, *, what: str
) -> tuple[Fit, BoolArray]:
    """Return the fit of coefficients [m] to positions (d,) of standard uncertainties (d,) [m], and the outliers (d,).

    Outliers are found against a robust fit and left out. The uncertainty follows the residuals of the others: what the
    functions cannot follow counts as scatter.
    """
    names = [f"{axis} {name}" for name in design.names]

    def fitted(kept: BoolArray, loss: Loss) -> Fit:
        matrix = design.matrix[kept] / sigmas[kept, None]
        goal = positions[kept] / sigmas[kept]
        return fit(
            lambda values: matrix @ values - goal,
            np.asarray(np.linalg.lstsq(matrix, goal, rcond=None)[0], dtype=float),
            names,
            ["m"] * len(names),
            np.full(len(names), SCALE),
            jacobian=lambda _: matrix,
            loss=loss,
            trust_sigmas=False,
            what=what,
        )

    outliers = fitted(np.ones(len(positions), dtype=bool), "soft_l1").outliers()
    return fitted(~outliers, "linear"), outliers
