# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of a budget, and the covariances of the sensor models there.

A pose comes from native coordinates, or has all sensors in the middle of their ranges.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from posor.calibration.shared_terms import check_same_terms
from posor.errors import ChainError, ParameterError
from posor.estimation.forward import empty_scans, scans_at
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.reading_rows import GAP, SPOT_X, SPOT_Y
from posor.sensors.base import RowSensor
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.estimation.estimate import Estimates
    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray, IntArray

POSE_TOLERANCE = (1e-4, 1e-4, 1e-2, 0.1, 0.1, 0.1)
"""Weight of x, y, z [m] and rotations [rad] near zero in the search for the middle of the ranges, as sigmas."""
READING_TOLERANCE = 1e-4  # weight of a reading at the middle of its range [m], as sigma
STEPS = 20


def pose_from_native(native: Sequence[float]) -> pin.SE3:
    """Return ``T_R_T`` of native coordinates x, y, gap [m], alpha, beta, theta [rad]."""
    return pin.SE3(rotation_from_native(*native[3:6]), np.array(native[:3], dtype=float))


def scan_at(posor: Posor, T_R_T: pin.SE3) -> Scan:
    """Return the readings of a POSOR at a pose, without noise.

    Raises ParameterError: a sensor has no forward model, or is out of range at this pose.
    """
    require_forward_model(posor)
    scans = scans_at(posor.stack, T_R_T.rotation[None], T_R_T.translation[None], np.zeros(1, dtype=np.int64))
    scan = scans[0]
    for kind, readings in (
        ("gap probe", scan.gap_voltages),
        ("ring probe", scan.ring_voltages),
        ("diode", scan.diode_currents.sum(axis=1)),
    ):
        out_of_range = np.flatnonzero(~np.isfinite(readings))
        if out_of_range.size:
            what = f"{kind} {out_of_range[0] + 1} is out of its calibrated range at this pose"
            expected = "a pose (x, y, gap, alpha, beta, theta) in the range of every sensor"
            raise ParameterError(what, where=f"calibration '{posor.calibration.name}'", expected=expected)
    supply, temperature = _references(posor)
    return replace(scan, supply_voltage=supply, temperature=temperature)


def require_forward_model(posor: Posor) -> None:
    """Raise ParameterError if a sensor has no forward model, such as one in plain Python."""
    for sensor in posor.stack.sensors:
        if not isinstance(sensor, RowSensor):
            what = f"{type(sensor).__name__} has no forward model"
            expected = "sensors with a forward model (RowSensor)"
            raise ParameterError(what, where=f"calibration '{posor.calibration.name}'", expected=expected)


def _references(posor: Posor) -> tuple[float, float]:
    """Return the mean reference of the probes' supply voltage [V] and temperature [K]; NaN where no probe has one.

    With these as measured values, the uncertainty of a reference acts on a draw as on the derivatives.
    """
    probes = [
        probe
        for sensor in posor.calibration.sensors
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration)
        for probe in sensor.probes
    ]
    supplies = [probe.supply.reference.number for probe in probes if probe.supply is not None]
    temperatures = [probe.temperature.reference.number for probe in probes if probe.temperature is not None]
    return _mean(supplies), _mean(temperatures)


def _mean(levels: Sequence[float]) -> float:
    return sum(levels) / len(levels) if levels else math.nan


def middle_pose(posor: Posor) -> pin.SE3:
    """Return the pose near zero at which gap probes and diodes are in the middle of their calibrated ranges.

    Rings are ignored: theta and the runouts stay near zero.
    """
    values = posor.stack.linearise(_middle_scans(posor)).values[0]
    pose = pin.SE3.Identity()
    prior = np.diag(1.0 / np.square(POSE_TOLERANCE))
    for _ in range(STEPS):
        rotation, translation = pose.rotation.copy(), pose.translation.copy()
        selected = _selected_rows(posor, pose)
        predicted, jacobian = posor.stack.evaluate(selected, rotation, translation)
        residuals = values - predicted
        weights = np.isin(posor.stack.reading_rows["kind"][selected], (GAP, SPOT_X, SPOT_Y)) / READING_TOLERANCE**2
        offset = np.concatenate([translation, pin.log3(rotation)])
        normal = jacobian.T @ (weights[:, None] * jacobian) + prior
        step = np.linalg.solve(normal, jacobian.T @ (weights * residuals) - prior @ offset)
        pose = pin.SE3(rotation @ pin.exp3(step[3:]), translation + rotation @ step[:3])
    return pose


