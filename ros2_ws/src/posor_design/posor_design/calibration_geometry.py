# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of calibration measurements: axes of diodes, angles of light sources, distances between probes.

Each calculator gives the effect of its errors as the thesis does, by the difference of equation 5.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor.errors import ParameterError

from posor_design.calculators import NON_NEGATIVE, NON_ZERO, SMALL_ANGLE, calculator


@dataclass(frozen=True)
class AxisOffsets:
    """Offsets of the axes of one diode against those of another."""

    x: Annotated[float, "m", "Offset along X of the first diode."]
    y: Annotated[float, "m", "Offset along Y of the first diode."]
    x_uncertainty: Annotated[float, "m", "Standard uncertainty of x."]
    y_uncertainty: Annotated[float, "m", "Standard uncertainty of y."]


@calculator
def axis_offsets(
    distance: Annotated[float, "m", NON_NEGATIVE, "Distance that the light moves."],
    angle: Annotated[float, "rad", "Direction of the motion, from the X axis of the first diode."],
    angle_uncertainty: Annotated[float, "rad", NON_NEGATIVE, "Standard uncertainty of the direction."],
    x_repeatability: Annotated[float, "m", NON_NEGATIVE, "Standard deviation of the X offset over several runs."] = 0.0,
    y_repeatability: Annotated[float, "m", NON_NEGATIVE, "Standard deviation of the offset along Y."] = 0.0,
    x_difference: Annotated[float, "m", "Reading along X on the second diode less reading on the first."] = 0.0,
    y_difference: Annotated[float, "m", "Reading along Y on the second diode less reading on the first."] = 0.0,
) -> AxisOffsets:
    """Offsets of the axes of two diodes, from a light that moves a known distance from one to the other.

    Source: thesis 7.4.4, equations 7.3 and 7.4.
    """
    turned = angle + angle_uncertainty
    return AxisOffsets(
        x=distance * math.cos(angle) + x_difference,
        y=distance * math.sin(angle) + y_difference,
        x_uncertainty=math.hypot(distance * (math.cos(turned) - math.cos(angle)), x_repeatability),
        y_uncertainty=math.hypot(distance * (math.sin(turned) - math.sin(angle)), y_repeatability),
    )


@dataclass(frozen=True)
class LightSourceAngles:
    """Inclination of a light source about two axes."""

    alpha: Annotated[float, "rad", "Angle that moves the spot along X as the distance grows."]
    beta: Annotated[float, "rad", "Angle that moves it along Y."]
    alpha_uncertainty: Annotated[float, "rad", "Standard uncertainty of alpha."]
    beta_uncertainty: Annotated[float, "rad", "Standard uncertainty of beta."]


@calculator
def light_source_angles(
    azimuth: Annotated[float, "rad", "Angle phi of the direction in which the spot moves as the distance grows."],
    inclination: Annotated[float, "rad", SMALL_ANGLE, "Angle psi between the light and the normal of the plate."],
    azimuth_uncertainty: Annotated[float, "rad", NON_NEGATIVE, "Standard uncertainty of the azimuth."] = 0.0,
    inclination_uncertainty: Annotated[float, "rad", NON_NEGATIVE, "Standard uncertainty of the inclination."] = 0.0,
) -> LightSourceAngles:
    """Inclination of a light source about two axes, from its direction in polar angles.

    Source: thesis 7.4.5, equations 7.7 to 7.10, and table 7.8.
    """
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
    """Distance between two probes."""

    spacing: Annotated[float, "m", "Distance between the probes, along the slope of the target."]
    spacing_error: Annotated[float, "m", "Its change by the error of the angle."]
    gap_error: Annotated[float, "m", "Error of a gap because the target also turns about the other axis."]


@calculator
def probe_spacing(
    gap_difference: Annotated[float, "m", "Change of the difference of the two gaps by the tilt."],
    angle: Annotated[float, "rad", SMALL_ANGLE, NON_ZERO, "Tilt of the target."],
    angle_error: Annotated[float, "rad", SMALL_ANGLE, "Error of the tilt."] = 0.0,
    cross_angle: Annotated[
        float,
        "rad",
        SMALL_ANGLE,
        "Angle by which the axis of the tilt fails to be square to the line through the probes.",
    ] = 0.0,
    span: Annotated[float, "m", NON_NEGATIVE, "Distance of the probes along this axis."] = 0.0,
) -> ProbeSpacing:
    """Distance between two probes from a known tilt of the target.

    Source: thesis 7.5.2, equations 7.11 and 7.12.
    """
    if angle + angle_error == 0.0:
        raise ParameterError(f"{angle_error:g} rad", where="angle_error", expected="less than the angle itself")
    spacing = gap_difference / math.tan(angle)
    return ProbeSpacing(
        spacing=spacing,
        spacing_error=gap_difference / math.tan(angle + angle_error) - spacing,
        gap_error=cross_angle * angle * span,
    )
