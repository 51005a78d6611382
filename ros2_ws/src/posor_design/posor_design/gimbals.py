# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gimbals of a measuring beam: motion, allowed reaction torque, wires, and yokes on ball bearings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from scipy.optimize import brentq

from posor_design.beam_section import make_tube
from posor_design.calculators import NON_NEGATIVE, POSITIVE, calculator


@dataclass(frozen=True)
class GimbalMotion:
    """Motion that the gimbals of a measuring beam must allow."""

    angle: Annotated[float, "rad", "Deflection of the structural beam over its length."]
    shortening: Annotated[float, "m", "Decrease of the distance between the ends of the bent structural beam."]


@calculator
def gimbal_motion(
    length: Annotated[float, "m", POSITIVE, "Length of the structural beam."],
    height: Annotated[float, "m", POSITIVE, "Height of its section in the direction of the force."],
    stress: Annotated[float, "Pa", POSITIVE, "Greatest bending stress."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity."],
) -> GimbalMotion:
    """Motion that the gimbals must allow, from the stress of the structural beam.

    The structural beam is uniform, held at one end and loaded by a force at the other one.

    Source: thesis 6.2.3; deflection of a cantilever: Young and Budynas, Roark's Formulas for Stress and Strain (2002).
    """
    angle = 2.0 * stress * length / (3.0 * modulus * height)
    return GimbalMotion(angle=angle, shortening=0.6 * angle**2 * length)


@dataclass(frozen=True)
class GimbalTorques:
    """Reaction torques of the gimbals that an error of the endpoint allows."""

    bending_torque: Annotated[float, "N m", "Torque at each end of the beam, about an axis across it."]
    twisting_torque: Annotated[float, "N m", "Torque about the axis of the beam."]


@calculator
def gimbal_torques(
    length: Annotated[float, "m", POSITIVE, "Length of the measuring beam."],
    outside_diameter: Annotated[float, "m", POSITIVE, "Outside diameter."],
    inside_diameter: Annotated[float, "m", NON_NEGATIVE, "Inside diameter, 0 or more."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity."],
    shear_modulus: Annotated[float, "Pa", POSITIVE, "Shear modulus."],
    endpoint_error: Annotated[float, "m", POSITIVE, "Allowed error of the endpoint."],
    far_distance: Annotated[float, "m", POSITIVE, "Distance of the endpoint from the far end of the beam."],
    near_distance: Annotated[float, "m", POSITIVE, "Distance of the endpoint from the near end, lever of the twist."],
) -> GimbalTorques:
    """Reaction torques of the gimbals that an error of the endpoint allows, for a measuring beam of tube.

    Opposite torques at the two ends bend the beam most: the slope of each end is the torque times the length over twice
    the bending stiffness. The slopes of both ends act on the endpoint over their distances.

    Source: thesis equations 6.3 and 6.4.
    """
    inertia = make_tube(outside_diameter, inside_diameter, "inside_diameter").second_moment
    return GimbalTorques(
        bending_torque=2.0 * modulus * inertia * endpoint_error / (length * (far_distance + near_distance)),
        twisting_torque=2.0 * shear_modulus * inertia * endpoint_error / (length * near_distance),
    )


@dataclass(frozen=True)
class WireGimbal:
    """Wires of a gimbal at the end of its range."""

    wire_length: Annotated[float, "m", "Length of a wire."]
    wire_angle: Annotated[float, "rad", "Angle by which the wires turn."]
    torque: Annotated[float, "N m", "Reaction torque of the gimbal."]
    initial_stress: Annotated[float, "Pa", "Stress by the initial tension."]
    stretch_stress: Annotated[float, "Pa", "Stress that the stretch of the turned wires adds."]
    natural_frequency: Annotated[float, "rad/s", "Lowest natural angular frequency of the supported mass."]


@calculator
def wire_gimbal(
    wires: Annotated[int, POSITIVE, "Number of wires that the rotation turns."],
    lever: Annotated[float, "m", POSITIVE, "Distance of the fixing points of the wires from the axis of rotation."],
    angle: Annotated[float, "rad", POSITIVE, "Rotation of the beam."],
    wire_length: Annotated[float, "m", POSITIVE, "Length of a wire."],
    wire_diameter: Annotated[float, "m", POSITIVE, "Diameter of a wire."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the wire."],
    tension: Annotated[float, "N", NON_NEGATIVE, "Initial tension of a wire."],
    mass: Annotated[float, "kg", POSITIVE, "Mass of the measuring beam."],
) -> WireGimbal:
    """Reaction torque, stress and natural frequency of a gimbal of wires.

    Wires without stiffness in bending and torsion hold the beam at a distance from the axis of rotation. A small
    rotation turns them, and their tension and stretch pull the beam back. For the frequency one wire in tension holds
    half of the mass.

    Source: thesis equations 6.5 to 6.9.
    """
    area = math.pi / 4.0 * wire_diameter**2
    wire_angle = angle * lever / wire_length
    stretch_stress = 0.5 * modulus * wire_angle**2
    return WireGimbal(
        wire_length=wire_length,
        wire_angle=wire_angle,
        torque=wires * lever * wire_angle * (tension + area * stretch_stress),
        initial_stress=tension / area,
        stretch_stress=stretch_stress,
        natural_frequency=math.sqrt(2.0 * area * modulus / (wire_length * mass)),
    )


@calculator
def shortest_wires(
    wires: Annotated[int, POSITIVE, "Number of wires that the rotation turns."],
    lever: Annotated[float, "m", POSITIVE, "Distance of the fixing points of the wires from the axis of rotation."],
    angle: Annotated[float, "rad", POSITIVE, "Rotation of the beam."],
    torque: Annotated[float, "N m", POSITIVE, "Allowed reaction torque."],
    wire_diameter: Annotated[float, "m", POSITIVE, "Diameter of a wire."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the wire."],
    tension: Annotated[float, "N", NON_NEGATIVE, "Initial tension of a wire."],
    mass: Annotated[float, "kg", POSITIVE, "Mass of the measuring beam."],
) -> WireGimbal:
    """Shortest wires of a gimbal whose reaction torque an error of the endpoint allows.

    Source: thesis equations 6.5 to 6.9, solved for the length.
    """

    def gimbal(length: float, tension: float = tension) -> WireGimbal:
        return wire_gimbal(wires, lever, angle, length, wire_diameter, modulus, tension, mass)

    # The torque has a term in 1 / length and one in 1 / length^3. Each of them alone needs a length that is a lower
    # bound; lengths for half of the torque each are an upper bound. The margin is for rounding.
    by_tension = wires * lever**2 * angle * tension / torque
    by_stretch = math.cbrt(gimbal(1.0, tension=0.0).torque / torque)
    lower = 0.99 * max(by_tension, by_stretch)
    upper = 1.01 * max(2.0 * by_tension, math.cbrt(2.0) * by_stretch)
    return gimbal(brentq(lambda length: gimbal(length).torque - torque, lower, upper, xtol=1e-300, rtol=1e-14))


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
    added_mass: Annotated[float, "kg", NON_NEGATIVE, "Mass of all that the gimbals carry beside the beam, 0 or more."],
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
