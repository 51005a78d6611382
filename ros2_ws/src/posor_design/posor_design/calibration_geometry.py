"""Geometry of calibration measurements: axes of diodes, angles of light sources, distances between probes.

Each calculator gives the effect of its errors as the thesis does, by the difference of equation 5.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_design.checks import require_finite, require_non_negative, require_positive, require_small_angle

if TYPE_CHECKING:
    from posor_design.units import Metre, Radian


@dataclass(frozen=True)
class AxisOffsets:
    """Offsets of the axes of one diode against those of another.

    Attributes:
        x: Offset along X of the first diode.
        y: Offset along Y of the first diode.
        x_uncertainty: Standard uncertainty of x.
        y_uncertainty: Standard uncertainty of y.

    """

    x: Metre
    y: Metre
    x_uncertainty: Metre
    y_uncertainty: Metre


def axis_offsets(
    distance: Metre,
    angle: Radian,
    angle_uncertainty: Radian,
    x_repeatability: Metre = 0.0,
    y_repeatability: Metre = 0.0,
    x_difference: Metre = 0.0,
    y_difference: Metre = 0.0,
) -> AxisOffsets:
    """Offsets of the axes of two diodes, from a light that moves a known distance from one to the other.

    Args:
        distance: Distance that the light moves.
        angle: Direction of the motion, from the X axis of the first diode.
        angle_uncertainty: Standard uncertainty of the direction.
        x_repeatability: Standard deviation of the offset along X over several runs.
        y_repeatability: Standard deviation of the offset along Y.
        x_difference: Reading along X on the second diode less reading on the first.
        y_difference: Reading along Y on the second diode less reading on the first.

    Raises:
        ParameterError: An argument is not finite, or a distance or uncertainty is negative.

    Source: thesis 7.4.4, equations 7.3 and 7.4.

    Example:
        posor design axis-offsets --distance '3 in' --angle '89.503239 deg' --angle-uncertainty '.029424 deg'

    """
    require_non_negative(distance=distance, angle_uncertainty=angle_uncertainty)
    require_non_negative(x_repeatability=x_repeatability, y_repeatability=y_repeatability)
    require_finite(angle=angle, x_difference=x_difference, y_difference=y_difference)
    turned = angle + angle_uncertainty
    return AxisOffsets(
        x=distance * math.cos(angle) + x_difference,
        y=distance * math.sin(angle) + y_difference,
        x_uncertainty=math.hypot(distance * (math.cos(turned) - math.cos(angle)), x_repeatability),
        y_uncertainty=math.hypot(distance * (math.sin(turned) - math.sin(angle)), y_repeatability),
    )


@dataclass(frozen=True)
class LightSourceAngles:
    """Inclination of a light source about two axes.

    Attributes:
        alpha: Angle that moves the spot along X as the distance grows.
        beta: Angle that moves it along Y.
        alpha_uncertainty: Standard uncertainty of alpha.
        beta_uncertainty: Standard uncertainty of beta.

    """

    alpha: Radian
    beta: Radian
    alpha_uncertainty: Radian
    beta_uncertainty: Radian


def light_source_angles(
    azimuth: Radian, inclination: Radian, azimuth_uncertainty: Radian = 0.0, inclination_uncertainty: Radian = 0.0
) -> LightSourceAngles:
    """Inclination of a light source about two axes, from its direction in polar angles.

    Args:
        azimuth: Angle phi of the direction in which the spot moves as the distance grows.
        inclination: Angle psi between the light and the normal of the plate.
        azimuth_uncertainty: Standard uncertainty of the azimuth.
        inclination_uncertainty: Standard uncertainty of the inclination.

    Raises:
        ParameterError: An argument is not finite, an uncertainty is negative, or the inclination exceeds 0.2 rad.

    Source: thesis 7.4.5, equations 7.7 to 7.10, and table 7.8.

    Example:
        posor design light-source-angles --azimuth='-.746148 rad' --inclination '3.996 mrad'
        --azimuth-uncertainty '.0908 rad' --inclination-uncertainty '.638 mrad'

    """
    require_small_angle(inclination=inclination)
    require_finite(azimuth=azimuth)
    require_non_negative(azimuth_uncertainty=azimuth_uncertainty, inclination_uncertainty=inclination_uncertainty)
    sine, cosine = math.sin(azimuth), math.cos(azimuth)
    turned = azimuth + azimuth_uncertainty
    return LightSourceAngles(
        alpha=inclination * sine,
        beta=-inclination * cosine,
        alpha_uncertainty=math.hypot(inclination_uncertainty * sine, inclination * (math.sin(turned) - sine)),
        beta_uncertainty=math.hypot(inclination_uncertainty * cosine, inclination * (math.cos(turned) - cosine)),
    )


@dataclass(frozen=True)
class ProbeSpacing:
    """Distance between two probes.

    Attributes:
        spacing: Distance between the probes, along the slope of the target.
        spacing_error: Its change by the error of the angle.
        gap_error: Error of a gap because the target also turns about the other axis.

    """

    spacing: Metre
    spacing_error: Metre
    gap_error: Metre


def probe_spacing(
    gap_difference: Metre, angle: Radian, angle_error: Radian = 0.0, cross_angle: Radian = 0.0, span: Metre = 0.0
) -> ProbeSpacing:
    """Distance between two probes from a known tilt of the target.

    Args:
        gap_difference: Change of the difference of the two gaps by the tilt.
        angle: Tilt of the target.
        angle_error: Error of the tilt.
        cross_angle: Angle by which the axis of the tilt fails to be square to the line through the probes.
        span: Distance of the probes along this axis.

    Raises:
        ParameterError: An argument is not finite or out of range, or the angle is zero with or without its error.

    Source: thesis 7.5.2, equations 7.11 and 7.12.

    Example:
        posor design probe-spacing --gap-difference '.05 in' --angle '16.667 mrad' --angle-error '100 urad'

    """
    require_finite(gap_difference=gap_difference)
    require_small_angle(angle=angle, angle_error=angle_error, cross_angle=cross_angle)
    require_positive(size_of_the_angle=abs(angle), size_of_the_angle_with_its_error=abs(angle + angle_error))
    require_non_negative(span=span)
    spacing = gap_difference / math.tan(angle)
    return ProbeSpacing(
        spacing=spacing,
        spacing_error=gap_difference / math.tan(angle + angle_error) - spacing,
        gap_error=cross_angle * angle * span,
    )
