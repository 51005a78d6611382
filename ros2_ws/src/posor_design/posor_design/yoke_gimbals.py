"""Gimbals with a yoke on ball bearings: allowed friction, and acceleration of the controller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from posor_design.beam_section import make_tube
from posor_design.calculators import calculator

if TYPE_CHECKING:
    from posor_design.units import (
        NON_NEGATIVE,
        POSITIVE,
        Kilogram,
        KilogramPerCubicMetre,
        Metre,
        MetrePerSecondSquared,
        Newton,
        NewtonMetre,
        Pascal,
        Second,
    )


@dataclass(frozen=True)
class YokeFriction:
    """Friction that an error of the endpoint allows to the bearings of a yoke."""

    friction_radius: Annotated[Metre, "Allowed coefficient of friction times radius of the bearing."]
    bearing_load: Annotated[Newton, "Load of the bearings of a gimbal."]
    torque: Annotated[NewtonMetre, "Reaction torque that is allowed."]


@calculator
def yoke_friction(
    beam_length: Annotated[Metre, POSITIVE, "Length of the measuring beam."],
    outside_diameter: Annotated[Metre, POSITIVE, "Outside diameter of the beam."],
    inside_diameter: Annotated[Metre, NON_NEGATIVE, "Inside diameter of the beam, 0 or more."],
    modulus: Annotated[Pascal, POSITIVE, "Modulus of elasticity of the beam."],
    density: Annotated[KilogramPerCubicMetre, POSITIVE, "Density of the beam."],
    added_mass: Annotated[
        Kilogram, NON_NEGATIVE, "Mass of everything that the gimbals carry beside the beam, 0 or more."
    ],
    yoke_distance: Annotated[Metre, POSITIVE, "Distance between the yokes."],
    acceleration: Annotated[MetrePerSecondSquared, POSITIVE, "Acceleration with that of gravity."],
    endpoint_error: Annotated[Metre, POSITIVE, "Allowed error of the endpoint."],
) -> YokeFriction:
    """Allowed product of the coefficient of friction and the radius of the bearings of a yoke gimbal.

    Each of two gimbals carries half of the mass. The friction of both bends the measuring beam between the yokes, and
    the slope of its ends acts over four lengths of the beam on the endpoint of an arm of two beams.

    Source: thesis equations 6.10 and 6.11.

    Example:
        posor design yoke-friction --beam-length '30 in' --outside-diameter '2 in' --inside-diameter '1.75 in'
        --modulus '10e6 psi' --density '.2 lb/in^3' --added-mass '12 lb' --yoke-distance '18 in'
        --acceleration '19.6133 m/s^2' --endpoint-error '50 uin'

    """
    tube = make_tube(outside_diameter, inside_diameter, "inside_diameter")
    beam_mass = density * tube.area * beam_length
    bearing_load = 0.5 * (added_mass + beam_mass) * acceleration
    torque = 2.0 * modulus * tube.second_moment / yoke_distance * endpoint_error / (4.0 * beam_length)
    return YokeFriction(friction_radius=torque / bearing_load, bearing_load=bearing_load, torque=torque)


@dataclass(frozen=True)
class DitherAcceleration:
    """Greatest acceleration of a sinusoidal motion."""

    acceleration: Annotated[MetrePerSecondSquared, "Greatest acceleration."]


@calculator
def dither_acceleration(
    amplitude: Annotated[Metre, POSITIVE, "Amplitude from the mean position."],
    period: Annotated[Second, POSITIVE, "Period."],
) -> DitherAcceleration:
    """Greatest acceleration of a controller that dithers sinusoidally.

    Source: thesis 6.2.3.2.

    Example:
        posor design dither-acceleration --amplitude '.01 in' --period '.03 s'

    """
    return DitherAcceleration(amplitude * (2.0 * math.pi / period) ** 2)
