"""What every sensor of a POSOR's stack can do: linearise its readings, and say where each reading's geometry is.

A sensor type is a pydantic model (its part of the calibration file) and a subclass of ``Sensor`` made from it. The
parameters that carry uncertainty are named arrays; all of them together, in order, are the sensor's parameter vector.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from posor_estimator.core.calibration.quantity import FrozenModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibration.session import Session
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.types import FloatArray, IntArray

ROW_WIDTH = 15


class SensorCalibration(FrozenModel, ABC):
    """A sensor's part of the calibration file. Subclasses add ``type: Literal[...]``, by which files name them."""

    @abstractmethod
    def build(self) -> Sensor:
        """Return the sensor that this calibration describes."""

    @abstractmethod
    def for_session(self, session: Session) -> Self:
        """Return this calibration with the session's replacements; entries that do not concern it are ignored."""


@dataclass(frozen=True)
class Linearised:
    """A scan's readings of one sensor on the model's scale.

    Attributes:
        values: Linearised readings [m], shape (m,).
        variances: Their variances from the noise of the electronics [m^2], shape (m,).

    """

    values: FloatArray
    variances: FloatArray


class Sensor(ABC):
    """One sensor of a stack; immutable once made."""

    def __init__(self, parameters: Mapping[str, FloatArray], sigmas: Mapping[str, FloatArray]) -> None:
        """Keep the named parameters and their standard uncertainties (same shapes)."""
        self._parameters = {name: np.array(value, dtype=float) for name, value in parameters.items()}
        self._sigmas = np.concatenate([np.ravel(sigmas[name]) for name in parameters])
        self._slices: dict[str, slice] = {}
        start = 0
        for name, value in self._parameters.items():
            self._slices[name] = slice(start, start + value.size)
            start += value.size
        self._prepare()

    def _prepare(self) -> None:  # noqa: B027  not every sensor derives something
        """Recompute what is derived from the parameters."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of each entry of the parameter vector, such as ``tips[1,2]``."""
        return tuple(
            f"{name}[{','.join(map(str, index))}]"
            for name, value in self._parameters.items()
            for index in np.ndindex(value.shape)
        )

    @property
    def parameter_values(self) -> FloatArray:
        """The parameter vector, shape (p,)."""
        return np.concatenate([value.ravel() for value in self._parameters.values()])

    @property
    def parameter_sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, shape (p,)."""
        return self._sigmas.copy()

    def with_parameter_values(self, values: FloatArray) -> Self:
        """Return the same sensor with another parameter vector (shape (p,))."""
        other = copy.copy(self)
        other._parameters = {  # noqa: SLF001  a copy of the same class
            name: np.array(values[self._slices[name]]).reshape(old.shape) for name, old in self._parameters.items()
        }
        other._prepare()  # noqa: SLF001
        return other

    @property
    @abstractmethod
    def reading_names(self) -> tuple[str, ...]:
        """Name of each linearised reading, in row order."""

    @property
    @abstractmethod
    def kinds(self) -> IntArray:
        """Kind of each row (``kernels.solve``), shape (m,)."""

    @abstractmethod
    def rows(self, scan: Scan) -> FloatArray:
        """Return the geometry of each reading of this scan, shape (m, ROW_WIDTH)."""

    @abstractmethod
    def linearise(self, scan: Scan) -> Linearised:
        """Return the readings on the model's scale.

        Raises:
            ScanError: The scan's readings do not fit: count, not finite, no light, outside the calibrated range.

        """

    @abstractmethod
    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
