# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Polynomials from a gap probe's voltage to its gap: fitted at every order, compared, one selected.

Source: thesis 7.5.1; tables 7.3 to 7.6 list the residuals against the order, table 7.10 the coefficients. The fit uses
Chebyshev polynomials over the voltages that occur, which are well conditioned at every order; results are coefficients
of powers of the voltage, as in the calibration file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from posor.errors import FitError

from posor_calibration.data_checks import check_count
from posor_calibration.gap_probe_data import MIN_DWELLS
from posor_calibration.least_squares import Fit, Loss, fit_linear

if TYPE_CHECKING:
    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_calibration.gap_probe_data import GapData, SingleProbe

Criterion: TypeAlias = Literal["cross_validation", "aicc"]

SPARE_READINGS = 3  # degrees of freedom that a fit must leave
HIGHEST_SMOOTH_ORDER = 9  # order of the robust fit that finds outliers, as in 1985
ROUGH_ORDER = 6  # order of the robust fit that gives the slopes for the uncertainties
PLACEHOLDER_SIGMA = 1e-9  # used where no uncertainty is stated [m]; the residuals then scale the covariance
MONOTONIC_POINTS = 257


@dataclass(frozen=True)
class GapPolynomial:
    """A fitted polynomial of one order."""

    coefficients: FloatArray  # A_0, A_1, ... [m/V^k]
    covariance: FloatArray  # of the coefficients
    fit: Fit  # of Chebyshev coefficients over ``span``
    residuals: FloatArray  # polynomial less reference [m], (d,)
    residual_deviation: float  # their standard deviation with the degrees of freedom left [m]
    left_out: FloatArray  # deviation of each dwell from the polynomial through the others [m], (d,)
    aicc: float  # Akaike's criterion corrected for few data (Hurvich and Tsai 1989); less is better
    is_monotonic: bool  # over the span
    span: tuple[float, float]  # lowest and highest voltage, zero shift added [V]

    @property
    def order(self) -> int:
        """The highest power."""
        return len(self.coefficients) - 1

    @property
    def cross_validation(self) -> float:
        """Root mean square of ``left_out`` [m]."""
        return float(np.sqrt(np.mean(np.square(self.left_out))))


def fit_orders(probe: SingleProbe, data: GapData, highest: int) -> list[GapPolynomial]:
    """Return the polynomials of order 1 to ``highest``, as far as the dwells allow. Raises FitError: too few dwells."""
    check_count(len(data.reference), MIN_DWELLS, "usable dwells", probe.name)
    orders = range(1, min(highest, len(data.reference) - SPARE_READINGS) + 1)
    powers = _Powers(probe, data, max(*orders, ROUGH_ORDER))
    sigmas, stated = _estimate_sigmas(powers)
    return [_fit_order(powers, order, sigmas, stated=stated) for order in orders]


def select_polynomial(polynomials: list[GapPolynomial], criterion: Criterion, where: str) -> GapPolynomial:
    """Return the monotonic polynomial that the criterion prefers.

    ``aicc`` prefers the least. ``cross_validation`` prefers the lowest order that no other beats by more than one
    standard error of the difference (Breiman, Friedman, Olshen and Stone 1984, 3.4.3, dwell by dwell): a useless order
    more would only enlarge the uncertainty of the coefficients. Raises FitError: no polynomial is monotonic.
    """
    monotonic = [polynomial for polynomial in polynomials if polynomial.is_monotonic]
    if not monotonic:
        raise FitError(
            "no polynomial has one gap for each voltage", where=where, expected="a probe whose voltage rises"
        )
    least = min(monotonic, key=lambda polynomial: getattr(polynomial, criterion))
    if criterion == "aicc":
        return least
    return next(polynomial for polynomial in monotonic if not _predicts_better(least, polynomial))


def _predicts_better(candidate: GapPolynomial, polynomial: GapPolynomial) -> bool:
    gain = np.square(polynomial.left_out) - np.square(candidate.left_out)
    return bool(np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(len(gain)))


