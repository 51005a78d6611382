"""Tables and warnings that every fit's outcome has."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.directions import weak_directions
from posor_estimator.core.calibrate.procedure import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.types import FloatArray

CORRELATED = 0.9
"""Correlation from which two parameters are said to be hard to tell apart."""
NAMED_OUTLIERS = 5
"""So many outliers are named, the others counted."""
SPREAD_PROBABILITY = 1e-3
"""Of a spread at least so large if the stated uncertainties are right: below it they are not believed."""


def parameter_table(title: str, fit: Fit, before: FloatArray, count: int) -> Table:
    """Return the first ``count`` parameters of a fit: before (count,), found, sigma, change in sigmas."""
    rows = tuple(
        (
            fit.names[i],
            float(before[i]),
            float(fit.values[i]),
            float(fit.sigmas[i]),
            fit.units[i],
            float((fit.values[i] - before[i]) / fit.sigmas[i]),
        )
        for i in range(count)
    )
    return Table(title, ("parameter", "before", "found", "sigma", "unit", "change / sigma"), ("",) * 6, rows)


def row(name: str, numbers: FloatArray) -> tuple[float | int | str, ...]:
    """Return a row of a table: a name and numbers (n,)."""
    return name, *(float(number) for number in numbers)


def correlation_table(fit: Fit, count: int) -> Table:
    """Return the correlations of the first ``count`` parameters of a fit."""
    correlations = fit.correlations
    rows = tuple(row(fit.names[i], correlations[i, :count]) for i in range(count))
    return Table("correlations", ("", *fit.names[:count]), ("",) * (count + 1), rows)


def honest(fit: Fit) -> Fit:
    """Return a fit without prior; its uncertainty is enlarged where the residuals exceed the stated uncertainties."""
    if not fit.freedoms or fit.probability >= SPREAD_PROBABILITY:
        return fit
    return replace(fit, covariance=fit.covariance * fit.spread**2, across=fit.across * fit.spread)


def fit_warnings(fit: Fit, scales: FloatArray, count: int, readings: Sequence[str] = ()) -> tuple[str, ...]:
    """Return sentences on what the data hardly tell, on outliers, and on uncertainties that do not hold.

    Args:
        fit: The fit.
        scales: What was known of each of its parameters before, (p,).
        count: How many of them, the first, are asked for; the others only help.
        readings: What to call each residual, (n,); none: outliers are counted only.

    """
    said = []
    for direction in weak_directions(np.sqrt(fit.weights)[:, None] * fit.jacobian * scales, fit.names):
        together = " and ".join(direction.names)
        said.append(
            f"The data hardly tell {together}{' apart' if len(direction.names) > 1 else ''}: along this combination "
            f"{direction.remaining:.2g} of the uncertainty before remains."
        )
    correlations = fit.correlations
    said += [
        f"{fit.names[j]} and {fit.names[i]} vary together: correlation {correlations[i, j]:.3f}."
        for i in range(count)
        for j in range(i)
        if abs(correlations[i, j]) > CORRELATED
    ]
    return (*said, *residual_warnings(fit, readings))


def residual_warnings(fit: Fit, readings: Sequence[str] = ()) -> tuple[str, ...]:
    """Return sentences on outliers, and on uncertainties that do not hold; ``readings`` as of ``fit_warnings``."""
    said = []
    outliers = np.flatnonzero(fit.outliers())
    if outliers.size:
        named = [readings[i] for i in outliers[:NAMED_OUTLIERS]] if readings else []
        more = ", ..." if len(outliers) > len(named) else ""
        where = f" ({', '.join(named)}{more})" if named else ""
        said.append(
            f"{outliers.size} of {len(fit.residuals)} readings are outliers{where}, "
            f"the worst {np.max(np.abs(fit.residuals)):.1f} sigmas off."
        )
    if fit.freedoms and fit.probability < SPREAD_PROBABILITY:
        said.append(
            f"The residuals are {fit.spread:.2g} times as large as the stated uncertainties let expect: these are too "
            "small, or the model lacks something."
        )
    return tuple(said)
