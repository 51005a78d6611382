"""The error budget of a POSOR at a pose, of first order (JCGM 100, 5.1 and 5.2).

Every derivative is the measurement model's own: what a shift of a reading does to the pose (``Posor.sensitivity``), and
what a shift of a parameter does to the readings (``Stack.residual_jacobian``).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.budget.outputs import Output, Outputs
from posor_estimator.core.budget.quantities import physical_quantities
from posor_estimator.core.kernels.locate import SINGULAR
from posor_estimator.core.kernels.solve import ILL_CONDITIONED, gauss_newton
from posor_estimator.core.plain_rows import PlainRows
from posor_estimator.core.scan import Scans
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin

    from posor_estimator.core.budget.outputs import PlatePoint
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.sensors.base import Batch
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray


class Kind(StrEnum):
    """How a contribution acts: differently in every scan, or the same in all scans of one calibration."""

    RANDOM = "random"
    SYSTEMATIC = "systematic"


@dataclass(frozen=True)
class Contribution:
    """What one quantity does to the judged quantities.

    Attributes:
        name: The quantity.
        kind: Noise of a reading, or what is calibrated.
        effects: Standard uncertainty of each judged quantity from it alone, all else exact [m, rad], shape (k,).

    """

    name: str
    kind: Kind
    effects: FloatArray


@dataclass(frozen=True)
class ErrorBudget:
    """Error budget at one pose.

    Attributes:
        T_R_T: The pose.
        outputs: The judged quantities.
        values: What they are there [m, rad], shape (k,).
        contributions: What has any effect, that with the largest share in any judged quantity first.
        covariance: Of the judged quantities, all contributions and their correlations in it, shape (k, k).
        unstated: Quantities that the calibration gives no uncertainty for: taken as exact.
        together: Contributing quantities that vary together with others, by the calibration. Theirs do not add up to
            the total, which may be far smaller, nor is any as much as knowing that quantity exactly would take away.

    """

    T_R_T: pin.SE3
    outputs: tuple[Output, ...]
    values: FloatArray
    contributions: tuple[Contribution, ...]
    covariance: FloatArray
    unstated: tuple[str, ...]
    together: tuple[str, ...]

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each judged quantity by the full covariance, shape (k,)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    def root_sum_square(self, kind: Kind | None = None) -> FloatArray:
        """Return the root sum square of all contributions, or of those of one kind, shape (k,)."""
        effects = [part.effects for part in self.contributions if kind is None or part.kind is kind]
        return np.sqrt(np.sum(np.square(effects), axis=0)) if effects else np.zeros(len(self.outputs))

    def shares(self) -> FloatArray:
        """Return each contribution's share of the summed variances, shape (contributions, k); zero where all is."""
        return _shares(np.array([part.effects for part in self.contributions]).reshape(-1, len(self.outputs)))


def _shares(effects: FloatArray) -> FloatArray:
    squares = np.square(effects)
    total = np.sum(squares, axis=0)
    return np.asarray(np.divide(squares, total, out=np.zeros_like(squares), where=total > 0.0))


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of the judged quantities at one pose.

    Attributes:
        outputs: The judged quantities.
        values: What they are there [m, rad], shape (k,).
        by_reading: With respect to each linearised reading, shape (k, m).
        by_parameter: With respect to each parameter of the stack, the readings standing still, shape (k, p).
        noise: Standard deviation of each linearised reading from the electronics' noise [m], shape (m,).

    """

    outputs: tuple[Output, ...]
    values: FloatArray
    by_reading: FloatArray
    by_parameter: FloatArray
    noise: FloatArray


def sensitivities(posor: Posor, scan: Scan, T_R_T: pin.SE3, points: Sequence[PlatePoint] = ()) -> Sensitivities:
    """Return what readings and parameters do to the judged quantities; arguments and errors as ``error_budget``."""
    stack, rotation, translation = posor.stack, T_R_T.rotation.copy(), T_R_T.translation.copy()
    codes, batch = stack.linearise(Scans.of([scan]))
    for sensor, code in zip(stack.sensors, codes[0], strict=True):
        if code != 0:
            raise sensor.explain(scan, int(code))
    _require_determined(stack, batch, rotation, translation)
    outputs = Outputs(stack, points)
    by_reading = outputs.by_motion(rotation, translation) @ posor.sensitivity(scan, T_R_T)[0]
    by_parameter = by_reading @ stack.residual_jacobian(scan, rotation, translation)
    by_parameter += outputs.by_parameters(rotation, translation)
    return Sensitivities(
        outputs=outputs.named,
        values=outputs.values(rotation, translation),
        by_reading=by_reading,
        by_parameter=by_parameter,
        noise=np.sqrt(batch.variances[0]),
    )


def _require_determined(stack: Stack, batch: Batch, rotation: FloatArray, translation: FloatArray) -> None:
    """Refuse readings that do not determine all six freedoms, by the estimator's own measure."""
    chosen = batch.chosen[0]
    rows = stack.pool.rows[chosen].copy()
    PlainRows(stack).expand(rows, rotation, translation)
    outcome = gauss_newton(
        stack.pool.kinds[chosen],
        rows,
        batch.values[0],
        1.0 / batch.variances[0],
        rotation.copy(),
        translation.copy(),
        np.empty((stack.readings, 6)),
        np.empty(stack.readings),
        np.empty(6),
        SINGULAR,
    )
    if outcome == ILL_CONDITIONED:
        raise FitError("the readings do not determine all six freedoms at this pose", expected="a pose where they do")


def error_budget(
    posor: Posor,
    scan: Scan,
    T_R_T: pin.SE3,
    points: Sequence[PlatePoint] = (),
) -> ErrorBudget:
    """Return the first-order budget at a pose, of the covariance that the calibration states.

    Contributions come in the order of the largest share that each has in any judged quantity: what to improve first.

    Args:
        posor: The POSOR.
        scan: What it reads at the pose.
        T_R_T: The pose.
        points: Points of the plate whose gap is judged beside the six native coordinates.

    Raises:
        ScanError: The scan cannot be linearised.
        FitError: Its readings do not determine all six freedoms at this pose.

    """
    found = sensitivities(posor, scan, T_R_T, points)
    root = posor.parameter_root
    noise = found.by_reading * found.noise
    parts = [
        Contribution(f"{name}: noise", Kind.RANDOM, np.abs(effect))
        for name, effect in zip(posor.stack.reading_names, noise.T, strict=True)
    ]
    unstated, together = [], []
    for quantity in physical_quantities(posor):
        where = list(quantity.parameters)
        own = found.by_parameter[:, quantity.parameters]
        if not np.any(own):
            continue  # no part in this pose, such as a light source that is not lit
        if not np.any(root[where]):
            unstated.append(quantity.name)
            continue
        if np.any(np.delete(root, where, axis=0)[:, np.any(root[where], axis=0)]):
            together.append(quantity.name)
        parts.append(Contribution(quantity.name, Kind.SYSTEMATIC, np.linalg.norm(own @ root[where], axis=1)))
    largest = _shares(np.array([part.effects for part in parts])).max(axis=1)
    order = sorted(range(len(parts)), key=lambda i: largest[i], reverse=True)
    pushed = found.by_parameter @ root
    return ErrorBudget(
        T_R_T=T_R_T,
        outputs=found.outputs,
        values=found.values,
        contributions=tuple(parts[i] for i in order if largest[i] > 0.0),
        covariance=noise @ noise.T + pushed @ pushed.T,
        unstated=tuple(unstated),
        together=tuple(together),
    )
