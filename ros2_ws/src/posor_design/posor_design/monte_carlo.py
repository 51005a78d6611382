# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error budget of a POSOR by the Monte Carlo method (JCGM 101), and the validation of the first order (clause 8).

The measurement model in the sense of JCGM 101 is the estimator: pose = f(raw readings, parameters). Each draw adds the
noise of the electronics to the scan and draws parameters from the stated covariance, linearises the scan and solves for
the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError, ParameterError
from posor.estimation.solver import CONVERGED
from posor.model.scan import Scans
from posor.sensors.base import RowSensor
from posor.uncertainty.budget_poses import require_forward_model
from posor.uncertainty.budget_quantities import THETA, Output, Outputs
from scipy.special import ndtri

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pinocchio as pin
    from posor.estimation.posor import Posor
    from posor.model.scan import Scan
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor.uncertainty.budget_quantities import PlatePoint
    from posor.uncertainty.first_order import ErrorBudget

COVERAGE = 0.95  # coverage probability of the compared intervals
COVERAGE_FACTOR = float(ndtri(0.5 + 0.5 * COVERAGE))
BATCH = 10_000  # draws between two tests of stability (JCGM 101, 7.9.4: at least 10^4)
MAX_LOST_SHARE = 0.01  # largest share of draws without a pose
DIGITS = 1  # significant digits of an uncertainty, which set the numerical tolerance
STABLE_SHARE = 0.2  # stability is required to this share of the numerical tolerance (JCGM 101, 8.2)
PROGRESS_DRAWS = 500  # draws between two calls of ``progress``


@dataclass(frozen=True)
class MonteCarlo:
    """Result of the draws."""

    outputs: tuple[Output, ...]  # the k outputs
    means: FloatArray  # their averages [m, rad], shape (k,)
    sigmas: FloatArray  # their standard deviations, shape (k,)
    low: FloatArray  # lower ends of their probabilistically symmetric 95 % intervals, shape (k,)
    high: FloatArray  # upper ends, shape (k,)
    stable: BoolArray  # whether the results of each output are stable to a fifth of its numerical tolerance, shape (k,)
    trials: int  # draws that gave a pose
    lost: int  # draws without a pose: a reading out of its calibrated range, or no solution


def monte_carlo(
    posor: Posor,
    scan: Scan,
    T_R_T: pin.SE3,
    points: Sequence[PlatePoint] = (),
    *,
    seed: int,
    max_draws: int = 10 * BATCH,
    digits: int = DIGITS,
    progress: Callable[[int], None] | None = None,
) -> MonteCarlo:
    """Draw in batches until the results are stable (JCGM 101, 7.9), or ``max_draws`` draws are made.

    ``scan``: its readings at the pose, without noise. ``T_R_T``: the pose; every solution starts there, so a counted
    theta stays in its bump. ``points``: points of the plate whose gaps are outputs besides the six native coordinates.
    ``seed``: of the random numbers. ``max_draws``: largest number of draws, at least two batches. ``digits``:
    significant digits of an uncertainty, which set the numerical tolerance. ``progress``: called with the number of
    draws made so far. Raises ParameterError: a sensor has no forward model, or ``max_draws`` is too small. Raises
    FitError: more than 1 % of the draws give no pose.
    """
    if max_draws < 2 * BATCH:
        raise ParameterError(f"{max_draws} draws", expected=f"at least {2 * BATCH}, two batches of JCGM 101")
    draws = _Draws(posor, scan, T_R_T, points, np.random.default_rng(seed))
    batches: list[FloatArray] = []
    tried = 0
    stable: BoolArray = np.zeros(len(draws.outputs.named), dtype=np.bool_)
    while tried + BATCH <= max_draws and not stable.all():
        found = []
        for n, (noisy, parameters) in enumerate(zip(draws.noisy_scans(), draws.parameters(), strict=True)):
            if progress is not None and n % PROGRESS_DRAWS == 0:
                progress(tried + n)
            outputs = draws.values(noisy, parameters)
            if outputs is not None:
                found.append(outputs)
        tried += BATCH
        lost = tried - sum(map(len, batches)) - len(found)
        if lost > MAX_LOST_SHARE * tried:
            expected = "a pose further from the ends of the sensors' ranges, or smaller uncertainties"
            raise FitError(f"{lost} of {tried} draws give no pose", expected=expected)
        batches.append(np.array(found))
        stable = _stable(batches, digits)
    values = np.concatenate(batches)
    low, high = _interval(values)
    return MonteCarlo(
        outputs=draws.outputs.named,
        means=values.mean(axis=0),
        sigmas=values.std(axis=0, ddof=1),
        low=low,
        high=high,
        stable=stable,
        trials=len(values),
        lost=tried - len(values),
    )


