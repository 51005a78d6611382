"""Gyroscopes and accelerometers as sensors of an arm: drift between two resets, and phase of a fibre gyroscope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from scipy.constants import speed_of_light

from posor_design.calculators import calculator

if TYPE_CHECKING:
    from posor_design.units import (
        POSITIVE,
        Metre,
        MetrePerSecondSquared,
        Radian,
        RadianPerSecond,
        Second,
        SquareMetre,
    )


@dataclass(frozen=True)
class InertialLimits:
    """Largest errors of inertial sensors for an accuracy at the end of an arm."""

    drift_rate: Annotated[RadianPerSecond, "Drift rate of a gyroscope."]
    acceleration: Annotated[
        MetrePerSecondSquared,
        "Error of an accelerometer: its bias, or the smallest acceleration that it has to detect.",
    ]


@calculator
def inertial_limits(
    accuracy: Annotated[Metre, POSITIVE, "Largest error at the end of the arm before a reset."],
    reach: Annotated[Metre, POSITIVE, "Distance from the gyroscope to the end of the arm."],
    reset_time: Annotated[Second, POSITIVE, "Time between two resets."],
) -> InertialLimits:
    """Drift that gyroscope and accelerometer may have if their position is reset from time to time.

    Source: thesis 1.4, equation 1.3.

    Example:
        posor design inertial-limits --accuracy '1 mil' --reach '100 in' --reset-time '30 min'

    """
    return InertialLimits(accuracy / reach / reset_time, 2.0 * accuracy / reset_time**2)


@dataclass(frozen=True)
class InertialDrift:
    """Errors at the end of an arm just before a reset."""

    angle: Annotated[Radian, "Angle error of the gyroscope."]
    gyroscope_error: Annotated[Metre, "This angle at the end of the arm."]
    accelerometer_error: Annotated[Metre, "Error of the position by the accelerometer."]


@calculator
def inertial_drift(
    drift_rate: Annotated[RadianPerSecond, "Drift of the gyroscope."],
    acceleration: Annotated[MetrePerSecondSquared, "Bias of the accelerometer."],
    reach: Annotated[Metre, POSITIVE, "Distance from the gyroscope to the end of the arm."],
    reset_time: Annotated[Second, POSITIVE, "Time between two resets."],
) -> InertialDrift:
    """Error at the end of an arm by the drift of a gyroscope and the bias of an accelerometer.

    Source: thesis 1.4, equation 1.3.

    Example:
        posor design inertial-drift --drift-rate '.0003 deg/h' --acceleration '6e-11 m/s^2' --reach '100 in'
        --reset-time '30 min'

    """
    angle = drift_rate * reset_time
    return InertialDrift(angle, angle * reach, 0.5 * acceleration * reset_time**2)


@dataclass(frozen=True)
class FibreGyroscope:
    """Signal of a fibre gyroscope."""

    phase: Annotated[Radian, "Phase between the two beams."]


@calculator
def fibre_gyroscope(
    area: Annotated[SquareMetre, POSITIVE, "Total area that the coil encloses: number of turns times area of a turn."],
    rate: Annotated[RadianPerSecond, "Rotation rate about the axis of the coil."],
    wavelength: Annotated[Metre, POSITIVE, "Wavelength in vacuum."],
) -> FibreGyroscope:
    """Phase between the two beams of a fibre gyroscope (Sagnac effect).

    Source: thesis 1.4, equation 1.2.

    Example:
        posor design fibre-gyroscope --area '10 m^2' --rate '15 deg/h' --wavelength '830 nm'

    """
    return FibreGyroscope(8.0 * math.pi * area * rate / (wavelength * speed_of_light))
