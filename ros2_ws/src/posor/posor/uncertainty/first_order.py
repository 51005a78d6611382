# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""First-order error budget of a POSOR at a pose (JCGM 100, 5.1 and 5.2).

All derivatives are those of the measurement model: of the pose with respect to readings (``sensitivity_at``), and of
the readings with respect to parameters (``Stack.residual_jacobian``).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.errors import FitError, check_type
from posor.estimation.posor import Posor
from posor.estimation.solver import ILL_CONDITIONED
from posor.model.scan import Scans
from posor.numerics.array_types import freeze_arrays
from posor.uncertainty.budget_quantities import Output, Outputs, physical_quantities
from posor.uncertainty.reading_sensitivity import sensitivity_at

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray
    from posor.sensors.base import Linearised
    from posor.uncertainty.budget_quantities import PlatePoint


class ContributionKind(StrEnum):
    """Kind of a contribution: new in every scan, or the same in all scans of one calibration."""

    RANDOM = "random"
    SYSTEMATIC = "systematic"


@dataclass(frozen=True)
class Contribution:
    """Contribution of one input quantity to the outputs."""

    name: str  # name of the quantity
    kind: ContributionKind  # noise of a reading, or a calibrated quantity
    effects: FloatArray  # standard uncertainty of each output if all other quantities were exact [m, rad], shape (k,)


