"""Least squares with an honest account: covariance, residuals, outliers, and what the data cannot tell apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_estimator.core.types import BoolArray, FloatArray

Loss: TypeAlias = Literal["linear", "huber", "soft_l1", "cauchy"]

ROBUST_SCALE = 2.0
"""Normalised residual from which a robust loss counts less than a square."""
BLIND = 1e-9
"""Of the largest singular value: below this the data say nothing at all."""
UNTOLD = 0.5
"""A direction whose standard uncertainty stays above this part of what was known before is not told by the data."""
NAMED = 0.3
"""Parameters with at least this share in a direction are named."""


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the data determine badly.

    Attributes:
        shares: Components of the unit direction, of the parameters scaled by what was known of them before, (p,).
        remaining: Standard uncertainty along it after the fit, over that before; infinite where the data are blind.
        names: The parameters with the largest shares.

    """

    shares: FloatArray
    remaining: float
    names: tuple[str, ...]


@dataclass(frozen=True)
class Fit:
    """Outcome of a fit.

    Attributes:
        names: Name of each parameter, (p,).
        units: Unit of each parameter, (p,).
        values: Estimates, (p,).
        covariance: (p, p) (JCGM 100, 5.2; JCGM 102 for more than one output quantity).
        residuals: Normalised: each over its own standard uncertainty, (n,).
        weights: Weight of each residual under the loss, 1 for full weight, (n,).
        jacobian: d(normalised residual)/d(parameter), (n, p).
        freedoms: Residuals less parameters.
        spread: Root of chi-square over the freedoms: 1 if the stated uncertainties of the readings are right.

    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    weights: FloatArray
    jacobian: FloatArray
    freedoms: int
    spread: float

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlations(self) -> FloatArray:
        """(p, p)."""
        sigmas = self.sigmas
        return self.covariance / np.outer(sigmas, sigmas)

    @property
    def probability(self) -> float:
        """Probability of a chi-square at least this large if model and stated uncertainties are right."""
        return float(chi2.sf(self.spread**2 * self.freedoms, self.freedoms)) if self.freedoms else 1.0

    def value(self, name: str) -> float:
        """Return one parameter."""
        return float(self.values[self.names.index(name)])

    def sigma(self, name: str) -> float:
        """Return one parameter's standard uncertainty."""
        return float(self.sigmas[self.names.index(name)])

    def outliers(self, probability: float = 1e-3) -> BoolArray:
        """Return which residuals are larger than any of so many should be, (n,) of truth values.

        Args:
            probability: Of naming one although all are sound (Bonferroni).

        """
        limit = norm.isf(0.5 * probability / max(len(self.residuals), 1))
        return np.asarray(np.abs(self.residuals) > limit * max(1.0, self._core_spread()))

    def _core_spread(self) -> float:
        """Return the spread of the bulk of the residuals: median of their sizes, as a standard deviation."""
        return float(np.median(np.abs(self.residuals)) / norm.ppf(0.75))


