"""The pose of a budget: given in native coordinates, or in the middle of what the sensors can read."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.forward import empty_scans, scans_at
from posor_estimator.core.kernels.rows import GAP, SPOT_X, SPOT_Y, evaluate_row
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.sensors.base import RowSensor
from posor_estimator.core.sensors.bumpy_ring import BumpyRingCalibration
from posor_estimator.core.sensors.diodes import DiodesCalibration
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.types import FloatArray, IntArray

TOLERANCE = (1e-4, 1e-4, 1e-2, 0.1, 0.1, 0.1)
"""How far x, y, z [m] and the turns [rad] freely go from zero in search of the middle of the sensors' ranges."""
SCALE = 1e-4
"""How far a reading may be from the middle of its range as freely [m]."""
STEPS = 20


def pose_of_native(native: Sequence[float]) -> pin.SE3:
    """Return ``T_R_T`` of native coordinates x, y, gap [m], alpha, beta, theta [rad]."""
    return pin.SE3(rotation_from_native(*native[3:6]), np.array(native[:3], dtype=float))


def scan_at(posor: Posor, T_R_T: pin.SE3) -> Scan:
    """Return what a POSOR reads at a pose, without noise.

    Raises:
        ParameterError: A sensor cannot be run forward, or cannot read at this pose.

    """
    for sensor in posor.stack.sensors:
        if not isinstance(sensor, RowSensor):
            raise ParameterError(
                f"{type(sensor).__name__} cannot be run forward",
                where=f"calibration '{posor.calibration.name}'",
                expected="sensors whose model can be run forward (RowSensor)",
            )
    scans = scans_at(posor.stack, T_R_T.rotation[None], T_R_T.translation[None], np.zeros(1, dtype=np.int64))
    scan = scans[0]
    for kind, readings in (
        ("gap probe", scan.gap_voltages),
        ("ring probe", scan.ring_voltages),
        ("diode", scan.diode_currents.sum(axis=1)),
    ):
        unread = np.flatnonzero(~np.isfinite(readings))
        if unread.size:
            raise ParameterError(
                f"{kind} {unread[0] + 1} is out of its calibrated range at this pose",
                where=f"calibration '{posor.calibration.name}'",
                expected="a pose (x, y, gap, alpha, beta, theta) that every sensor can read",
            )
    supply, temperature = _references(posor)
    return replace(scan, supply_voltage=supply, temperature=temperature)


def _references(posor: Posor) -> tuple[float, float]:
    """Return the probes' reference of supply voltage [V] and temperature [K]; NaN where they have not all the same.

    Taken as measured, they make what a reference is uncertain by count in a draw of it as it does in the derivatives.
    """
    probes = [
        probe
        for sensor in posor.calibration.sensors
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration)
        for probe in sensor.probes
    ]
    supplies = {probe.supply.reference.number for probe in probes if probe.supply is not None}
    temperatures = {probe.temperature.reference.number for probe in probes if probe.temperature is not None}
    return _only(supplies), _only(temperatures)


def _only(levels: set[float]) -> float:
    return next(iter(levels)) if len(levels) == 1 else math.nan


def middle_pose(posor: Posor) -> pin.SE3:
    """Return the pose, near zero, at which gap probes and diodes read the middle of their calibrated ranges.

    Rings say nothing of it: theta and the runouts stay near zero.
    """
    values = posor.stack.linearise(_middle_scans(posor))[1].values[0]
    pose = pin.SE3.Identity()
    prior = np.diag(1.0 / np.square(TOLERANCE))
    jacobian = np.empty((posor.stack.readings, 6))
    for _ in range(STEPS):
        rotation, translation = pose.rotation.copy(), pose.translation.copy()
        chosen = _rows_at(posor, pose)
        kinds, rows = posor.stack.pool.kinds[chosen], posor.stack.pool.rows[chosen]
        residuals = np.array(
            [
                value - evaluate_row(kind, row, rotation, translation, np.zeros(6), derivative)
                for kind, row, value, derivative in zip(kinds, rows, values, jacobian, strict=True)
            ]
        )
        weights = np.isin(kinds, (GAP, SPOT_X, SPOT_Y)) / SCALE**2
        away = np.concatenate([translation, pin.log3(rotation)])
        normal = jacobian.T @ (weights[:, None] * jacobian) + prior
        step = np.linalg.solve(normal, jacobian.T @ (weights * residuals) - prior @ away)
        pose = pin.SE3(rotation @ pin.exp3(step[3:]), translation + rotation @ step[:3])
    return pose


def _rows_at(posor: Posor, pose: pin.SE3) -> IntArray:
    """Return which rows of the stack's pool are read at a pose, shape (m,)."""
    scans = scans_at(posor.stack, pose.rotation[None], pose.translation[None], np.zeros(1, dtype=np.int64))
    chosen: IntArray = posor.stack.linearise(scans)[1].chosen[0]
    return chosen


def _middle_scans(posor: Posor) -> Scans:
    """Return one scan with every reading in the middle of its calibrated range."""
    fields: dict[str, FloatArray] = {}
    for sensor in posor.calibration.sensors:
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            name = "gap_voltages" if isinstance(sensor, GapProbesCalibration) else "ring_voltages"
            fields[name] = np.array([[p.range.array.mean() - p.zero_shift.number for p in sensor.probes]])
        elif isinstance(sensor, DiodesCalibration):
            ratios = np.array([spot_map.domain.array.mean(axis=1) for spot_map in sensor.maps[sensor.map]])
            sums = np.array([2.0 * diode.sums[0] for diode in sensor.diodes])[:, None]
            fields["diode_currents"] = 0.5 * np.hstack([sums * (1.0 + ratios), sums * (1.0 - ratios)])[None]
            fields["lit_sources"] = np.zeros((1, len(sensor.diodes)))
    scans = empty_scans(np.zeros(1, dtype=np.int64)).with_fields(fields)
    return scans.with_fields({"lit_sources": scans.lit_sources.astype(np.int64)})