@dataclass(frozen=True, repr=False)
class ErrorBudget:
    """Error budget at one pose; the arrays are read-only.

    Attributes:
        T_R_T: The pose.
        outputs: The k outputs.
        values: Their values at the pose [m, rad], shape (k,).
        contributions: All contributions with an effect, in decreasing order of their largest share in an output.
        covariance: Covariance of the outputs, with all contributions and correlations, shape (k, k).
        without_uncertainty: Quantities without a stated uncertainty, taken as exact.
        correlated: Contributing quantities with stated correlations, but for shared terms. Their contributions do not
            add up to the total, which may be far smaller.

    """

    T_R_T: pin.SE3
    outputs: tuple[Output, ...]
    values: FloatArray
    contributions: tuple[Contribution, ...]
    covariance: FloatArray
    without_uncertainty: tuple[str, ...]
    correlated: tuple[str, ...]

    def __post_init__(self) -> None:
        for part in (self, *self.contributions):
            freeze_arrays(part)

    def __repr__(self) -> str:
        """Return the outputs' standard uncertainties and the number of contributions."""
        sigmas = zip(self.outputs, self.sigmas, strict=True)
        described = ", ".join(f"{output.name} {sigma:.3g} {output.unit}" for output, sigma in sigmas)
        return f"<ErrorBudget of {len(self.contributions)} contributions: {described}>"

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each output from the full covariance, shape (k,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    def root_sum_square(self, kind: ContributionKind | None = None) -> FloatArray:
        """Return the root sum square of all contributions, or of those of one kind, shape (k,)."""
        effects = [part.effects for part in self.contributions if kind is None or part.kind is kind]
        return np.sqrt(np.sum(np.square(effects), axis=0)) if effects else np.zeros(len(self.outputs))

    def shares(self) -> FloatArray:
        """Return each contribution's share of the summed variances, shape (contributions, k); zero if the sum is."""
        return _shares(np.array([part.effects for part in self.contributions]).reshape(-1, len(self.outputs)))


def _shares(effects: FloatArray) -> FloatArray:
    squares = np.square(effects)
    total = np.sum(squares, axis=0)
    return np.asarray(np.divide(squares, total, out=np.zeros_like(squares), where=total > 0.0))


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of the outputs at one pose."""

    outputs: tuple[Output, ...]  # the k outputs
    values: FloatArray  # their values at the pose [m, rad], shape (k,)
    by_reading: FloatArray  # with respect to each linearised reading, shape (k, m)
    by_parameter: FloatArray  # with respect to each parameter of the stack at constant readings, shape (k, p)
    noise: FloatArray  # standard deviation of each linearised reading from the electronics' noise [m], shape (m,)


def sensitivities(posor: Posor, scan: Scan, T_R_T: pin.SE3, points: Sequence[PlatePoint] = ()) -> Sensitivities:
    """Return the derivatives of the outputs; arguments and errors as ``error_budget``."""
    stack, rotation, translation = posor.stack, T_R_T.rotation.copy(), T_R_T.translation.copy()
    readings = stack.linearise(Scans.of([scan]))
    if not readings.valid[0]:
        raise stack.invalid_scan(scan, readings)
    require_determined(stack, readings, T_R_T)
    outputs = Outputs(stack, points)
    by_reading = outputs.by_motion(rotation, translation) @ sensitivity_at(posor, scan, T_R_T).gain
    by_parameter = by_reading @ stack.residual_jacobian(scan, rotation, translation)
    by_parameter += outputs.by_parameters(rotation, translation)
    return Sensitivities(
        outputs=outputs.named,
        values=outputs.values(rotation, translation),
        by_reading=by_reading,
        by_parameter=by_parameter,
        noise=np.sqrt(readings.variances[0]),
    )


def require_determined(stack: Stack, readings: Linearised, T_R_T: pin.SE3) -> None:
    """Refuse readings that do not determine all six freedoms, by the estimator's own measure."""
    outcome = stack.solve(readings, 0, T_R_T.rotation.copy(), T_R_T.translation.copy())
    if outcome == ILL_CONDITIONED:
        what = "the readings do not determine all six freedoms at this pose"
        raise FitError(what, expected="a pose at which they do")


def check_place(posor: object, T_R_T: object, where: str) -> None:
    """Raise ParameterError if the POSOR or the pose of a public function has another type."""
    check_type(posor, Posor, f"{where}, posor")
    check_type(T_R_T, pin.SE3, f"{where}, T_R_T")


def error_budget(posor: Posor, scan: Scan, T_R_T: pin.SE3, points: Sequence[PlatePoint] = ()) -> ErrorBudget:
    """Return the first-order budget at a pose, from the covariance that the calibration states.

    Contributions are in decreasing order of their largest share in an output: what to improve first.

    Args:
        posor: The POSOR.
        scan: Its readings at the pose.
        T_R_T: The pose.
        points: Points of the plate whose gaps are outputs besides the six native coordinates.

    Raises:
        ParameterError: An argument has the wrong type.
        ScanError: The scan cannot be linearised.
        FitError: Its readings do not determine all six freedoms at this pose.

    """
    check_place(posor, T_R_T, "error_budget")
    found = sensitivities(posor, scan, T_R_T, points)
    whole = posor.parameter_square_root
    root = whole[:, : whole.shape[1] - len(posor.calibration.shared)]
    noise = found.by_reading * found.noise
    parts = [
        Contribution(f"{name}: noise", ContributionKind.RANDOM, np.abs(effect))
        for name, effect in zip(posor.stack.reading_names, noise.T, strict=True)
    ]
    without_uncertainty, correlated = [], []
    for quantity in physical_quantities(posor):
        where = list(quantity.parameters)
        own = found.by_parameter[:, quantity.parameters]
        if not np.any(own):
            continue  # without effect at this pose, such as a light source that is not lit
        if not np.any(whole[where]):
            without_uncertainty.append(quantity.name)
            continue
        if np.any(np.delete(root, where, axis=0)[:, np.any(root[where], axis=0)]):
            correlated.append(quantity.name)
        effects = np.linalg.norm(own @ root[where], axis=1)
        parts.append(Contribution(quantity.name, ContributionKind.SYSTEMATIC, effects))
    for name, effect in zip(posor.calibration.shared, posor.shared_effects.T, strict=True):
        effects = np.abs(found.by_parameter @ effect)
        parts.append(Contribution(f"shared: {name}", ContributionKind.SYSTEMATIC, effects))
    largest = _shares(np.array([part.effects for part in parts])).max(axis=1)
    order = sorted(range(len(parts)), key=lambda i: largest[i], reverse=True)
    systematic = found.by_parameter @ whole
    return ErrorBudget(
        T_R_T=T_R_T,
        outputs=found.outputs,
        values=found.values,
        contributions=tuple(parts[i] for i in order if largest[i] > 0.0),
        covariance=noise @ noise.T + systematic @ systematic.T,
        without_uncertainty=tuple(without_uncertainty),
        correlated=tuple(correlated),
    )
