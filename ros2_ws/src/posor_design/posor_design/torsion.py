# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Discs, shafts, and the torsional vibration of measuring beams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor.errors import ParameterError
from scipy.optimize import brentq

from posor_design.beam_section import make_section, make_tube
from posor_design.calculators import (
    MODES,
    NON_NEGATIVE,
    POSITIVE,
    BeamDensity,
    BeamLength,
    BoxWidth,
    Modulus,
    PoissonRatio,
    Shape,
    Wall,
    calculator,
)


@dataclass(frozen=True)
class BeamTorsion:
    """Natural frequencies of the torsion of a measuring beam."""

    start_frequencies: Annotated[
        tuple[float, ...],
        "Hz",
        "Frequencies of the side from the gimbal to the start of the beam, lowest first; none if the gimbal is at the "
        "start.",
    ]
    end_frequencies: Annotated[tuple[float, ...], "Hz", "Frequencies of the side from the gimbal to the end."]
    start_angular_frequencies: Annotated[tuple[float, ...], "rad/s", "The same as ``start_frequencies``, times 2 pi."]
    end_angular_frequencies: Annotated[tuple[float, ...], "rad/s", "The same as ``end_frequencies``, times 2 pi."]


@calculator
def beam_torsion(
    shape: Shape,
    height: Annotated[float, "m", POSITIVE, "Outer height of the section; the outer diameter of a tube."],
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: BeamDensity,
    gimbal: Annotated[float, "m", NON_NEGATIVE, "Distance of the gimbal that holds the beam from its start."],
    plate_inertias: Annotated[
        tuple[float, float],
        "kg m^2",
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

    mass: Annotated[float, "kg", "Mass."]
    axis_inertia: Annotated[float, "kg m^2", "Moment of inertia about its axis."]
    diameter_inertia: Annotated[float, "kg m^2", "Moment of inertia about a diameter."]


@calculator
def disc_inertia(
    diameter: Annotated[float, "m", POSITIVE, "Outer diameter."],
    thickness: Annotated[float, "m", POSITIVE, "Thickness."],
    density: Annotated[float, "kg/m^3", POSITIVE, "Density."],
    bore: Annotated[float, "m", NON_NEGATIVE, "Inner diameter of a ring."] = 0.0,
) -> DiscInertia:
    """Mass and moments of inertia of a disc or ring, such as the plate of a POSOR.

    Source: Meriam, Dynamics (1971), table of moments of inertia.
    """
    disc = make_tube(diameter, bore, "bore")
    mass = density * disc.area * thickness
    about_diameter = density * disc.second_moment * thickness
    return DiscInertia(mass, 2.0 * about_diameter, about_diameter + mass * thickness**2 / 12.0)


@dataclass(frozen=True)
class ShaftStress:
    """Stress of a shaft."""

    stress: Annotated[float, "Pa", "Largest shear stress."]


@calculator
def shaft_stress(
    torque: Annotated[float, "N m", POSITIVE, "Torque."],
    diameter: Annotated[float, "m", POSITIVE, "Outer diameter."],
    bore: Annotated[float, "m", NON_NEGATIVE, "Inner diameter of a hollow shaft."] = 0.0,
) -> ShaftStress:
    """Shear stress of a round shaft that transmits a torque.

    Source: thesis 9.4.2; Timoshenko, Strength of Materials, part 1 (1955), article 62.
    """
    shaft = make_tube(diameter, bore, "bore")
    return ShaftStress(0.5 * torque * diameter / (2.0 * shaft.second_moment))
