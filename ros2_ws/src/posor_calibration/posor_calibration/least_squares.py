# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Least squares with full covariance, robust losses, priors, and refusal of parameters that the data do not determine.

The minimum is found by ``scipy.optimize.least_squares``. Added here are the covariance of the estimates (JCGM 100, 5.2;
JCGM 102 for several quantities), the effect of fixed parameters, and the combinations that are weakly determined.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from posor.errors import FitError
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.special import chdtrc, ndtri

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray

Loss: TypeAlias = Literal["linear", "huber", "soft_l1", "cauchy"]

ROBUST_SCALE = 2.0  # normalised residual at which a robust loss departs from the square
NEGLIGIBLE_EFFECT = 1e-3
"""Effect of fixed parameters on all residuals together, in standard deviations, that is neglected."""
COST_TOLERANCE = 1e-10  # relative change of the cost at convergence: of a thousand residuals, 3e-4 standard deviations
MAX_EVALUATIONS = 200
DIFFERENCE_STEP = 1e-4  # step of central differences over the scale of a parameter
UNDETERMINED = 1e-9  # singular values below this share of the largest one count as zero
WEAK = 0.5  # a direction is weak if the fit leaves more than this share of its prior standard uncertainty
IMPROBABLE = 1e-3  # probability of chi-square below which the stated uncertainties count as contradicted
LEAST_SPREAD = 0.1  # below which they may be in another unit
FALSE_OUTLIER = 1e-3  # probability of a false outlier among all residuals of a fit (Bonferroni)
NAMED_SHARE = 0.3  # parameters with at least this component in a direction are named


@dataclass(frozen=True)
class Fit:
    """Result of a fit of p parameters to n residuals."""

    names: tuple[str, ...]  # of the parameters, (p,)
    units: tuple[str, ...]  # (p,)
    values: FloatArray  # estimates, (p,)
    covariance: FloatArray  # (p, p)
    residuals: FloatArray  # each over its standard uncertainty, (n,)
    weights: FloatArray  # of each residual under the loss; 1: full weight, (n,)
    jacobian: FloatArray  # d(normalised residual)/d(parameter), (n, p)
    freedoms: int  # degrees of freedom: readings less parameters; with a prior, the readings
    spread: float  # root of chi-square over the freedoms; 1 if the stated uncertainties are right
    cross_covariance: FloatArray  # of the estimates with the standard normal factors of fixed parameters, (p, q)

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlations(self) -> FloatArray:
        """Correlation matrix of the parameters, (p, p)."""
        return self.covariance / np.outer(self.sigmas, self.sigmas)

    @property
    def probability(self) -> float:
        """Probability of a chi-square at least this large if model and stated uncertainties are right."""
        return float(chdtrc(self.freedoms, self.spread**2 * self.freedoms)) if self.freedoms else 1.0

    @property
    def is_too_large(self) -> bool:
        """Whether the residuals exceed what the stated uncertainties explain."""
        return self.probability < IMPROBABLE

    @property
    def is_too_small(self) -> bool:
        """Whether the residuals are far below what the stated uncertainties predict."""
        return self.spread < LEAST_SPREAD and 1.0 - self.probability < IMPROBABLE

    def value(self, name: str) -> float:
        """Return the estimate of one parameter."""
        return float(self.values[self.names.index(name)])

    def sigma(self, name: str) -> float:
        """Return the standard uncertainty of one parameter."""
        return float(self.sigmas[self.names.index(name)])

    def consider(self, fixed_effects: FloatArray) -> Fit:
        """Return this fit, made without prior, with the uncertainty of fixed parameters added but not estimated.

        For readings so noisy that estimating a fixed parameter along, such as their scale, would follow the noise
        ("consider" parameters: Schmidt 1966). ``fixed_effects`` (n, q) as in ``fit_parameters``.
        """
        weighted = self.jacobian.T * self.weights
        gain = np.asarray(np.linalg.solve(weighted @ self.jacobian, weighted @ fixed_effects), dtype=float)
        return replace(self, covariance=self.covariance + gain @ gain.T, cross_covariance=-gain)

    def select_first(self, count: int) -> Fit:
        """Return the fit of the first parameters only."""
        return replace(
            self,
            names=self.names[:count],
            units=self.units[:count],
            values=self.values[:count],
            covariance=self.covariance[:count, :count],
            jacobian=self.jacobian[:, :count],
            cross_covariance=self.cross_covariance[:count],
        )

    def outliers(self) -> BoolArray:
        """Return which residuals are outliers, (n,)."""
        limit = -ndtri(0.5 * FALSE_OUTLIER / max(len(self.residuals), 1))
        # Normal distribution: median of the absolute values over the standard deviation.
        scatter = float(np.median(np.abs(self.residuals)) / ndtri(0.75))
        return np.asarray(np.abs(self.residuals) > limit * max(1.0, scatter))


