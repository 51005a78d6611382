# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the tests and of the tracker, and what scans need beside the sensors, from a calibration."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.calibration.calibration_file import Environment, TiltAngle
from posor.calibration.causes import EXCEEDED
from posor.estimation.fault_effects import MISSED_DETECTION
from posor.estimation.frozen import evidence_of_repetition
from posor.model.readings import DIODE_CURRENTS, PYTHON
from posor.numerics.chi_square import noncentrality, upper_quantile
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.estimation.workspace import Model

_MOTION_LIMITS = (  # settings of the largest velocities and accelerations, in the order of the calibration file
    ("max_velocity", "max_lean_rate", "max_theta_rate"),
    ("max_acceleration", "max_lean_acceleration", "max_theta_acceleration"),
)


def residual_limit(redundancy: int, false_alarm: float) -> float:
    """Return the largest chi-square that the test of the redundant readings accepts.

    ``redundancy``: number of these readings, at least 1; ``false_alarm``: see ``Posor``; above 0.
    """
    return upper_quantile(redundancy, EXCEEDED * false_alarm)


def write_settings(model: Model, calibration: Calibration, redundancy: int, false_alarm: float) -> None:
    """Write what a calibration states into the workspace of a new model.

    ``redundancy``: number of redundant readings; ``false_alarm``: as of ``Posor``.
    """
    settings = model.workspace[0]["settings"]
    settings["residual_limit"] = settings["noncentrality_root"] = math.inf
    if redundancy > 0 and false_alarm > 0.0:
        settings["residual_limit"] = largest = residual_limit(redundancy, false_alarm)
        settings["noncentrality_root"] = math.sqrt(noncentrality(redundancy, largest, MISSED_DETECTION))
    _write_motion(settings, calibration)
    _write_environment(model, settings, calibration)
    _write_evidence(model, settings, calibration)
    _write_common_effects(model, settings, calibration)
    settings["tilt_lags"] = calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN


def _write_motion(settings: Any, calibration: Calibration) -> None:
    """Write the limits of motion and travel, infinite where none is stated, and with which period theta repeats."""
    motion = calibration.motion
    acceleration = None if motion is None else motion.acceleration
    velocities, accelerations = _MOTION_LIMITS
    for names, limits in ((velocities, motion), (accelerations, acceleration)):
        for name, key in zip(names, ("translation", "lean", "theta"), strict=True):
            settings[name] = math.inf if limits is None else getattr(limits, key).number
    travel = None if motion is None else motion.travel
    settings["travel_gap"] = (-math.inf, math.inf) if travel is None else travel.gap.array
    settings["travel_lean"] = math.inf if travel is None else travel.lean.number
    for sensor in calibration.sensors:
        if sensor.bump_angle > 0.0 and settings["bump_angle"] == 0.0:
            settings["bump_angle"], settings["home_theta"] = sensor.bump_angle, sensor.home_theta
    settings["period"] = settings["bump_angle"] or max(sensor.slip_angle for sensor in calibration.sensors)


def _write_environment(model: Model, settings: Any, calibration: Calibration) -> None:
    stated, plausible = calibration.environment or Environment(), calibration.plausible_environment()
    for k, part in enumerate((stated.supply, stated.temperature)):
        settings["environment"][k] = (plausible[k].least, plausible[k].most) if part is None else part.range.array
        settings["spreads"][k] = 0.0 if part is None else part.spread.number
    workspace, channels = model.workspace[0], model.channels
    for sensor in model.sensors:
        if sensor["source"] not in {DIODE_CURRENTS, PYTHON}:
            reading, channel, count = (int(sensor[name]) for name in ("first_reading", "first_channel", "count"))
            for k, name in enumerate(("supply_sensitivity", "temperature_sensitivity")):
                workspace["sensitivities"][reading : reading + count, k] = channels[name][channel : channel + count]


def _write_evidence(model: Model, settings: Any, calibration: Calibration) -> None:
    """Write the evidence of each reading's repetition (``estimation.frozen``); none without the converter's steps."""
    converter, workspace = calibration.converter, model.workspace[0]
    if converter is None:
        return
    for sensor in model.sensors:
        first, channel = int(sensor["first_reading"]), int(sensor["first_channel"])
        for i in range(int(sensor["count"])):
            if sensor["source"] == DIODE_CURRENTS:
                diode = model.diodes[channel + i]
                for axis, noise in enumerate(0.5 * diode["least_sum"] * diode["noise"]):
                    evidence = evidence_of_repetition(converter.current.number, float(noise))
                    workspace["evidence"][first + 2 * i + axis] = evidence
            elif sensor["source"] != PYTHON:
                noise = float(model.channels[channel + i]["noise"])
                workspace["evidence"][first + i] = evidence_of_repetition(converter.voltage.number, noise)
    settings["all_evidence"] = workspace["evidence"].sum()


def _write_common_effects(model: Model, settings: Any, calibration: Calibration) -> None:
    """Write what dark scans and the reference voltage need; none without them in the calibration."""
    workspace = model.workspace[0]
    for sensor in calibration.sensors:
        if isinstance(sensor, DiodesCalibration) and sensor.ambient is not None:
            ambient = sensor.ambient
            settings["dark_age"], settings["dark_noise"] = ambient.max_age.number, ambient.noise.number
            settings["dark_drift"] = ambient.drift.number
            settings["source_light"] = 0.0 if ambient.source_light is None else ambient.source_light.number
        elif isinstance(sensor, GapProbesCalibration) and sensor.reference is not None:
            reference = sensor.reference
            settings["reference_voltage"] = reference.voltage.number
            settings["reference_sigma"] = reference.relative_sigma
            settings["gain_spread"], settings["gain_limit"] = reference.spread.number, reference.limit.number
    workspace["has_common_effects"] = settings["dark_age"] > 0.0 or settings["reference_voltage"] > 0.0
    partners = workspace["spot_partners"]
    partners[:] = np.arange(len(partners))
    for sensor in model.sensors:
        if sensor["source"] == DIODE_CURRENTS:
            first, end = int(sensor["first_reading"]), int(sensor["first_reading"] + 2 * sensor["count"])
            partners[first:end] = partners[first:end].reshape(-1, 2)[:, ::-1].ravel()
