"""Polynomials of a gap probe's voltage: fitted at every order, judged by cross-validation, one chosen.

Source: thesis 7.5.1; tables 7.3 to 7.6 list the residuals against the order, 7.10 the coefficients of the order chosen.
Inside, a polynomial is a sum of Chebyshev polynomials over the voltages that occur, which keeps every order well
conditioned; outside it is in powers of the voltage, as the calibration file has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from scipy.stats import theilslopes

from posor_estimator.core.calibrate.checks import IMPROBABLE, check_enough
from posor_estimator.core.calibrate.fit import Fit, fit
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.one_probe import OneProbe
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import BoolArray, FloatArray

Criterion: TypeAlias = Literal["cross_validation", "aicc"]

SPARE = 3
"""Readings that a polynomial must leave over, so that its residuals say something."""
LEAST_STOPS = 6
SMOOTH = 9
"""Order beyond which what a polynomial follows is no smooth curve; that of 1985."""
_UNKNOWN_SIGMA = 1e-9
"""Stands for an uncertainty that nobody stated [m]; the residuals then set the scale."""


@dataclass(frozen=True)
class GapData:
    """What one probe and the reference said at the stops.

    Attributes:
        scans: Mean scans, (d,).
        reference: Gaps, up to a constant [m], (d,).
        reference_sigmas: Their standard uncertainties [m], (d,).
        volt_sigmas: Standard uncertainties of the voltages [V], (d,).

    """

    scans: Scans
    reference: FloatArray
    reference_sigmas: FloatArray
    volt_sigmas: FloatArray

    def without(self, outliers: BoolArray) -> GapData:
        """Return the data without some stops."""
        kept = ~outliers
        return GapData(
            self.scans.chosen(kept), self.reference[kept], self.reference_sigmas[kept], self.volt_sigmas[kept]
        )


@dataclass(frozen=True)
class GapPolynomial:
    """A polynomial of one order.

    Attributes:
        coefficients: A_0, A_1, ... [m/V^k].
        covariance: Of them.
        fit: In terms of Chebyshev polynomials over ``span``.
        residuals: Polynomial less reference [m], (d,).
        residual_deviation: Their standard deviation, with the degrees of freedom left [m].
        left_out: What the polynomial through the other stops deviates from each stop [m], (d,).
        aicc: Akaike's information criterion, corrected for few data (Hurvich and Tsai 1989); less is better.
        is_monotonic: Whether there is one gap for each voltage over the span.
        span: Lowest and highest voltage, zero shift added [V].

    """

    coefficients: FloatArray
    covariance: FloatArray
    fit: Fit
    residuals: FloatArray
    residual_deviation: float
    left_out: FloatArray
    aicc: float
    is_monotonic: bool
    span: tuple[float, float]

    @property
    def order(self) -> int:
        """The highest power."""
        return len(self.coefficients) - 1

    @property
    def cross_validation(self) -> float:
        """Root mean square of what stops deviate from the polynomial through the others [m]."""
        return float(np.sqrt(np.mean(np.square(self.left_out))))


def fitted_orders(probe: OneProbe, data: GapData, most: int) -> list[GapPolynomial]:
    """Return the polynomials of order 1 to ``most``, or to as many as the stops allow.

    Raises:
        FitError: There are too few stops.

    """
    check_enough(len(data.reference), LEAST_STOPS, "stops that can be used", probe.name)
    sigmas, trusted = _sigmas(probe, data)
    return [
        _fitted(probe, data, order, sigmas, trusted=trusted)
        for order in range(1, min(most, len(data.reference) - SPARE) + 1)
    ]


def best(polynomials: list[GapPolynomial], criterion: Criterion, where: str) -> GapPolynomial:
    """Return the polynomial that the criterion prefers among those with one gap for each voltage.

    By cross-validation that is the lowest order that no other beats by more than one standard error of the difference
    (Breiman, Friedman, Olshen and Stone 1984, 3.4.3, here stop by stop): an order more that gains nothing only makes
    the coefficients vague.

    Raises:
        FitError: None has one gap for each voltage.

    """
    fit_ones = [polynomial for polynomial in polynomials if polynomial.is_monotonic]
    if not fit_ones:
        raise FitError(
            "no polynomial has one gap for each voltage", where=where, expected="a probe whose voltage rises"
        )
    least = min(fit_ones, key=lambda polynomial: getattr(polynomial, criterion))
    if criterion == "aicc":
        return least
    return next(polynomial for polynomial in fit_ones if not _beaten(polynomial, least))


def _beaten(polynomial: GapPolynomial, by: GapPolynomial) -> bool:
    """Return whether another polynomial foretells left-out stops better by more than chance would have it."""
    worse = np.square(polynomial.left_out) - np.square(by.left_out)
    return bool(np.mean(worse) > np.std(worse, ddof=1) / np.sqrt(len(worse)))


def outliers_of(probe: OneProbe, data: GapData) -> BoolArray:
    """Return which stops do not fit a smooth curve through the others, (d,): found by a robust fit of high order."""
    check_enough(len(data.reference), LEAST_STOPS, "stops that can be used", probe.name)
    order = min(SMOOTH, len(data.reference) // 3)
    sigmas, _ = _sigmas(probe, data)
    basis = _Basis(probe, data, order)
    found = basis.fitted(sigmas, "soft_l1", basis.start())
    return basis.fitted(sigmas, "cauchy", found.values).outliers()


class _Basis:
    """Chebyshev polynomials of a probe's voltages, through the sensor's own linearisation."""

    def __init__(self, probe: OneProbe, data: GapData, order: int) -> None:
        volts = probe.volts(data.scans)
        self.span = float(volts.min()), float(volts.max())
        self._probe, self._data = probe, data
        self.to_powers = np.zeros((order + 1, order + 1))
        for k in range(order + 1):
            powers = Chebyshev.basis(k, domain=self.span).convert(kind=Polynomial).coef
            self.to_powers[: len(powers), k] = powers
        self._constant = probe.gaps(data.scans, np.zeros(order + 1))
        self._effects = probe.effects(data.scans)
        self.design = np.column_stack([probe.gaps(data.scans, column) - self._constant for column in self.to_powers.T])

    def start(self) -> FloatArray:
        """Return a straight line that no outlier moves, as Chebyshev coefficients."""
        volts = self._probe.volts(self._data.scans)
        slope, intercept = theilslopes(self._data.reference, volts)[:2]
        line = Polynomial([intercept, slope]).convert(kind=Chebyshev, domain=self.span).coef
        return np.concatenate([line, np.zeros(len(self.to_powers) - 2)])

    def residuals(self, values: FloatArray) -> FloatArray:
        """Return polynomial less reference [m], (d,)."""
        return self._constant + self.design @ values - self._data.reference

    def fitted(
        self,
        sigmas: FloatArray,
        loss: Literal["linear", "soft_l1", "cauchy"],
        start: FloatArray,
        *,
        trust_sigmas: bool = True,
    ) -> Fit:
        size = len(start)
        return fit(
            lambda values: self.residuals(values) / sigmas,
            start,
            [f"T_{k}" for k in range(size)],
            ["m"] * size,
            np.full(size, float(np.ptp(self._data.reference))),
            jacobian=lambda values: self.design / sigmas[:, None],  # noqa: ARG005  the same at all values
            taken=self._effects / sigmas[:, None] if trust_sigmas else None,
            loss=loss,
            trust_sigmas=trust_sigmas,
            what=f"{self._probe.name}, order {size - 1}",
        )


def _sigmas(probe: OneProbe, data: GapData) -> tuple[FloatArray, bool]:
    """Return the standard uncertainty of polynomial less reference at each stop [m], and whether it is known at all."""
    order = max(1, min(LEAST_STOPS, len(data.reference) // 3))
    basis = _Basis(probe, data, order)
    flat = np.full(len(data.reference), 1e-3 * float(np.ptp(data.reference)))
    rough = basis.to_powers @ basis.fitted(flat, "soft_l1", basis.start()).values
    sigmas = np.hypot(data.reference_sigmas, probe.slopes(data.scans, rough) * data.volt_sigmas)
    known = bool(np.all(sigmas > 0.0))
    return (sigmas, True) if known else (np.full(len(sigmas), _UNKNOWN_SIGMA), False)


def aicc(mean_square: float, count: int, order: int) -> float:
    """Return Akaike's information criterion of a polynomial, corrected for few data.

    Args:
        mean_square: Of its residuals, in any unit; the criteria of two polynomials compare whatever the unit.
        count: Of the data.
        order: Of the polynomial.

    Returns:
        The criterion; infinite where there are too few data to tell.

    """
    told = order + 2  # the coefficients, and the scale of the residuals
    if count <= told + 1:
        return math.inf
    return count * math.log(mean_square) + 2.0 * told + 2.0 * told * (told + 1) / (count - told - 1)


def _fitted(probe: OneProbe, data: GapData, order: int, sigmas: FloatArray, *, trusted: bool) -> GapPolynomial:
    basis = _Basis(probe, data, order)
    found = basis.fitted(sigmas, "linear", basis.start(), trust_sigmas=trusted)
    if trusted and found.probability < IMPROBABLE:
        found = basis.fitted(sigmas, "linear", basis.start(), trust_sigmas=False)
    residuals = basis.residuals(found.values)
    count, size = len(residuals), order + 1
    root = np.linalg.qr(found.jacobian)[0]
    leverages = np.sum(np.square(root), axis=1)
    coefficients = basis.to_powers @ found.values
    slope = Polynomial(coefficients).deriv()(np.linspace(*basis.span, 257))
    return GapPolynomial(
        coefficients=coefficients,
        covariance=basis.to_powers @ found.covariance @ basis.to_powers.T,
        fit=found,
        residuals=residuals,
        residual_deviation=float(np.sqrt(np.sum(np.square(residuals)) / (count - size))),
        left_out=residuals / np.maximum(1.0 - leverages, 1e-9),
        aicc=aicc(float(np.mean(np.square(found.residuals))), count, order),
        is_monotonic=bool(np.all(slope > 0.0) or np.all(slope < 0.0)),
        span=basis.span,
    )