def fit_parameters(
    residuals: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    names: Sequence[str],
    units: Sequence[str],
    scales: FloatArray,
    *,
    jacobian: Callable[[FloatArray], FloatArray] | None = None,
    prior: bool | FloatArray = False,
    fixed_effects: FloatArray | None = None,
    uninformative: int = 0,
    loss: Loss = "linear",
    trust_sigmas: bool = True,
    what: str = "the fit",
) -> Fit:
    """Fit parameters to normalised residuals.

    Args:
        residuals: Given parameters (p,), returns residuals over their standard uncertainties, (n,).
        start: Initial values, (p,).
        names: Of the parameters, (p,).
        units: Of the parameters, (p,).
        scales: Expected size of each parameter's correction, positive, (p,): its prior standard uncertainty.
        jacobian: Given parameters (p,), returns d(residual)/d(parameter), (n, p); None: central differences.
        prior: Whether prior knowledge counts as a reading of each parameter at its start: True with ``scales`` as
            standard uncertainties, or a covariance (p, p). The loss does not apply to these readings, and they are not
            among the fit's residuals.
        fixed_effects: Effect of uncertain parameters not fitted: d(residual)/d(standard normal factor), (n, q).
            These factors are estimated along, start at zero, and add to the covariance (JCGM 102, 6.2).
        uninformative: Number of residuals that are zero whatever the data; they give no degree of freedom.
        loss: Robust losses survive outliers.
        trust_sigmas: Whether the stated uncertainties of the readings hold (JCGM 100, 4.3); if not, the covariance is
            scaled by chi-square over the freedoms (4.2).
        what: Name of the fit for error messages.

    Raises:
        FitError: There are fewer readings than parameters, the fit does not converge, or the readings do not determine
            all parameters; names those that cannot be distinguished.

    """
    names, units = tuple(names), tuple(units)
    if not names:
        raise FitError("there is no parameter to fit", where=what, expected="at least one")
    count, size = len(residuals(start)), len(names)
    prior_rows = _whiten_prior(prior, scales, what)
    if count < (1 if len(prior_rows) else size):
        raise FitError(f"{count} readings for {size} parameters", where=what, expected="at least as many readings")

    def scaled_jacobian(x: FloatArray) -> FloatArray:
        values = start + scales * x
        return _central_differences(residuals, values, scales) if jacobian is None else jacobian(values) * scales

    # The unknowns x are the scaled corrections, then the factors of the fixed parameters; ``known`` has their priors.
    effects, rotation = _compress(np.zeros((count, 0)) if fixed_effects is None else fixed_effects)
    known = np.zeros((len(prior_rows) + effects.shape[1], size + effects.shape[1]))
    known[: len(prior_rows), :size] = prior_rows
    known[len(prior_rows) :, size:] = np.eye(effects.shape[1])

    def residuals_of(x: FloatArray) -> FloatArray:
        return np.asarray(residuals(start + scales * x[:size]) + effects @ x[size:])

    x = _minimise(
        lambda x: np.concatenate([residuals_of(x), known @ x]),
        lambda x: np.vstack([np.hstack([scaled_jacobian(x[:size]), effects]), known]),
        count,
        size + effects.shape[1],
        loss,
        what,
    )
    normalised, scaled = residuals_of(x), scaled_jacobian(x[:size])
    _check_determined(np.vstack([scaled, prior_rows]), names, what)
    full = np.hstack([scaled, effects])
    squared = np.square(normalised / ROBUST_SCALE)
    _, weights, curvatures = _evaluate_loss(squared, loss)
    slopes = weights if loss == "linear" else np.maximum(weights + 2.0 * squared * curvatures, 0.0)
    inverse = _invert_normal_matrix(np.vstack([np.sqrt(slopes)[:, None] * full, known]))
    if loss != "linear":
        # With outliers the residuals do not scatter as stated: sandwich covariance (Huber 1981, 7.6) of the influences,
        # enlarged for the parameters that were fitted to them.
        fitted = np.trace(inverse @ (full.T @ (slopes[:, None] * full)))
        readings = count - uninformative
        influences = np.abs(weights * normalised) * np.sqrt(readings / max(readings - fitted, 1.0))
        shifts = np.vstack([influences[:, None] * full, known]) @ inverse
        inverse = shifts.T @ shifts
    freedoms = count - uninformative - (0 if len(prior_rows) else size)
    squares = float(np.sum(weights * np.square(normalised)) + np.sum(np.square(known @ x)))
    spread = float(np.sqrt(squares / freedoms)) if freedoms else 1.0
    growth = spread if loss == "linear" and not trust_sigmas else 1.0
    return Fit(
        names=names,
        units=units,
        values=start + scales * x[:size],
        covariance=np.outer(scales, scales) * inverse[:size, :size] * growth**2,
        residuals=normalised,
        weights=weights,
        jacobian=scaled / scales,
        freedoms=freedoms,
        spread=spread,
        cross_covariance=growth * scales[:, None] * inverse[:size, size:] @ rotation,
    )


