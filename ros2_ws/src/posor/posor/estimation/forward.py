# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The model run forward: the raw readings of a POSOR's sensors at given poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from posor.calibration.calibration_file import Calibration
from posor.errors import ParameterError, ShapeError, check_type
from posor.estimation.sensor_stack import Stack
from posor.model.reading_rows import evaluate_poses
from posor.model.scan import Scans
from posor.numerics.array_types import array_of_caller, refuse_masked
from posor.numerics.stamps import NS
from posor.sensors.base import RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin
    from numpy.typing import ArrayLike

    from posor.numerics.array_types import FloatArray, IntArray

_POSE = 7
_UNIT_TOLERANCE = 1e-6  # largest deviation of a quaternion's length from one


def simulate(
    calibration: Calibration,
    poses: ArrayLike | Sequence[pin.SE3],
    *,
    stamps_ns: ArrayLike | None = None,
    rate: float = 1000.0,
    seed: int | None = None,
    supply_voltages: ArrayLike | None = None,
    temperatures: ArrayLike | None = None,
) -> Scans:
    """Return the raw scans that a POSOR would read at given poses: the forward model.

    The scans are numbered from 0. No home mark is seen: set ``at_home`` by ``Scans.with_fields`` to count a bumpy ring.

    Args:
        calibration: Of the POSOR, with its session already applied.
        poses: ``T_R_T`` as x, y, z [m] and the unit quaternion x, y, z, w, shape (n, 7), or n ``pinocchio.SE3``.
        stamps_ns: Time of each scan [ns], shape (n,); None: ``rate`` decides, the first scan is one period after zero.
        rate: Scans for each second [1/s], where stamps are not given.
        seed: Of the electronics' noise, as large as the calibration states; None: no noise.
        supply_voltages: Of the probe electronics [V], shape (n,) or one number; None: each probe's reference, not
            measured.
        temperatures: Of the receiving plate [K], shape (n,) or one number; None: each probe's reference, not measured.

    Returns:
        The scans; a reading of a pose beyond a sensor's calibrated range is NaN.

    Raises:
        ParameterError: An argument has the wrong type, is not finite, or a sensor has no forward model.
        ShapeError: An array has the wrong shape.

    """
    check_type(calibration, Calibration, "simulate")
    stack = Stack([sensor.build() for sensor in calibration.sensors])
    for sensor, part in zip(stack.sensors, calibration.sensors, strict=True):
        if not isinstance(sensor, RowSensor):
            what = f"sensor {type(part).__name__} has no forward model"
            raise ParameterError(what, where="simulate", expected="sensors with rows")
    rotations, translations = _poses_of(poses)
    count = len(rotations)
    if stamps_ns is None:
        frequency = _values("rate", rate, 1)
        if frequency.shape != (1,) or frequency[0] <= 0.0:
            expected = "one number of scans for each second, above zero"
            raise ParameterError(f"rate {rate!r}", where="simulate", expected=expected)
        stamps = (np.arange(1, count + 1) * (NS / float(frequency[0]))).astype(np.int64)
    else:
        stamps = _stamps_of(stamps_ns, count)
    try:
        noise = None if seed is None else np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise ParameterError(f"seed {seed!r}", where="simulate", expected="an integer of zero or more") from None
    return scans_at(
        stack,
        rotations,
        translations,
        stamps,
        supply_voltages=None if supply_voltages is None else _values("supply_voltages", supply_voltages, count),
        temperatures=None if temperatures is None else _values("temperatures", temperatures, count),
        noise=noise,
    )


def _poses_of(poses: ArrayLike | Sequence[pin.SE3]) -> tuple[FloatArray, FloatArray]:
    """Return rotations (n, 3, 3) and translations (n, 3) of the argument of ``simulate``."""
    entries = list(poses) if isinstance(poses, list | tuple) else []
    if entries and all(hasattr(entry, "homogeneous") for entry in entries):
        matrices = np.array([entry.homogeneous for entry in entries])
        return matrices[:, :3, :3].copy(), matrices[:, :3, 3].copy()
    numbers = _values("poses", poses, None)
    if numbers.ndim != 2 or numbers.shape[1] != _POSE:  # noqa: PLR2004  scans, numbers
        raise ShapeError("poses", received=numbers.shape, expected=f"(n, {_POSE})", where="simulate")
    lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    bad = np.flatnonzero(np.abs(lengths - 1.0) > _UNIT_TOLERANCE)
    if bad.size:
        what = f"the quaternion of pose {bad[0]} has the length {lengths[bad[0]]:.9g}"
        raise ParameterError(what, where="simulate", expected="a unit quaternion x, y, z, w")
    return Rotation.from_quat(numbers[:, 3:]).as_matrix(), numbers[:, :3].copy()


def _stamps_of(stamps_ns: ArrayLike, count: int) -> IntArray:
    stamps = array_of_caller(stamps_ns, "stamps_ns", "simulate", whole=True)
    if stamps.shape != (count,):
        raise ShapeError("stamps_ns", received=stamps.shape, expected=f"({count},)", where="simulate")
    return stamps


def _values(name: str, given: ArrayLike | Sequence[pin.SE3], count: int | None) -> FloatArray:
    """Return finite numbers; ``count``: of scans, for which one number may stand."""
    refuse_masked(given, name, "simulate")
    try:
        numbers = np.array(given, dtype=float)
    except (TypeError, ValueError):
        what = f"{name} cannot be converted to an array of numbers"
        raise ParameterError(
            what, where="simulate", expected="numbers" if count is not None else "(n, 7) or pinocchio.SE3"
        ) from None
    if not np.isfinite(numbers).all():
        raise ParameterError(f"a value of {name} is not finite", where="simulate", expected="finite numbers")
    return numbers if count is None or numbers.ndim else np.full(count, float(numbers))


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

    ``stack``: the sensors; all must be sensors with rows; ``rotations``: R_R_T, shape (n, 3, 3); ``translations``:
    origin of T in R [m], shape (n, 3); ``stamps_ns``: time of each scan [ns], shape (n,); ``supply_voltages``: of the
    probe electronics [V], shape (n,); None: at each probe's reference, not measured; ``temperatures``: of the probe
    electronics [K], shape (n,); None: at each probe's reference, not measured; ``noise``: random generator of the
    electronics' noise, as large as the calibration says; None: no noise. Return the scans; a reading beyond a sensor's
    calibrated range is NaN.
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
