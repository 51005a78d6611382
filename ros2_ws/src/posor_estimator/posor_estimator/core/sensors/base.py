"""What every sensor of a POSOR's stack can do: linearise its readings, and predict them from a pose.

A sensor type is a pydantic model (its part of the calibration file) and a subclass of ``Sensor`` made from it. The
parameters that carry uncertainty are named arrays; all of them together, in order, are the sensor's parameter vector.
Sensors whose geometry is one of the compiled kernels derive from ``RowSensor``; any other kind derives from
``PlainSensor`` and gives prediction and derivatives in plain Python.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.kernels.rows import row_parameters
from posor_estimator.errors import ScanError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibration.session import Session
    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.types import FloatArray, IntArray


class SensorCalibration(FrozenModel, ABC):
    """A sensor's part of the calibration file. Subclasses add ``type: Literal[...]``, by which files name them."""

    @abstractmethod
    def build(self) -> Sensor:
        """Return the sensor that this calibration describes."""

    def for_session(self, session: Session) -> Self:  # noqa: ARG002  most sensors have nothing that a session changes
        """Return this calibration with the session's replacements; entries that do not concern it are ignored."""
        return self

    @property
    def bump_angle(self) -> float:
        """Angle [rad] after which the sensor's readings repeat, so that theta must be counted; zero: never."""
        return 0.0

    @property
    def home_theta(self) -> float:
        """Theta [rad] at which the sensor's home mark is seen."""
        return 0.0


@dataclass(frozen=True)
class Batch:
    """Where sensors write the linearised readings of n scans; m rows in all.

    Attributes:
        values: Readings on the model's scale [m], shape (n, m).
        variances: Their variances from the noise of the electronics [m^2], shape (n, m).
        chosen: Which row of the stack's pool each reading is, shape (n, m).

    """

    values: FloatArray
    variances: FloatArray
    chosen: IntArray


class Sensor(ABC):
    """One sensor of a stack; immutable once made."""

    def __init__(self, parameters: Mapping[str, FloatArray], sigmas: Mapping[str, FloatArray]) -> None:
        """Keep the named parameters and their standard uncertainties (same shapes)."""
        self._shapes = {name: np.shape(value) for name, value in parameters.items()}
        self._slices: dict[str, slice] = {}
        start = 0
        for name, value in parameters.items():
            self._slices[name] = slice(start, start + np.size(value))
            start += np.size(value)
        self._values = np.concatenate([np.ravel(value) for value in parameters.values()]).astype(float)
        self._sigmas = np.concatenate([np.ravel(sigmas[name]) for name in parameters]).astype(float)
        self._prepare()

    def _prepare(self) -> None:  # noqa: B027  not every sensor derives something
        """Recompute what is derived from the parameters."""

    def _array(self, name: str) -> FloatArray:
        """Return one named parameter array."""
        return self._values[self._slices[name]].reshape(self._shapes[name])

    def _ids(self, name: str) -> IntArray:
        """Return where the entries of a named array stand in the parameter vector, in the array's shape."""
        where = self._slices[name]
        return np.arange(where.start, where.stop).reshape(self._shapes[name])

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of each entry of the parameter vector, such as ``tips[1,2]``."""
        return tuple(
            f"{name}[{','.join(map(str, index))}]"
            for name, shape in self._shapes.items()
            for index in np.ndindex(shape)
        )

    @property
    def parameter_values(self) -> FloatArray:
        """The parameter vector, shape (p,)."""
        return self._values.copy()

    @property
    def parameter_sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, shape (p,)."""
        return self._sigmas.copy()

    def with_parameter_values(self, values: FloatArray) -> Self:
        """Return the same sensor with another parameter vector (shape (p,))."""
        other = copy.copy(self)
        other._values = np.array(values, dtype=float)  # noqa: SLF001  a copy of the same class
        other._prepare()  # noqa: SLF001
        return other

    @property
    @abstractmethod
    def reading_names(self) -> tuple[str, ...]:
        """Name of each linearised reading, in row order."""

    @abstractmethod
    def linearise(self, scans: Scans, batch: Batch, first: int, offset: int) -> IntArray:
        """Write the linearised readings of all scans into the batch, from row ``first`` on.

        Args:
            scans: Raw readings.
            batch: Where to write; ``chosen`` only by sensors with rows.
            first: The sensor's first row.
            offset: Where the sensor's own rows begin in the stack's pool.

        Returns:
            For each scan zero, or a code that ``explain`` understands, shape (n,).

        """

    @abstractmethod
    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of ``linearise`` means for a scan, as an error with its fault and its sentence."""

    @abstractmethod
    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""


@dataclass(frozen=True)
class RowPool:
    """Every row that a sensor can have (a diode has one pair for each source that it may see).

    Attributes:
        kinds: Kind of each row, shape (K,).
        rows: Parameters of each row, shape (K, width).
        ids: Where each row parameter stands in the sensor's parameter vector, negative for constants, (K, width).
        sigmas: Standard uncertainty of each row parameter, shape (K, width).

    """

    kinds: IntArray
    rows: FloatArray
    ids: IntArray
    sigmas: FloatArray


@dataclass(frozen=True)
class Readout:
    """How the compiled kernels linearise a sensor's raw readings (``kernels.readout``).

    Attributes:
        source: Which field of a scan the readings come from, and so of which kind they are.
        numbers: Of each channel (``kernels.voltage``) or diode (``kernels.diode``), shape (count, any).
        ids: Where the parameters of each reading's linearisation stand in the sensor's parameter vector, negative for
            none, shape (m, L).
        maps: Kind and lengths of each diode's map, shape (diodes, 3).
        sources: Light sources that each diode may see.

    """

    source: int
    numbers: FloatArray
    ids: IntArray
    maps: IntArray = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    sources: int = 0


class RowSensor(Sensor):
    """A sensor whose readings are rows of the compiled kernels."""

    pool: RowPool

    def readout(self) -> Readout | None:
        """Return how the compiled kernels linearise the readings; None: they cannot, ``linearise`` does it."""
        return None

    @abstractmethod
    def _layout(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return kinds (K,), ids (K, width) and constants (K, width; used where an id is negative) of all rows."""

    def _prepare(self) -> None:
        kinds, ids, constants = self._layout()
        rows = np.where(ids >= 0, self._values[ids], constants)
        self.pool = RowPool(kinds, rows, ids, np.where(ids >= 0, self._sigmas[ids], 0.0))

    @abstractmethod
    def _chosen(self, scan: Scan) -> IntArray:
        """Return which rows of the pool this scan reads, shape (m,)."""

    @abstractmethod
    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the raw readings that linearise to these: the inverse of ``linearise``.

        Args:
            readings: On the model's scale [m], shape (n, m).
            scans: Supply voltage, temperature and lit sources that hold; raw readings are not looked at.

        Returns:
            The fields of ``Scans`` that are this sensor's, such as ``gap_voltages``; NaN beyond the calibrated range.

        """

    @abstractmethod
    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return this sensor's raw fields with the electronics' noise added, as large as the calibration says."""

    def rows_at(self, rotations: FloatArray, translations: FloatArray) -> tuple[IntArray, dict[str, IntArray]]:
        """Return which rows of the pool are read at poses (n, 3, 3), (n, 3), shape (n, m), and what scans say of it.

        A sensor that can choose (which light source to light) chooses here; the dictionary then holds that field of
        ``Scans``.
        """
        del translations
        return np.tile(np.arange(len(self.reading_names)), (len(rotations), 1)), {}

    @abstractmethod
    def _linearisation_jacobian(self, scan: Scan) -> FloatArray:
        """Return d(linearised reading)/d(parameter), shape (m, p)."""

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
        out = self._linearisation_jacobian(scan)
        derivative = np.empty(self.pool.rows.shape[1])
        for r, k in enumerate(self._chosen(scan)):
            row_parameters(self.pool.kinds[k], self.pool.rows[k], rotation, translation, derivative)
            for column, parameter in enumerate(self.pool.ids[k]):
                if parameter >= 0:
                    out[r, parameter] -= derivative[column]
        return out


