"""Least squares with an honest account: covariance, residuals, outliers, and a refusal of what the data do not tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from posor_estimator.core.calibrate.directions import weak_directions
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_estimator.core.types import BoolArray, FloatArray

Loss: TypeAlias = Literal["linear", "huber", "soft_l1", "cauchy"]

ROBUST_SCALE = 2.0
"""Normalised residual from which a robust loss counts less than a square."""
FAINT = 1e-3
"""Effect of what is taken for known on all residuals together, in their standard deviations, that is left out."""
SETTLED = 1e-10
"""Relative change of the cost below which a fit has settled: of a thousand residuals, by 3e-4 standard deviations."""
EVALUATIONS = 200
"""Of the residuals, after which a fit that has not settled is given up."""


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
        freedoms: Residuals that are readings, less parameters; where the prior counts, as many as such residuals.
        spread: Root of chi-square over the freedoms: 1 if the stated uncertainties of the readings are right.
        across: Covariance of the estimates with the standard normal deviates of what was taken for known, (p, q).

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
    across: FloatArray

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

    def considering(self, taken: FloatArray) -> Fit:
        """Return the fit, in which no prior counts, with the share of what it took for known and did not find along.

        For readings so noisy that what is found along, such as a scale of theirs, would be found from their noise.

        Args:
            taken: As ``fit`` has it, (n, q) ("consider" parameters: Schmidt 1966).

        """
        weighted = self.jacobian.T * self.weights
        gain = np.asarray(np.linalg.solve(weighted @ self.jacobian, weighted @ taken), dtype=float)
        return replace(self, covariance=self.covariance + gain @ gain.T, across=-gain)

    def part(self, count: int) -> Fit:
        """Return the fit of the first parameters, the others being no more than help."""
        return replace(
            self,
            names=self.names[:count],
            units=self.units[:count],
            values=self.values[:count],
            covariance=self.covariance[:count, :count],
            jacobian=self.jacobian[:, :count],
            across=self.across[:count],
        )

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
    jacobian: Callable[[FloatArray], FloatArray] | None = None,
    prior: bool | FloatArray = False,
    taken: FloatArray | None = None,
    idle: int = 0,
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
        jacobian: Given parameters (p,), d(residual)/d(parameter), (n, p); None: by differences.
        prior: Whether what was known before counts: each parameter is a reading of itself, at its start, with its scale
            as the standard uncertainty, or with this covariance of all of them (p, p). These readings are not among the
            fit's residuals, and the loss is not theirs.
        taken: What the residuals take for known though it is not quite: d(residual)/d(standard normal deviate of it),
            (n, q). It is found along with the parameters, begins at zero, and its uncertainty is in theirs (JCGM 102,
            6.2); the residuals are what it leaves.
        idle: How many of the residuals are no readings, and zero whatever the data: they count for no freedom.
        loss: Robust where outliers are to be survived.
        trust_sigmas: Whether the stated uncertainties of the readings hold (JCGM 100, 4.3); if not, the covariance is
            scaled by what the residuals show (4.2).
        what: What to call the fit in complaints.

    Raises:
        FitError: There are fewer readings than parameters, the fit does not settle, or the readings do not determine
            all parameters; it names those that they cannot tell apart.

    """
    names, units = tuple(names), tuple(units)
    if not names:
        raise FitError("there is no parameter to fit", where=what, expected="at least one")
    count, size = len(residuals(start)), len(names)
    before = _whitening(prior, scales, what)
    if count < (1 if len(before) else size):
        raise FitError(f"{count} readings for {size} parameters", where=what, expected="as many at least")

    def scaled_jacobian(x: FloatArray) -> FloatArray:
        values = start + scales * x
        return derivatives(residuals, values, scales) if jacobian is None else jacobian(values) * scales

    aside, turned = _few(np.zeros((count, 0)) if taken is None else taken)
    known = np.zeros((len(before) + aside.shape[1], size + aside.shape[1]))
    known[: len(before), :size] = before
    known[len(before) :, size:] = np.eye(aside.shape[1])

    def whole(x: FloatArray) -> FloatArray:
        return np.asarray(residuals(start + scales * x[:size]) + aside @ x[size:])

    x = _settled(
        lambda x: np.concatenate([whole(x), known @ x]),
        lambda x: np.vstack([np.hstack([scaled_jacobian(x[:size]), aside]), known]),
        count,
        size + aside.shape[1],
        loss,
        what,
    )
    normalised = whole(x)
    scaled = scaled_jacobian(x[:size])
    _refuse_blind(np.vstack([scaled, before]), names, what)
    every = np.hstack([scaled, aside])
    squared = np.square(normalised / ROBUST_SCALE)
    _, weights, bends = _rho(squared, loss)
    slopes = weights if loss == "linear" else np.maximum(weights + 2.0 * squared * bends, 0.0)
    inverse = _inverse_square(np.vstack([np.sqrt(slopes)[:, None] * every, known]))
    if loss != "linear":
        # With outliers the residuals are not as stated: the sandwich (Huber 1981, 7.6) of their influences, these
        # enlarged for the parameters that were fitted to them.
        fitted = np.trace(inverse @ (every.T @ (slopes[:, None] * every)))
        influences = np.abs(weights * normalised) * np.sqrt((count - idle) / max(count - idle - fitted, 1.0))
        moved = np.vstack([influences[:, None] * every, known]) @ inverse
        inverse = moved.T @ moved
    freedoms = count - idle if len(before) else count - idle - size
    squares = float(np.sum(weights * np.square(normalised)) + np.sum(np.square(known @ x)))
    spread = np.sqrt(squares / freedoms) if freedoms else 1.0
    grown = float(spread) if loss == "linear" and not trust_sigmas else 1.0
    return Fit(
        names=names,
        units=units,
        values=start + scales * x[:size],
        covariance=np.outer(scales, scales) * inverse[:size, :size] * grown**2,
        residuals=normalised,
        weights=weights,
        jacobian=scaled / scales,
        freedoms=freedoms,
        spread=float(spread),
        across=grown * scales[:, None] * inverse[:size, size:] @ turned,
    )


