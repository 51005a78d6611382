# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables, warnings and refusals that the fits of all procedures share."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError

from posor_calibration.data_checks import MOST_OUTLIERS
from posor_calibration.least_squares import weak_directions
from posor_calibration.procedure import Table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_calibration.least_squares import Fit

HIGH_CORRELATION = 0.9  # correlation above which two parameters are hard to separate
NAMED_OUTLIERS = 5
MOST_SPREAD = 10.0  # residuals over the stated uncertainties beyond which data and model do not belong together


def table_row(name: str | int, numbers: Iterable[float]) -> tuple[float | int | str, ...]:
    """Return a row of a table: a name and numbers."""
    return name, *map(float, numbers)


def parameter_table(title: str, fit: Fit, before: FloatArray, count: int) -> Table:
    """Return the first ``count`` parameters of a fit with their values before the fit, (count,)."""
    rows = tuple(
        (
            *table_row(fit.names[i], (before[i], fit.values[i], fit.sigmas[i])),
            fit.units[i],
            float((fit.values[i] - before[i]) / fit.sigmas[i]),
        )
        for i in range(count)
    )
    return Table(title, ("parameter", "before", "found", "sigma", "unit", "change / sigma"), ("",) * 6, rows)


def correlation_table(fit: Fit, count: int) -> Table:
    """Return the correlations of the first ``count`` parameters of a fit."""
    correlations = fit.correlations
    rows = tuple(table_row(fit.names[i], correlations[i, :count]) for i in range(count))
    return Table("correlations", ("", *fit.names[:count]), ("",) * (count + 1), rows)


def result_tables(title: str, fit: Fit, before: FloatArray, count: int) -> tuple[Table, Table]:
    """Return the first ``count`` parameters of a fit with their values before the fit, (count,), and correlations."""
    return parameter_table(title, fit, before, count), correlation_table(fit, count)


def enlarge_if_improbable(fit: Fit) -> Fit:
    """Return a fit without prior, its uncertainty enlarged if the residuals exceed the stated uncertainties."""
    if not fit.is_too_large:
        return fit
    covariance, cross_covariance = fit.covariance * fit.spread**2, fit.cross_covariance * fit.spread
    return replace(fit, covariance=covariance, cross_covariance=cross_covariance)


def describe_fit(fit: Fit, scales: FloatArray, count: int, readings: Sequence[str] = ()) -> tuple[str, ...]:
    """Return warnings of weakly determined parameters, correlations, outliers, and wrong stated uncertainties.

    ``scales`` (p,) are the prior standard uncertainties. The first ``count`` parameters are the procedure's result, the
    others are auxiliary. ``readings`` names each residual, (n,); empty: outliers are only counted.
    """
    sentences = [
        f"The data hardly determine {' and '.join(direction.names)}: along this combination "
        f"{direction.remaining:.2g} of the prior uncertainty remains."
        for direction in weak_directions(np.sqrt(fit.weights)[:, None] * fit.jacobian * scales, fit.names)
    ]
    correlations = fit.correlations
    sentences += [
        f"{fit.names[j]} and {fit.names[i]} are strongly correlated: {correlations[i, j]:.3f}."
        for i in range(count)
        for j in range(i)
        if abs(correlations[i, j]) > HIGH_CORRELATION
    ]
    return (*sentences, *describe_residuals(fit, readings))


def describe_residuals(fit: Fit, readings: Sequence[str] = ()) -> tuple[str, ...]:
    """Return warnings of outliers and of wrong stated uncertainties; ``readings`` as in ``describe_fit``."""
    sentences = []
    outliers = np.flatnonzero(fit.outliers())
    if outliers.size:
        named = [readings[i] for i in outliers[:NAMED_OUTLIERS]] if readings else []
        more = ", ..." if len(outliers) > len(named) else ""
        where = f" ({', '.join(named)}{more})" if named else ""
        sentences.append(
            f"{outliers.size} of {len(fit.residuals)} readings are outliers{where}, "
            f"the worst {np.max(np.abs(fit.residuals)):.1f} sigmas off."
        )
    return (*sentences, *describe_spread(fit))


def describe_spread(fit: Fit) -> tuple[str, ...]:
    """Return a warning if the residuals exceed the stated uncertainties, or are far below them."""
    if fit.is_too_large:
        return (f"{_ratio(fit).capitalize()}: these are too small, or the model is incomplete.",)
    return (f"{_excess(fit).capitalize()}.",) if fit.is_too_small else ()


def describe_enlargement(fit: Fit, where: str) -> tuple[str, ...]:
    """Return the same warning where the uncertainties are enlarged if the residuals exceed the stated ones."""
    if fit.is_too_large:
        return (f"{where}: {_ratio(fit)}; the uncertainties of the result are enlarged by this factor.",)
    return (f"{where}: {_excess(fit)}.",) if fit.is_too_small else ()


def _ratio(fit: Fit) -> str:
    return f"the residuals are {fit.spread:.3g} times as large as the stated uncertainties explain"


def _excess(fit: Fit) -> str:
    of_result = "the uncertainties of the result are too large as well"
    return f"{_ratio(fit)}: the stated uncertainties are too large, perhaps in another unit, and {of_result}"


def describe_rejected(rejected: BoolArray, names: Sequence[str], where: str) -> tuple[str, ...]:
    """Return the sentence that names the data that were left out as outliers, or none.

    ``rejected`` (n,) are the outliers among data with ``names`` (n,). Raises FitError: more than a tenth are outliers.
    """
    count = int(rejected.sum())
    if count > MOST_OUTLIERS * len(rejected):
        raise FitError(
            f"{count} of {len(rejected)} readings do not fit, such as {names[int(np.argmax(rejected))]}",
            where=where,
            expected=f"at most {100 * MOST_OUTLIERS:g} % outliers",
        )
    listed = ", ".join(name for name, out in zip(names, rejected, strict=True) if out)
    return (f"{where}: left out {listed}, which do not fit the others.",) if count else ()


def check_spread(fit: Fit, readings: Sequence[str], where: str) -> None:
    """Raise FitError if the residuals are far beyond the stated uncertainties.

    ``readings``: name of each residual, (n,); empty: the worst is not named.
    """
    if fit.spread > MOST_SPREAD and fit.is_too_large:
        worst = f", the worst is {readings[int(np.argmax(np.abs(fit.residuals)))]}" if readings else ""
        raise FitError(
            f"{_ratio(fit)}{worst}",
            where=where,
            expected=f"at most {MOST_SPREAD:g} times; state a larger uncertainty of the reference if it has one",
        )
