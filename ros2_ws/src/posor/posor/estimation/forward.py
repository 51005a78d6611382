"""The model run forward: the raw readings of a POSOR's sensors at given poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor.model.reading_rows import evaluate_poses
from posor.model.scan import Scans
from posor.sensors.base import RowSensor

if TYPE_CHECKING:
    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import FloatArray, IntArray


def empty_scans(stamps_ns: IntArray) -> Scans:
    """Return scans at given times [ns], shape (n,), numbered from 0, without any reading."""
    return Scans.from_fields(stamps_ns=stamps_ns, numbers=np.arange(len(stamps_ns)))


def readings_at(stack: Stack, rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return the linearised readings [m] at poses (n, 3, 3), (n, 3) [m], shape (n, m); sensors with rows only."""
    return np.concatenate([_readings(sensor, rotations, translations)[0] for sensor in _row_sensors(stack)], axis=1)


def scans_at(
    stack: Stack,
    rotations: FloatArray,
    translations: FloatArray,
    stamps_ns: IntArray,
    *,
    supply_voltages: FloatArray | None = None,
    temperatures: FloatArray | None = None,
    noise: np.random.Generator | None = None,
) -> Scans:
    """Return the raw scans of n poses ``T_R_T``.

    Args:
        stack: The sensors; all must be sensors with rows.
        rotations: R_R_T, shape (n, 3, 3).
        translations: Origin of T in R [m], shape (n, 3).
        stamps_ns: Time of each scan [ns], shape (n,).
        supply_voltages: Of the probe electronics [V], shape (n,); None: at each probe's reference, not measured.
        temperatures: Of the probe electronics [K], shape (n,); None: at each probe's reference, not measured.
        noise: Random generator of the electronics' noise, as large as the calibration says; None: no noise.

    Returns:
        The scans; a reading beyond a sensor's calibrated range is NaN.

    """
    scans = empty_scans(stamps_ns)
    if supply_voltages is not None:
        scans = scans.with_fields({"supply_voltages": supply_voltages})
    if temperatures is not None:
        scans = scans.with_fields({"temperatures": temperatures})
    for sensor in _row_sensors(stack):
        readings, fields = _readings(sensor, rotations, translations)
        scans = scans.with_fields(fields)
        scans = scans.with_fields(sensor.encode(readings, scans))
        if noise is not None:
            scans = scans.with_fields(sensor.disturbed(scans, noise))
    return scans


def _row_sensors(stack: Stack) -> list[RowSensor]:
    return [sensor for sensor in stack.sensors if isinstance(sensor, RowSensor)]


def _readings(
    sensor: RowSensor, rotations: FloatArray, translations: FloatArray
) -> tuple[FloatArray, dict[str, IntArray]]:
    selected, fields = sensor.rows_at(rotations, translations)
    return evaluate_poses(sensor.rows, selected, rotations, translations), fields