@dataclass(frozen=True)
class Linearised:
    """One scan's readings of a plain sensor.

    Attributes:
        values: Readings on the model's scale, shape (m,); any unit, as long as ``predict`` uses the same.
        variances: Their variances from the noise of the electronics, shape (m,).
        jacobian: Their derivatives with respect to the sensor's parameters, shape (m, p).

    """

    values: FloatArray
    variances: FloatArray
    jacobian: FloatArray


class PlainSensor(Sensor):
    """A sensor written in plain Python: the way for a new type. It costs Python calls, several times in every scan."""

    @abstractmethod
    def read(self, scan: Scan) -> Linearised:
        """Return the readings of a scan on the model's scale.

        Raises:
            ScanError: The scan's readings do not fit.

        """

    @abstractmethod
    def predict(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the sensor reads at ``T_R_T`` (m,) and its local tangent derivative (m, 6)."""

    @abstractmethod
    def predict_jacobian(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(prediction)/d(parameter) at ``T_R_T``, shape (m, p)."""

    def linearise(self, scans: Scans, batch: Batch, first: int, offset: int) -> IntArray:  # noqa: ARG002  no pool
        """Linearise scan by scan; the code is 1 for a scan that ``read`` refuses."""
        codes = np.zeros(len(scans), dtype=np.int64)
        rows = slice(first, first + len(self.reading_names))
        for n in range(len(scans)):
            try:
                reading = self.read(scans[n])
            except ScanError:
                codes[n] = 1
                continue
            batch.values[n, rows] = reading.values
            batch.variances[n, rows] = reading.variances
        return codes

    def explain(self, scan: Scan, code: int) -> ScanError:  # noqa: ARG002  read() says it again
        """Return the error that ``read`` raises for the scan."""
        try:
            self.read(scan)
        except ScanError as error:
            return error
        message = "explain() was asked about a scan that read() accepts"
        raise AssertionError(message)

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
        return self.read(scan).jacobian - self.predict_jacobian(rotation, translation)