def _selected_rows(posor: Posor, pose: pin.SE3) -> IntArray:
    """Return the indices of the stack's rows that are active at a pose, shape (m,)."""
    scans = scans_at(posor.stack, pose.rotation[None], pose.translation[None], np.zeros(1, dtype=np.int64))
    selected: IntArray = posor.stack.linearise(scans).selected[0]
    return selected


def _middle_scans(posor: Posor) -> Scans:
    """Return one scan with every reading in the middle of its calibrated range."""
    fields: dict[str, FloatArray | IntArray] = {}
    for sensor in posor.calibration.sensors:
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            name = "gap_voltages" if isinstance(sensor, GapProbesCalibration) else "ring_voltages"
            fields[name] = np.array([[p.range.array.mean() - p.zero_shift.number for p in sensor.probes]])
        elif isinstance(sensor, DiodesCalibration):
            ratios = np.array([spot_map.domain.array.mean(axis=1) for spot_map in sensor.maps[sensor.map]])
            sums = np.array([2.0 * diode.sums[0] for diode in sensor.diodes])[:, None]
            fields["diode_currents"] = 0.5 * np.hstack([sums * (1.0 + ratios), sums * (1.0 - ratios)])[None]
            fields["lit_sources"] = np.zeros((1, len(sensor.diodes)), dtype=np.int64)
    return empty_scans(np.zeros(1, dtype=np.int64)).with_fields(fields)


class ModelCovariances(NamedTuple):
    """Covariances of the POSORs' sensor models, by joint, ROS order."""

    random: dict[str, FloatArray]  # noise, (6, 6)
    systematic: dict[str, FloatArray]  # calibration, with shared terms, (6, 6)
    shared: dict[str, dict[str, FloatArray]]  # effect of each shared term, by name, (6,)

    def own(self) -> dict[str, FloatArray]:
        """Return the sums of both covariances of each joint without shared terms."""
        return {
            name: random + self.systematic[name] - sum(np.outer(each, each) for each in self.shared[name].values())
            for name, random in self.random.items()
        }


def model_covariances(
    calibrations: Mapping[str, Calibration], chain: Chain, angles: Mapping[str, float]
) -> ModelCovariances:
    """Return the covariances of the POSORs' sensor models.

    Raises ChainError: a POSOR has no valid pose at its angle; CalibrationError: a shared term has two uncertainties.
    """
    files = {f"calibration of {joint}": calibration.shared for joint, calibration in calibrations.items()}
    check_same_terms({"the beams file": chain.shared, **files})
    random, systematic, shared = {}, {}, {}
    for joint in chain.joints:
        angle = np.array([angles[joint.name]])
        estimates = estimates_at(Posor(calibrations[joint.name]), chain, joint.name, angle)
        require_poses(estimates, joint.name, angle)
        random[joint.name] = estimates.covariances_random[0]
        systematic[joint.name] = estimates.covariances_systematic[0]
        terms = calibrations[joint.name].shared
        shared[joint.name] = dict(zip(terms, estimates.shared_effects[0], strict=False))
    return ModelCovariances(random, systematic, shared)


def estimates_at(posor: Posor, chain: Chain, joint: str, angles: FloatArray) -> Estimates:
    """Return the estimates from the noiseless readings of a joint's POSOR at angles of the joint [rad], (n,).

    Raises ParameterError: a sensor has no forward model.
    """
    require_forward_model(posor)
    poses = [chain.nominal_joint(joint, angle) for angle in angles]
    rotations, translations = (
        np.array([getattr(each, what) for each in poses]) for what in ("rotation", "translation")
    )
    scans = scans_at(posor.stack, rotations, translations, np.zeros(len(poses), dtype=np.int64))
    return posor.estimate_each(scans, angles)


def require_poses(estimates: Estimates, joint: str, angles: FloatArray) -> None:
    """Raise ChainError if a POSOR has no valid pose at one of the angles [rad], (n,), of its joint."""
    lost = np.flatnonzero(estimates.states != State.OK)
    if lost.size:
        n = lost[0]
        found = Fault(int(estimates.faults[n]))
        what = f"has no valid pose at {math.degrees(angles[n]):g} degrees ({found.name or 'no pose'})"
        beyond = "a travel of 'motion' that contains the nominal pose"
        sought = beyond if found & Fault.TRAVEL else "an angle in the range of its sensors"
        raise ChainError(what, where=f"joint '{joint}'", expected=sought)