class _Draws:
    """Draws readings and parameters, and solves for the pose."""

    def __init__(
        self, posor: Posor, scan: Scan, T_R_T: pin.SE3, points: Sequence[PlatePoint], random: np.random.Generator
    ) -> None:
        stack = posor.stack
        require_forward_model(posor)
        self.outputs = Outputs(stack, points)
        self._stack = stack.with_parameter_values(stack.parameter_values)  # each draw overwrites them
        self._sensors = [sensor for sensor in self._stack.sensors if isinstance(sensor, RowSensor)]
        self._scans = Scans.of([scan] * BATCH)
        self._rotation, self._translation = T_R_T.rotation.copy(), T_R_T.translation.copy()
        self._theta = self.outputs.values(self._rotation, self._translation)[THETA]
        self._random = random
        self._means, self._root = stack.parameter_values, posor.parameter_square_root

    def noisy_scans(self) -> list[Scans]:
        """Return a batch of scans with noise, one by one."""
        scans = self._scans
        for sensor in self._sensors:
            scans = scans.with_fields(sensor.disturbed(scans, self._random))
        return [scans.part(n, n + 1) for n in range(BATCH)]

    def parameters(self) -> FloatArray:
        """Return a batch of drawn parameter vectors, shape (BATCH, p)."""
        return self._means + self._random.normal(size=(BATCH, self._root.shape[1])) @ self._root.T

    def values(self, scans: Scans, parameters: FloatArray) -> FloatArray | None:
        """Return the outputs of one scan with a drawn parameter vector; None without a pose."""
        stack = self._stack
        stack.load_parameter_values(parameters)
        self.outputs.load_parameter_values(parameters)
        readings = stack.linearise(scans)
        if not readings.valid.all():
            return None
        rotation, translation = self._rotation.copy(), self._translation.copy()
        outcome = stack.solve(readings, 0, rotation, translation)
        if outcome != CONVERGED:
            return None
        values = self.outputs.values(rotation, translation)
        values[THETA] = self._theta + math.remainder(values[THETA] - self._theta, 2.0 * math.pi)
        return values


def _interval(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the probabilistically symmetric coverage interval of each column."""
    low, high = np.quantile(values, [0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE], axis=0)
    return low, high


def _stable(batches: Sequence[FloatArray], digits: int) -> BoolArray:
    """Return whether mean, standard deviation and interval of each column are stable (JCGM 101, 7.9.4)."""
    count = len(batches)
    if count < 2:  # noqa: PLR2004  the scatter needs two batches
        return np.zeros(batches[0].shape[1], dtype=np.bool_)
    results = np.array([[batch.mean(axis=0), batch.std(axis=0, ddof=1), *_interval(batch)] for batch in batches])
    scatter = 2.0 * results.std(axis=0, ddof=1) / math.sqrt(count)
    sigmas = np.concatenate(batches).std(axis=0, ddof=1)
    tolerances = np.array([numerical_tolerance(sigma, digits) for sigma in sigmas])
    return np.asarray(np.all(scatter <= STABLE_SHARE * tolerances, axis=0))


@dataclass(frozen=True)
class Validation:
    """Comparison of the first-order interval of one output with that of the draws."""

    name: str  # name of the output
    tolerance: float  # numerical tolerance of its standard uncertainty [m, rad]
    low: float  # distance of the lower ends of the two 95 % intervals
    high: float  # distance of the upper ends
    stable: bool  # whether the draws are stable

    @property
    def holds(self) -> bool:
        """Whether both ends agree within the tolerance."""
        return self.low <= self.tolerance and self.high <= self.tolerance


def numerical_tolerance(sigma: float, digits: int) -> float:
    """Return half a unit of the last significant digit of an uncertainty (JCGM 101, 7.9.2); zero for zero."""
    if not sigma > 0.0:
        return 0.0
    last = math.floor(math.log10(sigma)) - (digits - 1)
    if round(sigma / 10.0**last) >= 10**digits:  # 0.96 is 1.0, to one digit
        last += 1
    return 0.5 * 10.0**last


def validate(budget: ErrorBudget, drawn: MonteCarlo) -> tuple[Validation, ...]:
    """Compare the two 95 % intervals of each output; ``drawn``: draws of the same POSOR at the same pose and points."""
    found = []
    for i, output in enumerate(budget.outputs):
        expanded = COVERAGE_FACTOR * budget.sigmas[i]
        found.append(
            Validation(
                name=output.name,
                tolerance=numerical_tolerance(float(budget.sigmas[i]), DIGITS),
                low=float(abs(budget.values[i] - expanded - drawn.low[i])),
                high=float(abs(budget.values[i] + expanded - drawn.high[i])),
                stable=bool(drawn.stable[i]),
            )
        )
    return tuple(found)
