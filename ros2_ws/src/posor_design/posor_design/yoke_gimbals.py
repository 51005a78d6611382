"""Gimbals with a yoke on ball bearings: allowed friction, and acceleration of the controller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_design.beam_section import make_tube
from posor_design.checks import require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
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
    """Friction that an error of the endpoint allows to the bearings of a yoke.

    Attributes:
        friction_radius: Allowed coefficient of friction times radius of the bearing.
        bearing_load: Load of the bearings of a gimbal.
        torque: Reaction torque that is allowed.

    """

    friction_radius: Metre
    bearing_load: Newton
    torque: NewtonMetre


def yoke_friction(
    beam_length: Metre,
    outside_diameter: Metre,
    inside_diameter: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    added_mass: Kilogram,
    yoke_distance: Metre,
    acceleration: MetrePerSecondSquared,
    endpoint_error: Metre,
) -> YokeFriction:
    """Allowed product of the coefficient of friction and the radius of the bearings of a yoke gimbal.

    Each of two gimbals carries half of the mass. The friction of both bends the measuring beam between the yokes, and
    the slope of its ends acts over four lengths of the beam on the endpoint of an arm of two beams.

    Args:
        beam_length: Length of the measuring beam.
        outside_diameter: Outside diameter of the beam.
        inside_diameter: Inside diameter of the beam, 0 or more.
        modulus: Modulus of elasticity of the beam.
        density: Density of the beam.
        added_mass: Mass of everything that the gimbals carry beside the beam, 0 or more.
        yoke_distance: Distance between the yokes.
        acceleration: Acceleration with that of gravity.
        endpoint_error: Allowed error of the endpoint.

    Raises:
        ParameterError: An argument is not finite or not positive, or the tube has no wall.

    Source: thesis equations 6.10 and 6.11.

    Example:
        posor design yoke-friction --beam-length '30 in' --outside-diameter '2 in' --inside-diameter '1.75 in'
        --modulus '10e6 psi' --density '.2 lb/in^3' --added-mass '12 lb' --yoke-distance '18 in'
        --acceleration '19.6133 m/s^2' --endpoint-error '50 uin'

    """
    require_positive(beam_length=beam_length, modulus=modulus, density=density, yoke_distance=yoke_distance)
    require_positive(acceleration=acceleration, endpoint_error=endpoint_error)
    require_non_negative(added_mass=added_mass)
    require_positive(outside_diameter=outside_diameter)
    tube = make_tube(outside_diameter, inside_diameter, "inside_diameter")
    beam_mass = density * tube.area * beam_length
    bearing_load = 0.5 * (added_mass + beam_mass) * acceleration
    torque = 2.0 * modulus * tube.second_moment / yoke_distance * endpoint_error / (4.0 * beam_length)
    return YokeFriction(friction_radius=torque / bearing_load, bearing_load=bearing_load, torque=torque)


@dataclass(frozen=True)
class DitherAcceleration:
    """Greatest acceleration of a sinusoidal motion.

    Attributes:
        acceleration: Greatest acceleration.

    """

    acceleration: MetrePerSecondSquared


def dither_acceleration(amplitude: Metre, period: Second) -> DitherAcceleration:
    """Greatest acceleration of a controller that dithers sinusoidally.

    Args:
        amplitude: Amplitude from the mean position.
        period: Period.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 6.2.3.2.

    Example:
        posor design dither-acceleration --amplitude '.01 in' --period '.03 s'

    """
    require_positive(amplitude=amplitude, period=period)
    return DitherAcceleration(amplitude * (2.0 * math.pi / period) ** 2)
