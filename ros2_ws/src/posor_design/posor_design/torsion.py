"""Discs, shafts, and the torsional vibration of measuring beams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from posor.errors import ParameterError
from scipy.optimize import brentq

from posor_design.beam_section import make_section, make_tube
from posor_design.calculators import calculator

if TYPE_CHECKING:
    from posor_design.units import (
        MODES,
        NON_NEGATIVE,
        POSITIVE,
        BeamDensity,
        BeamLength,
        BoxWidth,
        Hertz,
        Kilogram,
        KilogramPerCubicMetre,
        KilogramSquareMetre,
        Metre,
        Modulus,
        NewtonMetre,
        Pascal,
        PoissonRatio,
        RadianPerSecond,
        Shape,
        Wall,
    )


@dataclass(frozen=True)
class BeamTorsion:
    """Natural frequencies of the torsion of a measuring beam."""

    start_frequencies: Annotated[
        tuple[Hertz, ...],
        "Frequencies of the side from the gimbal to the start of the beam, lowest first; none if the gimbal is at the "
        "start.",
    ]
    end_frequencies: Annotated[tuple[Hertz, ...], "Frequencies of the side from the gimbal to the end."]
    start_angular_frequencies: Annotated[tuple[RadianPerSecond, ...], "The same as ``start_frequencies``, times 2 pi."]
    end_angular_frequencies: Annotated[tuple[RadianPerSecond, ...], "The same as ``end_frequencies``, times 2 pi."]


@calculator
def beam_torsion(
    shape: Shape,
    height: Annotated[Metre, POSITIVE, "Outer height of the section; the outer diameter of a tube."],
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: BeamDensity,
    gimbal: Annotated[Metre, NON_NEGATIVE, "Distance of the gimbal that holds the beam from the start of the beam."],
    plate_inertias: Annotated[
        tuple[KilogramSquareMetre, KilogramSquareMetre],
        NON_NEGATIVE,
        "Moments of inertia of the plates at start and end about the axis of the beam.",
    ] = (0.0, 0.0),
    width: BoxWidth = 0.0,
    poisson_ratio: PoissonRatio = 0.33,
    modes: Annotated[int, MODES, "Number of modes of each side."] = 1,
) -> BeamTorsion:
    """Natural frequencies of the torsion of a measuring beam with a plate at each end.

    One gimbal holds the beam against twist, the other lets it twist freely. The two sides of the gimbal that holds
    vibrate independently of each other.

    Source: thesis 6.2.3 (gimbals with two and four degrees of freedom); Meirovitch, Elements of Vibration Analysis
        (1975), 5.8: a rod with a disc, Z tan Z = inertia of the rod over inertia of the disc.

    Example:
        posor design beam-torsion --shape tube --height '2 in' --wall '.125 in' --length '30 in'
        --modulus '10.6e6 psi' --density '.1 lb/in^3' --gimbal '6 in' --plate-inertias '.01436, .01436 kg m^2'

    """
    if gimbal > length:
        raise ParameterError(f"{gimbal:g} m", where="gimbal", expected=f"0 to {length:g} m")
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


@dataclass(frozen=True)
class DiscInertia:
    """Mass and moments of inertia of a disc or ring."""

    mass: Annotated[Kilogram, "Mass."]
    axis_inertia: Annotated[KilogramSquareMetre, "Moment of inertia about its axis."]
    diameter_inertia: Annotated[KilogramSquareMetre, "Moment of inertia about a diameter."]


@calculator
def disc_inertia(
    diameter: Annotated[Metre, POSITIVE, "Outer diameter."],
    thickness: Annotated[Metre, POSITIVE, "Thickness."],
    density: Annotated[KilogramPerCubicMetre, POSITIVE, "Density."],
    bore: Annotated[Metre, NON_NEGATIVE, "Inner diameter of a ring."] = 0.0,
) -> DiscInertia:
    """Mass and moments of inertia of a disc or ring, such as the plate of a POSOR.

    Source: Meriam, Dynamics (1971), table of moments of inertia.

    Example:
        posor design disc-inertia --diameter '10 in' --thickness '.5 in' --density '.1 lb/in^3'

    """
    disc = make_tube(diameter, bore, "bore")
    mass = density * disc.area * thickness
    about_diameter = density * disc.second_moment * thickness
    return DiscInertia(mass, 2.0 * about_diameter, about_diameter + mass * thickness**2 / 12.0)


@dataclass(frozen=True)
class ShaftStress:
    """Stress of a shaft."""

    stress: Annotated[Pascal, "Largest shear stress."]


@calculator
def shaft_stress(
    torque: Annotated[NewtonMetre, POSITIVE, "Torque."],
    diameter: Annotated[Metre, POSITIVE, "Outer diameter."],
    bore: Annotated[Metre, NON_NEGATIVE, "Inner diameter of a hollow shaft."] = 0.0,
) -> ShaftStress:
    """Shear stress of a round shaft that transmits a torque.

    Source: thesis 9.4.2; Timoshenko, Strength of Materials, part 1 (1955), article 62.

    Example:
        posor design shaft-stress --torque '640 lbf in' --diameter '.5 in'

    """
    shaft = make_tube(diameter, bore, "bore")
    return ShaftStress(0.5 * torque * diameter / (2.0 * shaft.second_moment))
