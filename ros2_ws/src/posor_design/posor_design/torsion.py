"""Discs, shafts, and the torsional vibration of measuring beams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from posor.errors import ParameterError
from scipy.optimize import brentq

from posor_design.beam_arguments import check_modes, make_beam
from posor_design.beam_section import make_section, make_tube
from posor_design.checks import require_finite, require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
        Hertz,
        Kilogram,
        KilogramPerCubicMetre,
        KilogramSquareMetre,
        Metre,
        NewtonMetre,
        Number,
        Pascal,
        RadianPerSecond,
    )


@dataclass(frozen=True)
class DiscInertia:
    """Mass and moments of inertia of a disc or ring.

    Attributes:
        mass: Mass.
        axis_inertia: Moment of inertia about its axis.
        diameter_inertia: Moment of inertia about a diameter.

    """

    mass: Kilogram
    axis_inertia: KilogramSquareMetre
    diameter_inertia: KilogramSquareMetre


def disc_inertia(diameter: Metre, thickness: Metre, density: KilogramPerCubicMetre, bore: Metre = 0.0) -> DiscInertia:
    """Mass and moments of inertia of a disc or ring, such as the plate of a POSOR.

    Args:
        diameter: Outer diameter.
        thickness: Thickness.
        density: Density.
        bore: Inner diameter of a ring.

    Raises:
        ParameterError: An argument is not finite or not positive, or the bore is not smaller than the disc.

    Source: Meriam, Dynamics (1971), table of moments of inertia.

    Example:
        posor design disc-inertia --diameter '10 in' --thickness '.5 in' --density '.1 lb/in^3'

    """
    require_positive(diameter=diameter, thickness=thickness, density=density)
    disc = make_tube(diameter, bore, "bore")
    mass = density * disc.area * thickness
    about_diameter = density * disc.second_moment * thickness
    return DiscInertia(mass, 2.0 * about_diameter, about_diameter + mass * thickness**2 / 12.0)


@dataclass(frozen=True)
class ShaftStress:
    """Stress of a shaft.

    Attributes:
        stress: Largest shear stress.

    """

    stress: Pascal


def shaft_stress(torque: NewtonMetre, diameter: Metre, bore: Metre = 0.0) -> ShaftStress:
    """Shear stress of a round shaft that transmits a torque.

    Args:
        torque: Torque.
        diameter: Outer diameter.
        bore: Inner diameter of a hollow shaft.

    Raises:
        ParameterError: An argument is not finite or not positive, or the bore is not smaller than the shaft.

    Source: thesis 9.4.2; Timoshenko, Strength of Materials, part 1 (1955), article 62.

    Example:
        posor design shaft-stress --torque '640 lbf in' --diameter '.5 in'

    """
    require_positive(torque=torque, diameter=diameter)
    shaft = make_tube(diameter, bore, "bore")
    return ShaftStress(0.5 * torque * diameter / (2.0 * shaft.second_moment))


@dataclass(frozen=True)
class BeamTorsion:
    """Natural frequencies of the torsion of a measuring beam.

    Attributes:
        start_frequencies: Frequencies of the side from the gimbal to the start of the beam, lowest first; none if the
            gimbal is at the start.
        end_frequencies: Frequencies of the side from the gimbal to the end.
        start_angular_frequencies: The same as ``start_frequencies``, times 2 pi.
        end_angular_frequencies: The same as ``end_frequencies``, times 2 pi.

    """

    start_frequencies: tuple[Hertz, ...]
    end_frequencies: tuple[Hertz, ...]
    start_angular_frequencies: tuple[RadianPerSecond, ...]
    end_angular_frequencies: tuple[RadianPerSecond, ...]


def beam_torsion(
    shape: Literal["tube", "box"],
    height: Metre,
    wall: Metre,
    length: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    gimbal: Metre,
    plate_inertias: tuple[KilogramSquareMetre, KilogramSquareMetre] = (0.0, 0.0),
    width: Metre = 0.0,
    poisson_ratio: Number = 0.33,
    modes: int = 1,
) -> BeamTorsion:
    """Natural frequencies of the torsion of a measuring beam with a plate at each end.

    One gimbal holds the beam against twist, the other lets it twist freely. The two sides of the gimbal that holds
    vibrate independently of each other.

    Args:
        shape: Section of the beam.
        height: Outer height of the section; the outer diameter of a tube.
        wall: Thickness of the walls.
        length: Length of the beam.
        modulus: Young's modulus.
        density: Density of the beam.
        gimbal: Distance of the gimbal that holds the beam from the start of the beam.
        plate_inertias: Moments of inertia of the plates at start and end about the axis of the beam.
        width: Outer width of a box.
        poisson_ratio: Poisson's ratio.
        modes: Number of modes of each side.

    Raises:
        ParameterError: An argument is not finite or out of its range.

    Source: thesis 6.2.3 (gimbals with two and four degrees of freedom); Meirovitch, Elements of Vibration Analysis
        (1975), 5.8: a rod with a disc, Z tan Z = inertia of the rod over inertia of the disc.

    Example:
        posor design beam-torsion --shape tube --height '2 in' --wall '.125 in' --length '30 in'
        --modulus '10.6e6 psi' --density '.1 lb/in^3' --gimbal '6 in' --plate-inertias '.01436, .01436 kg m^2'

    """
    check_modes(modes)
    make_beam(shape, height, wall, width, length, modulus, density, poisson_ratio)
    require_finite(gimbal=gimbal)
    if not 0.0 <= gimbal <= length:
        raise ParameterError(f"{gimbal:g} m", where="gimbal", expected=f"0 to {length:g} m")
    for inertia in plate_inertias:
        require_non_negative(plate_inertias=inertia)
    section = make_section(shape, height, width, wall)
    stiffness = modulus / (2.0 * (1.0 + poisson_ratio)) * section.torsion_constant
    inertia_per_length = density * section.polar_moment
    wave_speed = math.sqrt(stiffness / inertia_per_length)
    start, end = (
        tuple(
            wave_speed / side * root
            for root in _rod_with_disc(inertia_per_length * side, inertia, modes if side else 0)
        )
        for side, inertia in zip((gimbal, length - gimbal), plate_inertias, strict=True)
    )
    turn = 2.0 * math.pi
    return BeamTorsion(tuple(each / turn for each in start), tuple(each / turn for each in end), start, end)


def _rod_with_disc(rod: float, disc: float, count: int) -> list[float]:
    """Return the lowest roots of ``Z sin Z disc = rod cos Z``: one in each half wave."""
    return [
        brentq(lambda z: z * math.sin(z) * disc - rod * math.cos(z), half * math.pi, (half + 1) * math.pi)
        for half in range(count)
    ]