def fit(
    residuals: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    names: Sequence[str],
    units: Sequence[str],
    scales: FloatArray,
    *,
    loss: Loss = "linear",
    trust_sigmas: bool = True,
    what: str = "the fit",
) -> Fit:
    """Fit parameters to normalised residuals.

    Args:
        residuals: Given parameters (p,), the residuals over their standard uncertainties, (n,).
        start: Where to begin, (p,).
        names: Of the parameters.
        units: Of the parameters.
        scales: Typical size of each parameter's correction, positive, (p,): what was known before.
        loss: Robust where outliers are to be survived.
        trust_sigmas: Whether the stated uncertainties of the readings hold (JCGM 100, 4.3); if not, the covariance is
            scaled by what the residuals show (4.2).
        what: What to call the fit in complaints.

    Raises:
        FitError: There are fewer readings than parameters, the fit does not settle, or the readings do not determine
            all parameters; it names those that they cannot tell apart.

    """
    names, units = tuple(names), tuple(units)
    count = len(residuals(start))
    if count < len(names):
        raise FitError(f"{count} readings for {len(names)} parameters", where=what, expected="as many at least")

    def of_scaled(x: FloatArray) -> FloatArray:
        return residuals(start + scales * x)

    try:
        found = least_squares(
            of_scaled,
            np.zeros(len(names)),
            loss=loss,
            f_scale=ROBUST_SCALE,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-12,
            x_scale=1.0,
            max_nfev=200,
        )
    except ValueError as error:
        raise FitError(f"cannot begin: {error}", where=what, expected="finite residuals at the start") from error
    if not found.success:
        raise FitError("does not settle within 200 evaluations", where=what, expected="data that fit the model")
    values = start + scales * found.x
    normalised = residuals(values)
    scaled = derivatives(residuals, values, scales)
    blind = [direction for direction in weak_directions(scaled, names) if np.isinf(direction.remaining)]
    if blind:
        raise FitError(
            f"the readings do not tell {' and '.join(blind[0].names)} apart"
            if len(blind[0].names) > 1
            else f"the readings say nothing of {blind[0].names[0]}",
            where=what,
            expected="readings at other poses, or fewer parameters",
        )
    weights = _weights(normalised, loss)
    information = scaled.T @ (weights[:, None] * scaled)
    inverse = np.linalg.inv(information)
    if loss != "linear":
        # With outliers the residuals are not as stated: the sandwich of their own squares (Huber, White).
        inverse = inverse @ (scaled.T @ (np.square(weights * normalised)[:, None] * scaled)) @ inverse
    freedoms = count - len(names)
    spread = float(np.sqrt(np.sum(weights * np.square(normalised)) / freedoms)) if freedoms else 1.0
    if loss == "linear" and not trust_sigmas:
        inverse = inverse * spread**2
    return Fit(
        names=names,
        units=units,
        values=values,
        covariance=np.outer(scales, scales) * inverse,
        residuals=normalised,
        weights=weights,
        jacobian=scaled / scales,
        freedoms=freedoms,
        spread=spread,
    )


def derivatives(residuals: Callable[[FloatArray], FloatArray], values: FloatArray, scales: FloatArray) -> FloatArray:
    """Return d(residual)/d(parameter over its scale) by central differences, (n, p)."""
    step = 1e-4
    columns = []
    for index, scale in enumerate(scales):
        shift = np.zeros(len(values))
        shift[index] = step * scale
        columns.append((residuals(values + shift) - residuals(values - shift)) / (2.0 * step))
    return np.column_stack(columns)


def weak_directions(scaled_jacobian: FloatArray, names: Sequence[str]) -> tuple[Direction, ...]:
    """Return the combinations of parameters that readings tell badly, the worst first.

    Args:
        scaled_jacobian: d(normalised residual)/d(parameter over what was known of it before), (n, p).
        names: Of the parameters, (p,).

    """
    size = len(names)
    padded = np.vstack([scaled_jacobian, np.zeros((max(0, size - len(scaled_jacobian)), size))])
    _, singular, directions = np.linalg.svd(padded, full_matrices=False)
    found = []
    for value, shares in zip(singular[::-1], directions[::-1], strict=True):
        remaining = np.inf if value <= BLIND * singular[0] else 1.0 / value
        if remaining < UNTOLD:
            break
        order = np.argsort(-np.abs(shares))
        named = tuple(names[i] for i in order if abs(shares[i]) >= NAMED) or (names[order[0]],)
        found.append(Direction(shares, float(remaining), named))
    return tuple(found)


def telling(direction: Direction, candidates: Sequence[FloatArray]) -> list[int]:
    """Return which readings would tell a weak direction best: indices of candidates, the best first.

    Args:
        direction: What the data at hand do not tell.
        candidates: For each candidate pose its scaled Jacobian, (m, p).

    """
    gains = [float(np.sum(np.square(candidate @ direction.shares))) for candidate in candidates]
    return [int(index) for index in np.argsort(-np.array(gains), kind="stable")]


def _weights(normalised: FloatArray, loss: Loss) -> FloatArray:
    """Return the derivative of the loss with respect to the squared residual, 1 for a small one, (n,)."""
    size = np.abs(normalised) / ROBUST_SCALE
    if loss == "huber":
        return np.where(size <= 1.0, 1.0, 1.0 / np.maximum(size, 1.0))
    if loss == "soft_l1":
        return 1.0 / np.sqrt(1.0 + np.square(size))
    if loss == "cauchy":
        return 1.0 / (1.0 + np.square(size))
    return np.ones_like(size)
