"""Gimbals of a measuring beam: motion, allowed reaction torque, and wires."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scipy.optimize import brentq

from posor_design.beam_section import make_tube
from posor_design.checks import require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
        Kilogram,
        Metre,
        Newton,
        NewtonMetre,
        Pascal,
        Radian,
        RadianPerSecond,
    )


@dataclass(frozen=True)
class GimbalMotion:
    """Motion that the gimbals of a measuring beam must allow.

    Attributes:
        angle: Deflection of the structural beam over its length.
        shortening: Decrease of the distance between the ends of the bent structural beam.

    """

    angle: Radian
    shortening: Metre


def gimbal_motion(length: Metre, height: Metre, stress: Pascal, modulus: Pascal) -> GimbalMotion:
    """Motion that the gimbals must allow, from the stress of the structural beam.

    The structural beam is uniform, held at one end and loaded by a force at the other one.

    Args:
        length: Length of the structural beam.
        height: Height of its section in the direction of the force.
        stress: Greatest bending stress.
        modulus: Modulus of elasticity.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 6.2.3; deflection of a cantilever: Young and Budynas, Roark's Formulas for Stress and Strain (2002).

    Example:
        posor design gimbal-motion --length '30 in' --height '6 in' --stress '5000 psi' --modulus '10e6 psi'

    """
    require_positive(length=length, height=height, stress=stress, modulus=modulus)
    angle = 2.0 * stress * length / (3.0 * modulus * height)
    return GimbalMotion(angle=angle, shortening=0.6 * angle**2 * length)


@dataclass(frozen=True)
class GimbalTorques:
    """Reaction torques of the gimbals that an error of the endpoint allows.

    Attributes:
        bending_torque: Torque at each end of the beam, about an axis across it.
        twisting_torque: Torque about the axis of the beam.

    """

    bending_torque: NewtonMetre
    twisting_torque: NewtonMetre


def gimbal_torques(
    length: Metre,
    outside_diameter: Metre,
    inside_diameter: Metre,
    modulus: Pascal,
    shear_modulus: Pascal,
    endpoint_error: Metre,
    far_distance: Metre,
    near_distance: Metre,
) -> GimbalTorques:
    """Reaction torques of the gimbals that an error of the endpoint allows, for a measuring beam of tube.

    Opposite torques at the two ends bend the beam most: the slope of each end is the torque times the length over twice
    the bending stiffness. The slopes of both ends act on the endpoint over their distances.

    Args:
        length: Length of the measuring beam.
        outside_diameter: Outside diameter.
        inside_diameter: Inside diameter, 0 or more.
        modulus: Modulus of elasticity.
        shear_modulus: Shear modulus.
        endpoint_error: Allowed error of the endpoint.
        far_distance: Distance of the endpoint from the far end of the beam.
        near_distance: Distance of the endpoint from the near end; it is the lever of the twist too.

    Raises:
        ParameterError: An argument is not finite or not positive, or the tube has no wall.

    Source: thesis equations 6.3 and 6.4.

    Example:
        posor design gimbal-torques --length '30 in' --outside-diameter '2 in' --inside-diameter '1.75 in'
        --modulus '10e6 psi' --shear-modulus '3.85e6 psi' --endpoint-error '50 uin' --far-distance '30 in'
        --near-distance '30 in'

    """
    require_positive(length=length, modulus=modulus, shear_modulus=shear_modulus, endpoint_error=endpoint_error)
    require_positive(far_distance=far_distance, near_distance=near_distance)
    require_positive(outside_diameter=outside_diameter)
    inertia = make_tube(outside_diameter, inside_diameter, "inside_diameter").second_moment
    return GimbalTorques(
        bending_torque=2.0 * modulus * inertia * endpoint_error / (length * (far_distance + near_distance)),
        twisting_torque=2.0 * shear_modulus * inertia * endpoint_error / (length * near_distance),
    )


@dataclass(frozen=True)
class WireGimbal:
    """Wires of a gimbal at the end of its range.

    Attributes:
        wire_length: Length of a wire.
        wire_angle: Angle by which the wires turn.
        torque: Reaction torque of the gimbal.
        initial_stress: Stress by the initial tension.
        stretch_stress: Stress that the stretch of the turned wires adds.
        natural_frequency: Lowest natural angular frequency of the supported mass.

    """

    wire_length: Metre
    wire_angle: Radian
    torque: NewtonMetre
    initial_stress: Pascal
    stretch_stress: Pascal
    natural_frequency: RadianPerSecond


def wire_gimbal(
    wires: int,
    lever: Metre,
    angle: Radian,
    wire_length: Metre,
    wire_diameter: Metre,
    modulus: Pascal,
    tension: Newton,
    mass: Kilogram,
) -> WireGimbal:
    """Reaction torque, stress and natural frequency of a gimbal of wires.

    Wires without stiffness in bending and torsion hold the beam at a distance from the axis of rotation. A small
    rotation turns them, and their tension and stretch pull the beam back. For the frequency one wire in tension holds
    half of the mass.

    Args:
        wires: Number of wires that the rotation turns.
        lever: Distance of the fixing points of the wires from the axis of rotation.
        angle: Rotation of the beam.
        wire_length: Length of a wire.
        wire_diameter: Diameter of a wire.
        modulus: Modulus of elasticity of the wire.
        tension: Initial tension of a wire.
        mass: Mass of the measuring beam.

    Raises:
        ParameterError: An argument is not finite or not positive, or the tension is negative.

    Source: thesis equations 6.5 to 6.9.

    Example:
        posor design wire-gimbal --wires 2 --lever '1 in' --angle '.002 rad' --wire-length '.8 in'
        --wire-diameter '.02 in' --modulus '30e6 psi' --tension '12 lbf' --mass '12 lb'

    """
    require_positive(wires=wires, lever=lever, angle=angle, wire_length=wire_length, wire_diameter=wire_diameter)
    require_positive(modulus=modulus, mass=mass)
    require_non_negative(tension=tension)
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


def shortest_wires(
    wires: int,
    lever: Metre,
    angle: Radian,
    torque: NewtonMetre,
    wire_diameter: Metre,
    modulus: Pascal,
    tension: Newton,
    mass: Kilogram,
) -> WireGimbal:
    """Shortest wires of a gimbal whose reaction torque an error of the endpoint allows.

    Args:
        wires: Number of wires that the rotation turns.
        lever: Distance of the fixing points of the wires from the axis of rotation.
        angle: Rotation of the beam.
        torque: Allowed reaction torque.
        wire_diameter: Diameter of a wire.
        modulus: Modulus of elasticity of the wire.
        tension: Initial tension of a wire.
        mass: Mass of the measuring beam.

    Raises:
        ParameterError: An argument is not finite or not positive, or the tension is negative.

    Source: thesis equations 6.5 to 6.9, solved for the length.

    Example:
        posor design shortest-wires --wires 2 --lever '1 in' --angle '.002 rad' --torque '.3529 lbf in'
        --wire-diameter '.02 in' --modulus '30e6 psi' --tension '12 lbf' --mass '12 lb'

    """
    require_positive(torque=torque)
    require_non_negative(tension=tension)

    def gimbal(length: float, tension: float = tension) -> WireGimbal:
        return wire_gimbal(wires, lever, angle, length, wire_diameter, modulus, tension, mass)

    # The torque has a term in 1 / length and one in 1 / length^3. Each of them alone needs a length that is a lower
    # bound; lengths for half of the torque each are an upper bound. The margin is for rounding.
    by_tension = wires * lever**2 * angle * tension / torque
    by_stretch = math.cbrt(gimbal(1.0, tension=0.0).torque / torque)
    lower = 0.99 * max(by_tension, by_stretch)
    upper = 1.01 * max(2.0 * by_tension, math.cbrt(2.0) * by_stretch)
    return gimbal(brentq(lambda length: gimbal(length).torque - torque, lower, upper, xtol=1e-300, rtol=1e-14))
