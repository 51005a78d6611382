"""Gyroscopes and accelerometers as sensors of an arm: drift between two resets, and phase of a fibre gyroscope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scipy.constants import speed_of_light

from posor_design.checks import require_finite, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
        Metre,
        MetrePerSecondSquared,
        Radian,
        RadianPerSecond,
        Second,
        SquareMetre,
    )


@dataclass(frozen=True)
class InertialLimits:
    """Largest errors of inertial sensors for an accuracy at the end of an arm.

    Attributes:
        drift_rate: Drift rate of a gyroscope.
        acceleration: Error of an accelerometer: its bias, or the smallest acceleration that it has to detect.

    """

    drift_rate: RadianPerSecond
    acceleration: MetrePerSecondSquared


def inertial_limits(accuracy: Metre, reach: Metre, reset_time: Second) -> InertialLimits:
    """Drift that gyroscope and accelerometer may have if their position is reset from time to time.

    Args:
        accuracy: Largest error at the end of the arm before a reset.
        reach: Distance from the gyroscope to the end of the arm.
        reset_time: Time between two resets.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 1.4, equation 1.3.

    Example:
        posor design inertial-limits --accuracy '1 mil' --reach '100 in' --reset-time '30 min'

    """
    require_positive(accuracy=accuracy, reach=reach, reset_time=reset_time)
    return InertialLimits(accuracy / reach / reset_time, 2.0 * accuracy / reset_time**2)


@dataclass(frozen=True)
class InertialDrift:
    """Errors at the end of an arm just before a reset.

    Attributes:
        angle: Angle error of the gyroscope.
        gyroscope_error: This angle at the end of the arm.
        accelerometer_error: Error of the position by the accelerometer.

    """

    angle: Radian
    gyroscope_error: Metre
    accelerometer_error: Metre


def inertial_drift(
    drift_rate: RadianPerSecond, acceleration: MetrePerSecondSquared, reach: Metre, reset_time: Second
) -> InertialDrift:
    """Error at the end of an arm by the drift of a gyroscope and the bias of an accelerometer.

    Args:
        drift_rate: Drift of the gyroscope.
        acceleration: Bias of the accelerometer.
        reach: Distance from the gyroscope to the end of the arm.
        reset_time: Time between two resets.

    Raises:
        ParameterError: An argument is not finite, or reach or time are not positive.

    Source: thesis 1.4, equation 1.3.

    Example:
        posor design inertial-drift --drift-rate '.0003 deg/h' --acceleration '6e-11 m/s^2' --reach '100 in'
        --reset-time '30 min'

    """
    require_finite(drift_rate=drift_rate, acceleration=acceleration)
    require_positive(reach=reach, reset_time=reset_time)
    angle = drift_rate * reset_time
    return InertialDrift(angle, angle * reach, 0.5 * acceleration * reset_time**2)


@dataclass(frozen=True)
class FibreGyroscope:
    """Signal of a fibre gyroscope.

    Attributes:
        phase: Phase between the two beams.

    """

    phase: Radian


def fibre_gyroscope(area: SquareMetre, rate: RadianPerSecond, wavelength: Metre) -> FibreGyroscope:
    """Phase between the two beams of a fibre gyroscope (Sagnac effect).

    Args:
        area: Total area that the coil encloses: number of turns times area of a turn.
        rate: Rotation rate about the axis of the coil.
        wavelength: Wavelength in vacuum.

    Raises:
        ParameterError: An argument is not finite, or area or wavelength are not positive.

    Source: thesis 1.4, equation 1.2.

    Example:
        posor design fibre-gyroscope --area '10 m^2' --rate '15 deg/h' --wavelength '830 nm'

    """
    require_finite(rate=rate)
    require_positive(area=area, wavelength=wavelength)
    return FibreGyroscope(8.0 * math.pi * area * rate / (wavelength * speed_of_light))