def fit_linear(
    design: FloatArray,
    observed: FloatArray,
    sigmas: FloatArray,
    start: FloatArray,
    names: Sequence[str],
    units: Sequence[str],
    scales: FloatArray,
    **options: Any,
) -> Fit:
    """Fit ``design @ parameters`` (n, p) to observed values (n,) with standard uncertainties (n,).

    ``fixed_effects`` are those on the values, not yet divided by ``sigmas``; other arguments as in ``fit_parameters``.
    """
    weighted = design / sigmas[:, None]
    if options.get("fixed_effects") is not None:
        options["fixed_effects"] = options["fixed_effects"] / sigmas[:, None]
    return fit_parameters(
        lambda values: (design @ values - observed) / sigmas,
        start,
        names,
        units,
        scales,
        jacobian=lambda _: weighted,
        **options,
    )


def _whiten_prior(prior: bool | FloatArray, scales: FloatArray, what: str) -> FloatArray:  # noqa: FBT001  as above
    """Return the rows that turn scaled corrections into readings of variance 1 of the prior, (p or 0, p)."""
    if isinstance(prior, bool):
        return np.eye(len(scales)) if prior else np.zeros((0, len(scales)))
    try:
        root = np.linalg.cholesky(prior / np.outer(scales, scales))
    except np.linalg.LinAlgError:
        raise FitError("the prior is no covariance", where=what, expected="a positive definite matrix") from None
    return np.asarray(np.linalg.inv(root))


def _invert_normal_matrix(root: FloatArray) -> FloatArray:
    """Return the inverse of root' root, (p, p), positive definite however small singular values are; root (n, p)."""
    triangle = np.linalg.qr(root, mode="r")
    inverse = solve_triangular(triangle, np.eye(len(triangle)))
    return np.asarray(inverse @ inverse.T)


