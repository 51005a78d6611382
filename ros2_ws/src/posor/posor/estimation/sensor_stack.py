# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensors side by side as one set of readings: whose reading, row and parameter is which, laid out for the kernels."""

from __future__ import annotations

from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import CalibrationError
from posor.estimation.fault_model import FaultModel
from posor.estimation.linearise import linearise_scans
from posor.estimation.solver import SINGULAR, solve_start
from posor.estimation.workspace import (
    BLOCK,
    CONTRIBUTION,
    FACTOR_USE,
    PARAMETER_FACTORS,
    READINGS,
    SENSOR,
    WORKSPACE,
    Model,
)
from posor.model.diode import DIODE
from posor.model.reading_rows import AFFINE, PARAMETERS, ROW, ROW_DERIVATIVES, evaluate_rows
from posor.model.readings import DIODE_CURRENTS, PYTHON, SOURCE_NAMES
from posor.model.voltage import CHANNEL, CHANNEL_DERIVATIVES, CHANNEL_PARAMETERS
from posor.numerics.compiled import record_view
from posor.sensors.base import Linearised, PlainSensor, ReadingSource, RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor.calibration.parameter_covariance import CovarianceSquareRoot
    from posor.errors import ScanError
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray, IntArray
    from posor.sensors.base import Sensor


