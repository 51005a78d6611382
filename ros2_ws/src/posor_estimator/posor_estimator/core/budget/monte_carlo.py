"""The error budget of a POSOR by drawing (JCGM 101): readings and parameters are drawn, the exact estimator is run.

The measurement model in the sense of JCGM 101 is the estimator: pose = f(raw readings, parameters). Every draw takes
the scan with the electronics' noise and another set of parameters, from the covariance that the calibration states,
linearises it and solves for the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.budget.outputs import THETA, Output, Outputs
from posor_estimator.core.budget.validation import COVERAGE, numerical_tolerance
from posor_estimator.core.kernels.locate import SINGULAR
from posor_estimator.core.kernels.solve import CONVERGED, gauss_newton
from posor_estimator.core.scan import Scans
from posor_estimator.core.sensors.base import RowSensor
from posor_estimator.errors import FitError, ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pinocchio as pin

    from posor_estimator.core.budget.outputs import PlatePoint
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.types import BoolArray, FloatArray

BATCH = 10_000
"""Draws between two looks at whether the results have settled (JCGM 101, 7.9.4: at least 10^4)."""
MOST_LOST = 0.01
"""Share of draws without a pose above which there is no result."""
STABLE_SHARE = 0.2
"""The results must be stable to this part of the numerical tolerance (JCGM 101, 8.2)."""
PROGRESS = 500
"""Draws between two calls of ``progress``."""


@dataclass(frozen=True)
class MonteCarlo:
    """What the draws gave.

    Attributes:
        outputs: The judged quantities.
        means: Their averages [m, rad], shape (k,).
        sigmas: Their standard deviations, shape (k,).
        low: Lower ends of their probabilistically symmetric 95 % intervals, shape (k,).
        high: Upper ends, shape (k,).
        stable: Whether each quantity's results have settled to a fifth of its numerical tolerance, shape (k,).
        trials: Draws that gave a pose.
        lost: Draws that gave none: a reading out of its calibrated range, or no solution.

    """

    outputs: tuple[Output, ...]
    means: FloatArray
    sigmas: FloatArray
    low: FloatArray
    high: FloatArray
    stable: BoolArray
    trials: int
    lost: int


def monte_carlo(
    posor: Posor,
    scan: Scan,
    T_R_T: pin.SE3,
    points: Sequence[PlatePoint] = (),
    *,
    seed: int,
    most: int = 10 * BATCH,
    digits: int = 1,
    progress: Callable[[int], None] | None = None,
) -> MonteCarlo:
    """Draw in batches until the results are stable (JCGM 101, 7.9), or ``most`` draws have been made.

    Args:
        posor: The POSOR.
        scan: What it reads at the pose, without noise.
        T_R_T: The pose; every solution starts there, so a counted theta stays in its bump.
        points: Points of the plate whose gap is judged beside the six native coordinates.
        seed: Of the random numbers.
        most: Largest number of draws, at least two batches.
        digits: Significant digits of an uncertainty, which set the numerical tolerance.
        progress: Called with the number of draws made so far.

    Raises:
        ParameterError: A sensor cannot be disturbed, being written in plain Python, or ``most`` is too small.
        FitError: More than 1 % of the draws give no pose.

    """
    if most < 2 * BATCH:
        raise ParameterError(f"{most} draws", expected=f"at least {2 * BATCH}, two batches of JCGM 101")
    draws = _Draws(posor, scan, T_R_T, points, np.random.default_rng(seed))
    batches: list[FloatArray] = []
    tried = 0
    stable: BoolArray = np.zeros(len(draws.outputs.named), dtype=np.bool_)
    while tried + BATCH <= most and not stable.all():
        found = []
        for n, noisy in enumerate(draws.noisy_scans()):
            if progress is not None and n % PROGRESS == 0:
                progress(tried + n)
            values = draws.values(noisy)
            if values is not None:
                found.append(values)
        tried += BATCH
        lost = tried - sum(map(len, batches)) - len(found)
        if lost > MOST_LOST * tried:
            raise FitError(
                f"{lost} of {tried} draws give no pose",
                expected="a pose further from the ends of the sensors' ranges, or smaller uncertainties",
            )
        batches.append(np.array(found))
        stable = _stable(batches, digits)
    every = np.concatenate(batches)
    low, high = _interval(every)
    return MonteCarlo(
        outputs=draws.outputs.named,
        means=every.mean(axis=0),
        sigmas=every.std(axis=0, ddof=1),
        low=low,
        high=high,
        stable=stable,
        trials=len(every),
        lost=tried - len(every),
    )


class _Draws:
    """Readings and parameters drawn, and the pose that they give."""

    def __init__(
        self, posor: Posor, scan: Scan, T_R_T: pin.SE3, points: Sequence[PlatePoint], random: np.random.Generator
    ) -> None:
        stack = posor.stack
        self.outputs = Outputs(stack, points)
        self._stack = stack
        self._scans = Scans.of([scan] * BATCH)
        self._rotation, self._translation = T_R_T.rotation.copy(), T_R_T.translation.copy()
        self._theta = self.outputs.values(self._rotation, self._translation)[THETA]
        self._points = points
        self._random = random
        self._means, self._root = stack.parameter_values, posor.parameter_root
        self._jacobian = np.empty((stack.readings, 6))
        self._residuals, self._moved = np.empty(stack.readings), np.empty(6)

    def noisy_scans(self) -> list[Scans]:
        """Return a batch of scans with noise, one by one."""
        scans = self._scans
        for sensor in self._stack.sensors:
            if not isinstance(sensor, RowSensor):
                raise ParameterError(
                    f"the noise of {type(sensor).__name__} cannot be drawn",
                    where="Monte Carlo",
                    expected="sensors whose model can be run forward (RowSensor)",
                )
            scans = scans.with_fields(sensor.disturbed(scans, self._random))
        return [scans.part(n, n + 1) for n in range(BATCH)]

    def values(self, scans: Scans) -> FloatArray | None:
        """Return the judged quantities that one scan gives with drawn parameters, None where it gives no pose."""
        drawn = self._means + self._root @ self._random.normal(size=self._root.shape[1])
        stack = self._stack.with_parameter_values(drawn)
        codes, batch = stack.linearise(scans)
        if codes.any():
            return None
        chosen = batch.chosen[0]
        rotation, translation = self._rotation.copy(), self._translation.copy()
        outcome = gauss_newton(
            stack.pool.kinds[chosen],
            stack.pool.rows[chosen],
            batch.values[0],
            1.0 / batch.variances[0],
            rotation,
            translation,
            self._jacobian,
            self._residuals,
            self._moved,
            SINGULAR,
        )
        if outcome != CONVERGED:
            return None
        values = Outputs(stack, self._points).values(rotation, translation)
        values[THETA] = self._theta + math.remainder(values[THETA] - self._theta, 2.0 * math.pi)
        return values


def _interval(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the probabilistically symmetric coverage interval of each column."""
    low, high = np.quantile(values, [0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE], axis=0)
    return low, high


def _stable(batches: Sequence[FloatArray], digits: int) -> BoolArray:
    """Return whether mean, standard deviation and interval of each column have settled (JCGM 101, 7.9.4)."""
    count = len(batches)
    if count < 2:  # noqa: PLR2004  two batches tell how far results scatter
        return np.zeros(batches[0].shape[1], dtype=np.bool_)
    results = np.array([[batch.mean(axis=0), batch.std(axis=0, ddof=1), *_interval(batch)] for batch in batches])
    scatter = 2.0 * results.std(axis=0, ddof=1) / math.sqrt(count)
    sigmas = np.concatenate(batches).std(axis=0, ddof=1)
    tolerances = np.array([numerical_tolerance(sigma, digits) for sigma in sigmas])
    return np.asarray(np.all(scatter <= STABLE_SHARE * tolerances, axis=0))
