"""Gimbals with a yoke on ball bearings: allowed friction, and acceleration of the controller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor_design.beam_section import make_tube
from posor_design.calculators import NON_NEGATIVE, POSITIVE, calculator


@dataclass(frozen=True)
class YokeFriction:
    """Friction that an error of the endpoint allows to the bearings of a yoke."""

    friction_radius: Annotated[float, "m", "Allowed coefficient of friction times radius of the bearing."]
    bearing_load: Annotated[float, "N", "Load of the bearings of a gimbal."]
    torque: Annotated[float, "N m", "Reaction torque that is allowed."]


@calculator
def yoke_friction(
    beam_length: Annotated[float, "m", POSITIVE, "Length of the measuring beam."],
    outside_diameter: Annotated[float, "m", POSITIVE, "Outside diameter of the beam."],
    inside_diameter: Annotated[float, "m", NON_NEGATIVE, "Inside diameter of the beam, 0 or more."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the beam."],
    density: Annotated[float, "kg/m^3", POSITIVE, "Density of the beam."],
    added_mass: Annotated[
        float, "kg", NON_NEGATIVE, "Mass of everything that the gimbals carry beside the beam, 0 or more."
    ],
    yoke_distance: Annotated[float, "m", POSITIVE, "Distance between the yokes."],
    acceleration: Annotated[float, "m/s^2", POSITIVE, "Acceleration with that of gravity."],
    endpoint_error: Annotated[float, "m", POSITIVE, "Allowed error of the endpoint."],
) -> YokeFriction:
    """Allowed product of the coefficient of friction and the radius of the bearings of a yoke gimbal.

    Each of two gimbals carries half of the mass. The friction of both bends the measuring beam between the yokes, and
    the slope of its ends acts over four lengths of the beam on the endpoint of an arm of two beams.

    Source: thesis equations 6.10 and 6.11.
    """
    tube = make_tube(outside_diameter, inside_diameter, "inside_diameter")
    beam_mass = density * tube.area * beam_length
    bearing_load = 0.5 * (added_mass + beam_mass) * acceleration
    torque = 2.0 * modulus * tube.second_moment / yoke_distance * endpoint_error / (4.0 * beam_length)
    return YokeFriction(friction_radius=torque / bearing_load, bearing_load=bearing_load, torque=torque)


@dataclass(frozen=True)
class DitherAcceleration:
    """Greatest acceleration of a sinusoidal motion."""

    acceleration: Annotated[float, "m/s^2", "Greatest acceleration."]


@calculator
def dither_acceleration(
    amplitude: Annotated[float, "m", POSITIVE, "Amplitude from the mean position."],
    period: Annotated[float, "s", POSITIVE, "Period."],
) -> DitherAcceleration:
    """Greatest acceleration of a controller that dithers sinusoidally.

    Source: thesis 6.2.3.2.
    """
    return DitherAcceleration(amplitude * (2.0 * math.pi / period) ** 2)