def find_outliers(probe: SingleProbe, data: GapData) -> BoolArray:
    """Return which dwells do not fit a smooth curve through the others, (d,), by a robust fit of high order."""
    check_count(len(data.reference), MIN_DWELLS, "usable dwells", probe.name)
    powers = _Powers(probe, data, HIGHEST_SMOOTH_ORDER)
    sigmas, _ = _estimate_sigmas(powers)
    basis = _Basis(powers, min(HIGHEST_SMOOTH_ORDER, len(data.reference) // 3))
    found = basis.fit(sigmas, "soft_l1", basis.start())
    return basis.fit(sigmas, "cauchy", found.values).outliers()


class _Powers:
    """Gaps as a function of the coefficients of a probe's polynomial, which are linear in them: d dwells.

    Attributes:
        span: Lowest and highest voltage, zero shift added [V].
        constant: Gaps where all coefficients are zero [m], (d,).
        columns: d(gap)/d(coefficient) up to the highest order [V^k], (d, highest + 1).
        effects: See ``SingleProbe.environment_effects``.
        line: Slope [m/V] and intercept [m] of a straight line that is robust against outliers.

    """

    def __init__(self, probe: SingleProbe, data: GapData, highest: int) -> None:
        from scipy.stats import theilslopes  # noqa: PLC0415  takes half a second to load

        self.probe, self.data = probe, data
        volts = probe.shifted_volts(data.scans)
        self.span = float(volts.min()), float(volts.max())
        self.constant = probe.gaps(data.scans, np.zeros(highest + 1))
        self.columns = np.column_stack([probe.gaps(data.scans, unit) - self.constant for unit in np.eye(highest + 1)])
        self.effects = probe.environment_effects(data.scans)
        self.line = theilslopes(data.reference, volts)[:2]


class _Basis:
    """Chebyshev polynomials of a probe's voltages, through the sensor's own linearisation."""

    def __init__(self, powers: _Powers, order: int) -> None:
        self.span, self._powers, self._data = powers.span, powers, powers.data
        self.to_powers = np.zeros((order + 1, order + 1))
        for k in range(order + 1):
            terms = Chebyshev.basis(k, domain=self.span).convert(kind=Polynomial).coef
            self.to_powers[: len(terms), k] = terms
        self._design = powers.columns[:, : order + 1] @ self.to_powers

    def start(self) -> FloatArray:
        """Return the robust straight line as Chebyshev coefficients."""
        slope, intercept = self._powers.line
        line = Polynomial([intercept, slope]).convert(kind=Chebyshev, domain=self.span).coef
        return np.concatenate([line, np.zeros(len(self.to_powers) - 2)])

    def residuals(self, values: FloatArray) -> FloatArray:
        """Return polynomial less reference [m], (d,)."""
        return self._powers.constant + self._design @ values - self._data.reference

    def fit(self, sigmas: FloatArray, loss: Loss, start: FloatArray, *, trust_sigmas: bool = True) -> Fit:
        """Return the fit of Chebyshev coefficients [m] with standard uncertainties of the residuals [m], (d,)."""
        size = len(start)
        return fit_linear(
            self._design,
            self._data.reference - self._powers.constant,
            sigmas,
            start,
            [f"T_{k}" for k in range(size)],
            ["m"] * size,
            np.full(size, float(np.ptp(self._data.reference))),
            fixed_effects=self._powers.effects if trust_sigmas else None,
            loss=loss,
            trust_sigmas=trust_sigmas,
            what=f"{self._powers.probe.name}, order {size - 1}",
        )


def _estimate_sigmas(powers: _Powers) -> tuple[FloatArray, bool]:
    """Return the standard uncertainty of polynomial less reference at each dwell [m], and whether it is known."""
    probe, data = powers.probe, powers.data
    basis = _Basis(powers, min(ROUGH_ORDER, len(data.reference) // 3))
    equal = np.full(len(data.reference), 1e-3 * float(np.ptp(data.reference)))
    rough = basis.to_powers @ basis.fit(equal, "soft_l1", basis.start()).values
    sigmas = np.hypot(data.reference_sigmas, probe.slopes(data.scans, rough) * data.volt_sigmas)
    return (sigmas, True) if np.all(sigmas > 0.0) else (np.full(len(sigmas), PLACEHOLDER_SIGMA), False)


def akaike_criterion(mean_square: float, count: int, order: int) -> float:
    """Return Akaike's information criterion of a polynomial, corrected for few data; infinite for too few.

    The criteria of two polynomials compare whatever the unit of the residuals' mean square.
    """
    parameters = order + 2  # the coefficients, and the scale of the residuals
    if count <= parameters + 1:
        return math.inf
    correction = 2.0 * parameters * (parameters + 1) / (count - parameters - 1)
    return count * math.log(mean_square) + 2.0 * parameters + correction


def _fit_order(powers: _Powers, order: int, sigmas: FloatArray, *, stated: bool) -> GapPolynomial:
    basis = _Basis(powers, order)
    found = basis.fit(sigmas, "linear", basis.start(), trust_sigmas=stated)
    if stated and found.is_too_large:
        found = basis.fit(sigmas, "linear", basis.start(), trust_sigmas=False)
    residuals = basis.residuals(found.values)
    leverages = np.sum(np.square(np.linalg.qr(found.jacobian)[0]), axis=1)
    coefficients = basis.to_powers @ found.values
    slope = Polynomial(coefficients).deriv()(np.linspace(*basis.span, MONOTONIC_POINTS))
    return GapPolynomial(
        coefficients=coefficients,
        covariance=basis.to_powers @ found.covariance @ basis.to_powers.T,
        fit=found,
        residuals=residuals,
        residual_deviation=float(np.sqrt(np.sum(np.square(residuals)) / (len(residuals) - order - 1))),
        left_out=residuals / np.maximum(1.0 - leverages, 1e-9),
        aicc=akaike_criterion(float(np.mean(np.square(found.residuals))), len(residuals), order),
        is_monotonic=bool(np.all(slope > 0.0) or np.all(slope < 0.0)),
        span=basis.span,
    )
