# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gyroscopes and accelerometers as sensors of an arm: drift between two resets, and phase of a fibre gyroscope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from scipy.constants import speed_of_light

from posor_design.calculators import POSITIVE, calculator


@dataclass(frozen=True)
class InertialLimits:
    """Largest errors of inertial sensors for an accuracy at the end of an arm."""

    drift_rate: Annotated[float, "rad/s", "Drift rate of a gyroscope."]
    acceleration: Annotated[float, "m/s^2", "Error of an accelerometer: bias, or smallest acceleration to detect."]


@calculator
def inertial_limits(
    accuracy: Annotated[float, "m", POSITIVE, "Largest error at the end of the arm before a reset."],
    reach: Annotated[float, "m", POSITIVE, "Distance from the gyroscope to the end of the arm."],
    reset_time: Annotated[float, "s", POSITIVE, "Time between two resets."],
) -> InertialLimits:
    """Drift that gyroscope and accelerometer may have if their position is reset from time to time.

    Source: thesis 1.4, equation 1.3.
    """
    return InertialLimits(accuracy / reach / reset_time, 2.0 * accuracy / reset_time**2)


@dataclass(frozen=True)
class InertialDrift:
    """Errors at the end of an arm just before a reset."""

    angle: Annotated[float, "rad", "Angle error of the gyroscope."]
    gyroscope_error: Annotated[float, "m", "This angle at the end of the arm."]
    accelerometer_error: Annotated[float, "m", "Error of the position by the accelerometer."]


@calculator
def inertial_drift(
    drift_rate: Annotated[float, "rad/s", "Drift of the gyroscope."],
    acceleration: Annotated[float, "m/s^2", "Bias of the accelerometer."],
    reach: Annotated[float, "m", POSITIVE, "Distance from the gyroscope to the end of the arm."],
    reset_time: Annotated[float, "s", POSITIVE, "Time between two resets."],
) -> InertialDrift:
    """Error at the end of an arm by the drift of a gyroscope and the bias of an accelerometer.

    Source: thesis 1.4, equation 1.3.
    """
    angle = drift_rate * reset_time
    return InertialDrift(angle, angle * reach, 0.5 * acceleration * reset_time**2)


@dataclass(frozen=True)
class FibreGyroscope:
    """Signal of a fibre gyroscope."""

    phase: Annotated[float, "rad", "Phase between the two beams."]


@calculator
def fibre_gyroscope(
    area: Annotated[float, "m^2", POSITIVE, "Total area that the coil encloses: number of turns times area of a turn."],
    rate: Annotated[float, "rad/s", "Rotation rate about the axis of the coil."],
    wavelength: Annotated[float, "m", POSITIVE, "Wavelength in vacuum."],
) -> FibreGyroscope:
    """Phase between the two beams of a fibre gyroscope (Sagnac effect).

    Source: thesis 1.4, equation 1.2.
    """
    return FibreGyroscope(8.0 * math.pi * area * rate / (wavelength * speed_of_light))