def _compress(effects: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return effects (n, r) of as few factors as matter, and these in terms of the given ones, (r, q)."""
    left, sizes, right = np.linalg.svd(effects, full_matrices=False)
    significant = sizes > NEGLIGIBLE_EFFECT
    return left[:, significant] * sizes[significant], right[significant]


def _minimise(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    count: int,
    size: int,
    loss: Loss,
    what: str,
) -> FloatArray:
    """Return the unknowns (size,) of the least cost; the loss applies to the first ``count`` residuals."""

    def rho(squares: FloatArray) -> FloatArray:
        return np.hstack([_evaluate_loss(squares[:count], loss), _evaluate_loss(squares[count:], "linear")])

    options: Any = {"loss": rho, "f_scale": ROBUST_SCALE, "xtol": 1e-14, "ftol": COST_TOLERANCE, "gtol": 1e-12}
    try:
        found = least_squares(residuals, np.zeros(size), jacobian, max_nfev=MAX_EVALUATIONS, **options)
    except ValueError as error:
        raise FitError(f"cannot begin: {error}", where=what, expected="finite residuals at the start") from error
    if not found.success:
        raise FitError(
            f"does not converge within {MAX_EVALUATIONS} evaluations", where=what, expected="data that fit the model"
        )
    return np.asarray(found.x)


def _central_differences(
    residuals: Callable[[FloatArray], FloatArray], values: FloatArray, scales: FloatArray
) -> FloatArray:
    """Return d(residual)/d(parameter over its scale), (n, p)."""
    differences = [residuals(values + shift) - residuals(values - shift) for shift in np.diag(DIFFERENCE_STEP * scales)]
    return np.column_stack(differences) / (2.0 * DIFFERENCE_STEP)


def _evaluate_loss(squares: FloatArray, loss: Loss) -> FloatArray:
    """Return a loss of squared residuals (over the robust scale) and its first two derivatives, (3, n).

    The first derivative is the weight of the residual.
    """
    if loss == "linear":
        return np.vstack([squares, np.ones_like(squares), np.zeros_like(squares)])
    if loss == "cauchy":
        weights = 1.0 / (1.0 + squares)
        return np.vstack([np.log1p(squares), weights, -np.square(weights)])
    if loss == "soft_l1":
        weights = 1.0 / np.sqrt(1.0 + squares)
        return np.vstack([2.0 * (1.0 / weights - 1.0), weights, -0.5 * weights**3])
    large, roots = squares > 1.0, np.sqrt(np.maximum(squares, 1.0))
    return np.vstack([np.where(large, 2.0 * roots - 1.0, squares), 1.0 / roots, np.where(large, -0.5 / roots**3, 0.0)])


@dataclass(frozen=True)
class WeakDirection:
    """A combination of parameters that the data determine weakly."""

    shares: FloatArray  # unit vector in parameters over their prior standard uncertainties, (p,)
    remaining: float  # standard uncertainty along it by the data alone, over the prior one; may be infinite
    names: tuple[str, ...]  # parameters with the largest shares

    def remaining_with_prior(self, gain: float = 0.0) -> float:
        """Return the standard uncertainty with the prior counted, over the prior one, 0 to 1.

        ``gain``: information of further readings, their squared scaled derivatives along the direction.
        """
        return float(1.0 / np.sqrt(1.0 + self.remaining**-2 + gain))


def weak_directions(scaled_jacobian: FloatArray, names: Sequence[str]) -> tuple[WeakDirection, ...]:
    """Return the combinations of the parameters ``names`` (p,) that the readings determine weakly, the weakest first.

    ``scaled_jacobian``: d(normalised residual)/d(parameter over its prior standard uncertainty), (n, p).
    """
    size = len(names)
    padded = np.vstack([scaled_jacobian, np.zeros((max(0, size - len(scaled_jacobian)), size))])
    _, singular, directions = np.linalg.svd(padded, full_matrices=False)
    found = []
    for value, shares in zip(singular[::-1], directions[::-1], strict=True):
        remaining = np.inf if value <= UNDETERMINED * singular[0] else 1.0 / value
        if remaining < WEAK:
            break
        order = np.argsort(-np.abs(shares))
        named = tuple(names[i] for i in order if abs(shares[i]) >= NAMED_SHARE) or (names[order[0]],)
        found.append(WeakDirection(shares, float(remaining), named))
    return tuple(found)


def _check_determined(scaled_jacobian: FloatArray, names: Sequence[str], what: str) -> None:
    """Raise FitError if a combination of parameters does not change the residuals at all."""
    for direction in weak_directions(scaled_jacobian, names):
        if np.isinf(direction.remaining):
            together = " and ".join(direction.names)
            raise FitError(
                f"the readings do not separate {together}"
                if len(direction.names) > 1
                else f"the readings do not depend on {together}",
                where=what,
                expected="readings at other poses, or fewer parameters",
            )