class Stack:
    """Sensors side by side.

    Attributes:
        sensors: The sensors, in the calibration file's order.
        readings: Number of linearised readings m.
        first_readings: First reading of each sensor.
        first_parameters: First parameter of each sensor.
        parameters: Number of parameters of all sensors.
        reading_rows: All rows that any scan can read, shape (K,), dtype ROW; plain sensors have one affine row for each
            reading.
        row_parameters: Where each row parameter stands in the parameter vector, negative for none, (K, PARAMETERS).

    Raises:
        CalibrationError: The sensors have more readings than the estimator has capacity for, or two of them read the
            same field of a scan.

    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        """Lay the sensors' readings and parameters end to end."""
        self.sensors = list(sensors)
        counts = [len(sensor.reading_names) for sensor in self.sensors]
        sizes = [sensor.parameter_values.size for sensor in self.sensors]
        self.readings, self.parameters = sum(counts), sum(sizes)
        if self.readings > READINGS:
            raise CalibrationError(f"{self.readings} readings", where="sensors", expected=f"at most {READINGS}")
        sources = [sensor.reading_source.source for sensor in self.sensors if isinstance(sensor, RowSensor)]
        if len(set(sources)) < len(sources):
            field = SOURCE_NAMES[next(source for source in sources if sources.count(source) > 1)]
            raise CalibrationError(f"two sensors read the {field}", where="sensors", expected="one sensor of each type")
        self.first_readings, self.first_parameters = _starts(counts), _starts(sizes)
        tables = [
            sensor.row_table() if isinstance(sensor, RowSensor) else _affine_rows(count)
            for sensor, count in zip(self.sensors, counts, strict=True)
        ]
        self.reading_rows = _joined([rows for rows, _ in tables], ROW)
        self._first_reading_rows = _starts([len(rows) for rows, _ in tables])
        self.row_parameters: IntArray = np.concatenate(
            [np.where(own >= 0, own + first, -1) for (_, own), first in zip(tables, self.first_parameters, strict=True)]
        )

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Name of each linearised reading."""
        return tuple(name for sensor in self.sensors for name in sensor.reading_names)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of each parameter, the sensor's class first, such as ``GapProbes.tips[0,1]``."""
        return tuple(f"{type(sensor).__name__}.{name}" for sensor in self.sensors for name in sensor.parameter_names)

    @property
    def parameter_values(self) -> FloatArray:
        """The parameter vector of all sensors, shape (p,)."""
        return np.concatenate([sensor.parameter_values for sensor in self.sensors])

    @property
    def parameter_sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, shape (p,)."""
        return np.concatenate([sensor.parameter_sigmas for sensor in self.sensors])

    def with_parameter_values(self, values: FloatArray) -> Stack:
        """Return the same stack with another parameter vector (shape (p,))."""
        ends = [*self.first_parameters[1:], self.parameters]
        return Stack(
            [
                sensor.with_parameter_values(values[first:end])
                for sensor, first, end in zip(self.sensors, self.first_parameters, ends, strict=True)
            ]
        )

    def load_parameter_values(self, values: FloatArray) -> None:
        """Replace the parameter vector (shape (p,)) in place: many draws need not make many stacks.

        The stack then linearises and evaluates as one ``with_parameter_values``. Its ``sensors`` keep their parameters;
        none of them may be a plain one.
        """
        for table, rows, columns, parameters in self._parameter_tables:
            table[rows, columns] = values[parameters]

    @cached_property
    def _parameter_tables(self) -> list[tuple[FloatArray, IntArray, IntArray, IntArray]]:
        """The kernels' arrays that hold parameters: array, rows and columns of its parameters, and which they are."""
        model = self._linearising_model
        channels, maps = [np.zeros((0, CHANNEL_PARAMETERS), np.int64)], [np.zeros((0, 0), np.int64)]
        for sensor, first in zip(self.sensors, self.first_parameters, strict=True):
            if isinstance(sensor, RowSensor):
                own = sensor.reading_source.table_parameters
                ids = np.where(own >= 0, own + first, -1)
                (channels if sensor.reading_source.channels.size else maps).append(ids)
        tables = (
            (self.reading_rows["parameters"], self.row_parameters),
            (model.channels["parameters"], np.concatenate(channels)),
            (model.map_parameters, np.concatenate([_padded(ids, model.map_parameters.shape[1], -1) for ids in maps])),
        )
        entries = []
        for table, ids in tables:
            rows, columns = np.nonzero(ids >= 0)
            entries.append((table, rows, columns, ids[rows, columns]))
        return entries

    @property
    def plain_sensors(self) -> list[tuple[int, PlainSensor, slice]]:
        """The sensors written in plain Python: number, sensor, and its readings."""
        return [
            (number, sensor, slice(first, first + len(sensor.reading_names)))
            for number, (sensor, first) in enumerate(zip(self.sensors, self.first_readings, strict=True))
            if isinstance(sensor, PlainSensor)
        ]

    def affine_rows(self, number: int) -> IntArray:
        """Return the reading rows of a plain sensor, given its number among the sensors."""
        return self._first_reading_rows[number] + np.arange(len(self.sensors[number].reading_names))

    @cached_property
    def _linearising_model(self) -> Model:
        return self.model(None)

    def linearise(self, scans: Scans) -> Linearised:
        """Return the linearised readings of all scans; those of a scan with an invalid reading are meaningless."""
        n, m = len(scans), self.readings
        out = Linearised(
            np.zeros((n, m)),
            np.ones((n, m)),
            np.zeros((n, m), dtype=np.int64),
            np.zeros((n, len(self.sensors)), np.int64),
        )
        records = record_view(np.require(scans._records, requirements=["C", "W"]))
        linearise_scans(self._linearising_model, records, out.values, out.variances, out.selected, out.codes)
        for number, sensor, readings in self.plain_sensors:
            out.selected[:, readings] = self.affine_rows(number)
            for i in range(n):
                reading = sensor.try_read(scans[i])
                if reading is None:
                    out.codes[i, number] = 1
                else:
                    out.values[i, readings], out.variances[i, readings] = reading.values, reading.variances
        return out

    def invalid_scan(self, scan: Scan, linearised: Linearised) -> ScanError:
        """Return the error of a scan of which the readings of a sensor are invalid."""
        sensor = int(np.flatnonzero(linearised.codes[0])[0])
        return self.sensors[sensor].explain(scan, int(linearised.codes[0, sensor]))

    def expand_plain_rows(self, rows: NDArray[np.void], rotation: FloatArray, translation: FloatArray) -> None:
        """Fill in the affine rows of plain sensors, among the rows (m or more,) of a scan, at a pose ``T_R_T``."""
        for _, sensor, readings in self.plain_sensors:
            rows["value"][readings], rows["derivative"][readings] = sensor.predict(rotation, translation)

    def evaluate(
        self, selected: IntArray, rotation: FloatArray, translation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what selected reading rows (m,) read at ``T_R_T`` [m] and their tangent derivatives, (m,), (m, 6)."""
        rows = self.reading_rows[selected]
        self.expand_plain_rows(rows, rotation, translation)
        return evaluate_rows(rows, rotation, translation)

    def solve(self, readings: Linearised, n: int, rotation: FloatArray, translation: FloatArray) -> int:
        """Solve the readings of scan n from ``T_R_T`` on, which is replaced by the solution; weights from the noise.

        Return CONVERGED, NOT_CONVERGED or ILL_CONDITIONED of ``estimation.solver``.
        """
        workspace, m = self._linearising_model.workspace[0], self.readings
        rows, pose = workspace["rows"][:m], workspace["pose"]
        rows[:] = self.reading_rows[readings.selected[n]]
        self.expand_plain_rows(rows, rotation, translation)
        workspace["values"][:m], workspace["variances"][:m] = readings.values[n], readings.variances[n]
        pose["rotation"], pose["translation"] = rotation, translation
        outcome = solve_start(self._linearising_model, SINGULAR)
        rotation[:], translation[:] = pose["rotation"], pose["translation"]
        return int(outcome)

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
        out = np.zeros((self.readings, self.parameters))
        for sensor, row, column in zip(self.sensors, self.first_readings, self.first_parameters, strict=True):
            block = sensor.residual_jacobian(scan, rotation, translation)
            out[row : row + block.shape[0], column : column + block.shape[1]] = block
        return out

    def model(self, square_root: CovarianceSquareRoot | None, faults: FaultModel | None = None) -> Model:
        """Return the stack for the kernels.

        ``square_root``: of the covariance of its parameters; None: exact ones. ``faults``: hypotheses; None: no causes.
        """
        sources = [s.reading_source if isinstance(s, RowSensor) else None for s in self.sensors]
        present = [source for source in sources if source is not None]
        records, linearisation = self._sensor_records(sources)
        longest_map = max([0, *(source.map_parameters.shape[1] for source in present)])
        m, factors = self.readings, 0 if square_root is None else square_root.factor_count
        shared = np.zeros((self.parameters, 0)) if square_root is None else square_root.shared
        of_rows = m * PARAMETERS
        derivatives = np.zeros(of_rows + linearisation.size)
        by_linearisation = derivatives[of_rows:].reshape(linearisation.shape)
        parameters = np.zeros(self.parameters, dtype=PARAMETER_FACTORS)
        if square_root is not None:
            parameters["first_factor"], parameters["count"], parameters["begin"] = square_root.spans.T
        most = _most_coefficients(parameters["count"], self.row_parameters, linearisation, m)
        workspace = np.zeros(1, dtype=WORKSPACE)
        workspace["reading_count"], workspace["redundant_count"] = m, max(m - 6, 0)
        workspace["active_rows"] = -1
        workspace["first_correlated"], workspace["end_correlated"] = np.arange(READINGS), np.arange(READINGS) + 1
        return Model(
            workspace=record_view(workspace),
            sensors=record_view(records),
            reading_rows=record_view(self.reading_rows),
            row_parameters=self.row_parameters,
            channels=record_view(_joined([source.channels for source in present], CHANNEL)),
            diodes=record_view(_joined([source.diodes for source in present], DIODE)),
            map_parameters=np.concatenate(
                [np.zeros((0, longest_map)), *(_padded(source.map_parameters, longest_map, 0) for source in present)]
            ),
            linearisation_parameters=linearisation,
            derivatives=derivatives,
            by_row=record_view(derivatives[:of_rows].view(ROW_DERIVATIVES)),
            by_channel=record_view(_channel_derivatives(by_linearisation)),
            by_map=by_linearisation,
            parameter_factors=record_view(parameters),
            coefficients=np.zeros(0) if square_root is None else square_root.coefficients,
            effects=np.zeros((m, min(factors, most))),
            contributions=record_view(np.zeros(m * (PARAMETERS + linearisation.shape[1]), dtype=CONTRIBUTION)),
            contribution_coefficients=np.zeros(most),
            blocks=record_view(np.zeros(factors, dtype=BLOCK)),
            factor_uses=record_view(np.zeros(factors, dtype=FACTOR_USE)),
            shared_coefficients=np.ascontiguousarray(shared[:0] if self.plain_sensors else shared),
            shared_readings=np.zeros((m, shared.shape[1])),
            faults=faults or FaultModel.of([], m),
        )

    def _sensor_records(self, sources: Sequence[ReadingSource | None]) -> tuple[NDArray[np.void], IntArray]:
        """Return the sensors' records, and which parameter each derivative of a reading's linearisation belongs to."""
        records = np.zeros(len(sources), dtype=SENSOR)
        # One column and one row more than a single channel has: so views by channel have one strided type.
        columns = [source.parameters.shape[1] for source in sources if source is not None]
        parameters = np.full((max(self.readings, 2), max([CHANNEL_PARAMETERS + 1, *columns])), -1, dtype=np.int64)
        channels = diodes = 0
        for number, (record, source) in enumerate(zip(records, sources, strict=True)):
            first = self.first_readings[number]
            record["first_reading"], record["first_reading_row"] = first, self._first_reading_rows[number]
            record["source"] = PYTHON
            if source is None:
                continue
            is_diodes = source.source == DIODE_CURRENTS
            record["source"], record["light_sources"] = source.source, source.light_sources
            record["first_channel"] = diodes if is_diodes else channels
            record["count"] = len(source.diodes) if is_diodes else len(source.channels)
            channels, diodes = channels + len(source.channels), diodes + len(source.diodes)
            own = np.where(source.parameters >= 0, source.parameters + self.first_parameters[number], -1)
            parameters[first : first + len(own), : own.shape[1]] = own
        return records, parameters


def _starts(counts: Sequence[int]) -> list[int]:
    """Return where each of some parts begins that stand end to end."""
    return [0, *accumulate(counts)][: len(counts)]


def _joined(records: Sequence[NDArray[np.void]], dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return records end to end; numpy's concatenate would change a dtype with overlapping fields."""
    out = np.zeros(sum(len(part) for part in records), dtype=dtype)
    for part, start in zip(records, _starts([len(part) for part in records]), strict=True):
        out[start : start + len(part)] = part
    return out


def _affine_rows(count: int) -> tuple[NDArray[np.void], IntArray]:
    rows = np.zeros(count, dtype=ROW)
    rows["kind"] = AFFINE
    return rows, np.full((count, PARAMETERS), -1)


def _padded(rows: NDArray[Any], width: int, fill: int) -> NDArray[Any]:
    """Return rows padded on the right to a width."""
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=fill)


def _channel_derivatives(by_linearisation: FloatArray) -> NDArray[np.void]:
    """Return the first columns of the derivatives by the linearisation as records, shape (m,), without copying."""
    out: NDArray[np.void] = np.ndarray(
        len(by_linearisation), CHANNEL_DERIVATIVES, by_linearisation, strides=by_linearisation.strides[:1]
    )
    return out


def _most_coefficients(counts: IntArray, of_reading_rows: IntArray, of_linearisation: IntArray, readings: int) -> int:
    """Return how many coefficients the parameters of the readings of one scan have at most."""
    counts = np.append(counts, 0)  # the last one for no parameter, -1
    return readings * int(counts[of_reading_rows].sum(axis=1).max(initial=0)) + int(counts[of_linearisation].sum())
