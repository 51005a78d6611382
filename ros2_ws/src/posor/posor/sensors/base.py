# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What every sensor of a POSOR can do: linearise its readings, and predict them from a pose.

A sensor type is a pydantic model (its part of the calibration file) and a subclass of ``Sensor`` made from it. The
parameters that carry uncertainty are named arrays; all of them together, in order, are the sensor's parameter vector.
Sensors with geometry of a compiled kernel derive from ``RowSensor``; any other kind derives from ``PlainSensor`` and
gives prediction and derivatives in plain Python.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from posor.calibration.file_model import FrozenModel
from posor.errors import ScanError
from posor.model.diode import DIODE
from posor.model.reading_rows import ROW_PARAMETER_IDS, differentiate_rows
from posor.model.voltage import CHANNEL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from posor.calibration.session import Session
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

READING_KINDS = ("gap_voltages", "ring_voltages", "diode_currents")
"""Fields of ``Scans`` with one reading for each channel of the sensors."""


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
    def slip_angle(self) -> float:
        """Smallest angle [rad] by which theta may be wrong, unseen, if all light sources slip alike; zero: none."""
        return 0.0

    @property
    def home_theta(self) -> float:
        """Theta [rad] at which the sensor's home mark is seen."""
        return 0.0


@dataclass(frozen=True)
class Linearised:
    """Linearised readings of n scans; m readings."""

    values: FloatArray  # readings on the model's scale [m], shape (n, m)
    variances: FloatArray  # their variances from the noise of the electronics [m^2], shape (n, m)
    selected: IntArray  # which reading row of the stack each reading is, shape (n, m)
    # code of the first sensor with invalid readings, shape (n, sensors); zero for the others, also for those behind it,
    # which are not checked
    codes: IntArray

    @property
    def valid(self) -> BoolArray:
        """Which scans have valid readings only, shape (n,)."""
        return np.asarray(~self.codes.any(axis=1))


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

    def parameter_ids(self, name: str) -> IntArray:
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
    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of a scan's readings means, as an error with its fault and its sentence."""

    @abstractmethod
    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""


@dataclass(frozen=True)
class ReadingSource:
    """Where the compiled kernels find a sensor's raw readings, and how ``estimation.linearise`` linearises them."""

    source: int  # which field of a scan the readings come from
    # where the parameters of each reading's linearisation stand in the sensor's parameter vector, negative for none,
    # shape (m, L): those of its channel (``model.voltage``) or map (``model.spot_map``)
    parameters: IntArray
    # of voltage probes, shape (count,), dtype CHANNEL
    channels: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, dtype=CHANNEL))
    # of diodes, shape (count,), dtype DIODE
    diodes: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, dtype=DIODE))
    # of the diodes' maps, shape (count, longest)
    map_parameters: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    light_sources: int = 0  # how many light sources each diode can see

    @property
    def table_parameters(self) -> IntArray:
        """Where the values in ``channels`` or ``map_parameters`` stand in the parameter vector, shape (count, L)."""
        # Each coordinate of a map knows its own table only.
        return np.maximum(self.parameters[0::2], self.parameters[1::2]) if self.diodes.size else self.parameters


def no_parameters(count: int) -> NDArray[np.void]:
    """Return parameter numbers of rows, all -1 (none), shape (count,), under the field names of ROW_DERIVATIVES."""
    numbers = np.zeros(count, dtype=ROW_PARAMETER_IDS)
    numbers["parameters"] = -1
    return numbers


class RowSensor(Sensor):
    """A sensor whose readings are rows of the compiled kernels."""

    @property
    @abstractmethod
    def reading_source(self) -> ReadingSource:
        """Where the kernels find the raw readings and how they linearise them."""

    @abstractmethod
    def _layout(self) -> tuple[NDArray[np.void], IntArray]:
        """Return ``rows`` with their kinds and constants only, and ``row_parameters``."""

    def row_table(self) -> tuple[NDArray[np.void], IntArray]:
        """Return ``rows`` and ``row_parameters``, which are not kept: half a megabyte with 44 light sources."""
        rows, numbers = self._layout()
        rows["parameters"] = np.where(numbers >= 0, self._values[numbers], rows["parameters"])
        return rows, numbers

    @cached_property
    def _row_table(self) -> tuple[NDArray[np.void], IntArray]:
        return self.row_table()

    @property
    def rows(self) -> NDArray[np.void]:
        """Every row that the sensor can have (a diode has one pair for each light source), shape (K,), dtype ROW."""
        return self._row_table[0]

    @property
    def row_parameters(self) -> IntArray:
        """Where each row parameter stands in the parameter vector, negative for constants, shape (K, PARAMETERS)."""
        return self._row_table[1]

    def _prepare(self) -> None:
        vars(self).pop("_row_table", None)  # of other parameter values

    @abstractmethod
    def selected_rows(self, scan: Scan) -> IntArray:
        """Return which of the sensor's rows a scan reads, shape (m,)."""

    @abstractmethod
    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the raw readings that linearise to these: the inverse of the linearisation.

        ``readings``: on the model's scale [m], shape (n, m). ``scans``: supply voltage, temperature and lit sources
        that hold; raw readings are not looked at. Returns the fields of ``Scans`` that are this sensor's, such as
        ``gap_voltages``; NaN beyond the calibrated range.
        """

    @abstractmethod
    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return this sensor's raw fields with the electronics' noise added, as large as the calibration says."""

    def rows_at(self, rotations: FloatArray, translations: FloatArray) -> tuple[IntArray, dict[str, IntArray]]:
        """Return which rows are read at poses (n, 3, 3), (n, 3), shape (n, m), and the field of ``Scans`` for it.

        A sensor that can choose (which light source to light) chooses here; the dictionary then holds that field.
        """
        del translations
        return np.tile(np.arange(len(self.reading_names)), (len(rotations), 1)), {}

    @abstractmethod
    def _linearisation_jacobian(self, scan: Scan) -> FloatArray:
        """Return d(linearised reading)/d(parameter), shape (m, p)."""

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
        out = self._linearisation_jacobian(scan)
        selected = self.selected_rows(scan)
        derivatives = differentiate_rows(self.rows[selected], rotation, translation)
        for r, k in enumerate(selected):
            known = self.row_parameters[k] >= 0
            np.subtract.at(out[r], self.row_parameters[k, known], derivatives[r, known])
        return out


@dataclass(frozen=True)
class PlainReadings:
    """One scan's readings of a plain sensor."""

    values: FloatArray  # readings on the model's scale, shape (m,); any unit, as long as ``predict`` uses the same
    variances: FloatArray  # their variances from the noise of the electronics, shape (m,)
    jacobian: FloatArray  # their derivatives with respect to the sensor's parameters, shape (m, p)
    # their derivatives with respect to supply voltage and temperature, shape (m, 2); None: zero
    sensitivities: FloatArray | None = None


class PlainSensor(Sensor):
    """A sensor written in plain Python: the way for a new type. It costs Python calls, several times in every scan."""

    @abstractmethod
    def read(self, scan: Scan) -> PlainReadings:
        """Return the readings of a scan on the model's scale. Raises ScanError: the scan's readings do not fit."""

    @abstractmethod
    def predict(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the sensor reads at ``T_R_T`` (m,) and its local tangent derivative (m, 6)."""

    @abstractmethod
    def predict_jacobian(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(prediction)/d(parameter) at ``T_R_T``, shape (m, p)."""

    def try_read(self, scan: Scan) -> PlainReadings | None:
        """Return the readings of a scan, None where ``read`` refuses the scan."""
        try:
            return self.read(scan)
        except ScanError:
            return None

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