def _whitening(prior: bool | FloatArray, scales: FloatArray, what: str) -> FloatArray:  # noqa: FBT001  as in fit
    """Return what makes readings of variance 1 of scaled corrections, by what was known of them, (p or 0, p)."""
    if isinstance(prior, bool):
        return np.eye(len(scales)) if prior else np.zeros((0, len(scales)))
    try:
        root = np.linalg.cholesky(prior / np.outer(scales, scales))
    except np.linalg.LinAlgError:
        raise FitError("the prior is no covariance", where=what, expected="a positive definite matrix") from None
    return np.asarray(np.linalg.inv(root))


def _inverse_square(root: FloatArray) -> FloatArray:
    """Return the inverse of root' root, (p, p), positive definite however nearly blind it is; root (n, p)."""
    triangle = np.linalg.qr(root, mode="r")
    inverse = solve_triangular(triangle, np.eye(len(triangle)))
    return np.asarray(inverse @ inverse.T)


def _few(taken: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same effects (n, r) of as few deviates as matter, and these in terms of those given, (r, q)."""
    left, sizes, right = np.linalg.svd(taken, full_matrices=False)
    kept = sizes > FAINT
    return left[:, kept] * sizes[kept], right[kept]


def _settled(
    residuals: Callable[[FloatArray], FloatArray],
    jacobian: Callable[[FloatArray], FloatArray],
    count: int,
    size: int,
    loss: Loss,
    what: str,
) -> FloatArray:
    """Return the scaled corrections (size,) of the least cost; the loss is that of the first ``count`` residuals."""

    def rho(squares: FloatArray) -> FloatArray:
        return np.hstack([_rho(squares[:count], loss), _rho(squares[count:], "linear")])

    options: Any = {"loss": rho, "f_scale": ROBUST_SCALE, "xtol": 1e-14, "ftol": SETTLED, "gtol": 1e-12}
    try:
        found = least_squares(residuals, np.zeros(size), jacobian, max_nfev=EVALUATIONS, **options)
    except ValueError as error:
        raise FitError(f"cannot begin: {error}", where=what, expected="finite residuals at the start") from error
    if not found.success:
        raise FitError(
            f"does not settle within {EVALUATIONS} evaluations", where=what, expected="data that fit the model"
        )
    return np.asarray(found.x)


def _refuse_blind(scaled: FloatArray, names: Sequence[str], what: str) -> None:
    blind = [direction for direction in weak_directions(scaled, names) if np.isinf(direction.remaining)]
    if blind:
        raise FitError(
            f"the readings do not tell {' and '.join(blind[0].names)} apart"
            if len(blind[0].names) > 1
            else f"the readings say nothing of {blind[0].names[0]}",
            where=what,
            expected="readings at other poses, or fewer parameters",
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


def _rho(squares: FloatArray, loss: Loss) -> FloatArray:
    """Return a loss of squared residuals (over the robust scale) and its two derivatives, (3, n).

    The first derivative is the weight that the residual has, 1 for a small one.
    """
    if loss == "linear":
        return np.vstack([squares, np.ones_like(squares), np.zeros_like(squares)])
    if loss == "cauchy":
        weights = 1.0 / (1.0 + squares)
        return np.vstack([np.log1p(squares), weights, -np.square(weights)])
    if loss == "soft_l1":
        weights = 1.0 / np.sqrt(1.0 + squares)
        return np.vstack([2.0 * (1.0 / weights - 1.0), weights, -0.5 * weights**3])
    large = squares > 1.0
    roots = np.sqrt(np.maximum(squares, 1.0))
    return np.vstack(
        [
            np.where(large, 2.0 * roots - 1.0, squares),
            1.0 / roots,
            np.where(large, -0.5 / roots**3, 0.0),
        ]
    )
