"""A stack of sensors as one set of rows: who owns which reading, and where all parameters stand."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from posor_estimator.core.kernels.rows import AFFINE, AFFINE_PARAMETERS
from posor_estimator.core.sensors.base import Batch, RowPool, RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.sensors.base import Sensor
    from posor_estimator.core.types import FloatArray, IntArray


class Stack:
    """Sensors side by side.

    Attributes:
        sensors: The sensors, in the calibration file's order.
        readings: Number of linearised readings m.
        first_rows: First reading of each sensor.
        first_parameters: First parameter of each sensor.
        first_pool_rows: First row of each sensor in the pool.
        parameters: Number of parameters of all sensors.
        pool: All rows that any scan can have, ids counted over all sensors; sensors without rows have one affine row
            for each reading, to be filled in.

    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        """Lay the sensors' readings and parameters end to end."""
        self.sensors = list(sensors)
        counts = [len(sensor.reading_names) for sensor in self.sensors]
        sizes = [sensor.parameter_values.size for sensor in self.sensors]
        self.readings = sum(counts)
        self.first_rows = [sum(counts[:i]) for i in range(len(counts))]
        self.parameters = sum(sizes)
        self.first_parameters = [sum(sizes[:i]) for i in range(len(sizes))]
        pools = [
            sensor.pool if isinstance(sensor, RowSensor) else _affine_pool(count)
            for sensor, count in zip(self.sensors, counts, strict=True)
        ]
        width = max(AFFINE_PARAMETERS, *(pool.rows.shape[1] for pool in pools))
        self.first_pool_rows = [sum(len(pool.kinds) for pool in pools[:i]) for i in range(len(pools))]
        self.pool = RowPool(
            np.concatenate([pool.kinds for pool in pools]),
            np.concatenate([_widened(pool.rows, width, 0) for pool in pools]),
            np.concatenate(
                [
                    _widened(np.where(pool.ids >= 0, pool.ids + first, -1), width, -1)
                    for pool, first in zip(pools, self.first_parameters, strict=True)
                ]
            ),
            np.concatenate([_widened(pool.sigmas, width, 0) for pool in pools]),
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

    def linearise(self, scans: Scans) -> tuple[IntArray, Batch]:
        """Return each sensor's codes, shape (n, sensors), and the linearised readings of all scans."""
        n, m = len(scans), self.readings
        batch = Batch(np.zeros((n, m)), np.ones((n, m)), np.zeros((n, m), dtype=np.int64))
        codes = np.empty((n, len(self.sensors)), dtype=np.int64)
        for i, sensor in enumerate(self.sensors):
            if not isinstance(sensor, RowSensor):
                rows = slice(self.first_rows[i], self.first_rows[i] + len(sensor.reading_names))
                batch.chosen[:, rows] = self.first_pool_rows[i] + np.arange(len(sensor.reading_names))
            codes[:, i] = sensor.linearise(scans, batch, self.first_rows[i], self.first_pool_rows[i])
        return codes, batch

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(linearised reading - prediction)/d(parameter) at the pose ``T_R_T``, shape (m, p)."""
        out = np.zeros((self.readings, self.parameters))
        for sensor, row, column in zip(self.sensors, self.first_rows, self.first_parameters, strict=True):
            block = sensor.residual_jacobian(scan, rotation, translation)
            out[row : row + block.shape[0], column : column + block.shape[1]] = block
        return out


def _affine_pool(count: int) -> RowPool:
    shape = (count, AFFINE_PARAMETERS)
    kinds = np.full(count, AFFINE, dtype=np.int64)
    return RowPool(kinds, np.zeros(shape), np.full(shape, -1, dtype=np.int64), np.zeros(shape))


Numbers = TypeVar("Numbers", np.float64, np.int64)


def _widened(rows: NDArray[Numbers], width: int, fill: int) -> NDArray[Numbers]:
    """Return rows padded on the right to a width."""
    out = np.full((len(rows), width), fill, dtype=rows.dtype)
    out[:, : rows.shape[1]] = rows
    return out
