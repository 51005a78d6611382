"""Structural beams: sizing for stress and for stiffness, and natural frequencies of a cantilever."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from posor.chain.beam_bending import cantilever
from posor.errors import ParameterError
from scipy.constants import g as standard_gravity
from scipy.optimize import brentq

from posor_design.beam_arguments import check_modes, make_beam
from posor_design.beam_section import make_section
from posor_design.beam_vibration import Attachment, BeamModel
from posor_design.checks import require_non_negative, require_positive

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_design.units import (
        Hertz,
        Kilogram,
        KilogramPerCubicMetre,
        KilogramPerMetre,
        Metre,
        MetreToTheFourth,
        Newton,
        Number,
        Pascal,
        Radian,
        RadianPerSecond,
    )

_THINNEST = 1e-6
"""Least wall that sizing considers, relative to half of the smaller side."""


@dataclass(frozen=True)
class CantileverBeam:
    """A cantilever with a force at its free end.

    Attributes:
        wall: Thickness of the walls.
        second_moment: Second moment of area about the axis across the plane of bending.
        mass_per_length: Mass per length.
        stress: Largest bending stress, at the clamped end.
        deflection: Deflection of the free end.
        slope: Slope of the free end.

    """

    wall: Metre
    second_moment: MetreToTheFourth
    mass_per_length: KilogramPerMetre
    stress: Pascal
    deflection: Metre
    slope: Radian


def cantilever_beam(
    length: Metre,
    tip_force: Newton,
    modulus: Pascal,
    height: Metre,
    wall: Metre,
    shape: Literal["tube", "box"] = "box",
    width: Metre = 0.0,
    density: KilogramPerCubicMetre = 0.0,
) -> CantileverBeam:
    """Stress and deflection of a cantilever with a force at its free end and its own weight.

    Args:
        length: Length of the beam.
        tip_force: Force at its free end, across the beam.
        modulus: Young's modulus.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        wall: Thickness of the walls.
        shape: Section of the beam.
        width: Outer width of a box.
        density: Density; 0: the beam has no weight.

    Raises:
        ParameterError: An argument is not finite or out of its range.

    Source: thesis appendix 1A; bending theory of Euler and Bernoulli, without shear.

    Example:
        posor design cantilever-beam --length '10 ft' --tip-force '300 lbf' --modulus '10e6 psi' --height '7 in'
        --width '4 in' --wall '3/16 in'

    """
    require_positive(length=length, modulus=modulus)
    require_non_negative(tip_force=tip_force, density=density)
    section = make_section(shape, height, width, wall)
    mass = density * section.area
    weight = mass * standard_gravity
    moment = tip_force * length + 0.5 * weight * length**2
    bent = cantilever(length, modulus * section.second_moment, weight, tip_force)
    return CantileverBeam(
        wall=wall,
        second_moment=section.second_moment,
        mass_per_length=mass,
        stress=0.5 * moment * height / section.second_moment,
        deflection=bent.deflection(length),
        slope=bent.slope(length),
    )


def cantilever_for_stress(
    length: Metre,
    tip_force: Newton,
    modulus: Pascal,
    stress: Pascal,
    height: Metre,
    shape: Literal["tube", "box"] = "box",
    width: Metre = 0.0,
    density: KilogramPerCubicMetre = 0.0,
) -> CantileverBeam:
    """Thinnest walls of a cantilever whose stress stays within a limit.

    Args:
        length: Length of the beam.
        tip_force: Force at its free end, across the beam.
        modulus: Young's modulus.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        stress: Largest bending stress allowed.
        shape: Section of the beam.
        width: Outer width of a box.
        density: Density; 0: the beam has no weight.

    Raises:
        ParameterError: An argument is not finite or out of its range, or no wall suffices.

    Source: thesis appendix 1A (stress criterion).

    Example:
        posor design cantilever-for-stress --length '10 ft' --tip-force '300 lbf' --modulus '10e6 psi'
        --stress '5000 psi' --height '7 in' --width '4 in'

    """
    require_positive(tip_force=tip_force, stress=stress)

    def beam(wall: float) -> CantileverBeam:
        return cantilever_beam(length, tip_force, modulus, height, wall, shape, width, density)

    return beam(_thinnest_wall(lambda wall: beam(wall).stress, stress, height, width, "stress", "Pa"))


def cantilever_for_stiffness(
    length: Metre,
    tip_force: Newton,
    modulus: Pascal,
    deflection: Metre,
    height: Metre,
    shape: Literal["tube", "box"] = "box",
    width: Metre = 0.0,
    density: KilogramPerCubicMetre = 0.0,
) -> CantileverBeam:
    """Thinnest walls of a cantilever whose deflection stays within a limit.

    Args:
        length: Length of the beam.
        tip_force: Force at its free end, across the beam.
        modulus: Young's modulus.
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        deflection: Largest deflection allowed at the free end.
        shape: Section of the beam.
        width: Outer width of a box.
        density: Density; 0: the beam has no weight.

    Raises:
        ParameterError: An argument is not finite or out of its range, or no wall suffices.

    Source: thesis appendix 1A (deflection criterion).

    Example:
        posor design cantilever-for-stiffness --length '10 ft' --tip-force '300 lbf' --modulus '10e6 psi'
        --deflection '20 mil' --height '20 in' --width '8 in'

    """
    require_positive(tip_force=tip_force, deflection=deflection)

    def beam(wall: float) -> CantileverBeam:
        return cantilever_beam(length, tip_force, modulus, height, wall, shape, width, density)

    return beam(_thinnest_wall(lambda wall: beam(wall).deflection, deflection, height, width, "deflection", "m"))


def _thinnest_wall(
    value: Callable[[float], float], limit: float, height: float, width: float, name: str, unit: str
) -> float:
    """Return the wall at which a value that falls with the wall is at its limit.

    Raises:
        ParameterError: The value of the thickest wall exceeds the limit.

    """
    require_positive(height=height)
    half = 0.5 * (min(height, width) if width > 0.0 else height)
    thinnest, thickest = half * _THINNEST, half * (1.0 - _THINNEST)
    least = value(thickest)
    if least > limit:
        raise ParameterError(
            f"{limit:g} {unit} cannot be met with these outer dimensions",
            where=name,
            expected=f"at least {least:.4g} {unit}, the value of the solid section",
        )
    if value(thinnest) <= limit:
        return thinnest
    return float(brentq(lambda wall: value(wall) / limit - 1.0, thinnest, thickest, xtol=half * 1e-9))


@dataclass(frozen=True)
class CantileverFrequencies:
    """Natural frequencies of a cantilever.

    Attributes:
        frequencies: Lowest first, with shear and rotary inertia.
        angular_frequencies: The same, times 2 pi.
        slender_angular_frequencies: Angular frequencies of a slender beam, without shear and rotary inertia.

    """

    frequencies: tuple[Hertz, ...]
    angular_frequencies: tuple[RadianPerSecond, ...]
    slender_angular_frequencies: tuple[RadianPerSecond, ...]


def cantilever_frequencies(
    height: Metre,
    wall: Metre,
    length: Metre,
    modulus: Pascal,
    density: KilogramPerCubicMetre,
    tip_mass: Kilogram = 0.0,
    load_factor: Number = 1.0,
    shape: Literal["tube", "box"] = "box",
    width: Metre = 0.0,
    poisson_ratio: Number = 0.33,
    modes: int = 3,
) -> CantileverFrequencies:
    """Natural frequencies of a cantilever with a mass at its free end.

    Args:
        height: Outer height of the section in the plane of bending; the outer diameter of a tube.
        wall: Thickness of the walls.
        length: Length of the beam.
        modulus: Young's modulus.
        density: Density.
        tip_mass: Mass at the free end.
        load_factor: Mass of the beam with all that it carries along its length, over its own mass; the rotary
            inertia of its sections grows by the same factor.
        shape: Section of the beam.
        width: Outer width of a box.
        poisson_ratio: Poisson's ratio.
        modes: Number of modes.

    Raises:
        ParameterError: An argument is not finite or out of its range.

    Source: thesis 6.2.2 and appendix 1A; Meirovitch, Elements of Vibration Analysis (1975), 5.10 (slender beam).

    Example:
        posor design cantilever-frequencies --height '6 in' --width '4 in' --wall '1/8 in' --length '60 in'
        --modulus '10.6e6 psi' --density '.1 lb/in^3' --load-factor 2

    """
    check_modes(modes)
    require_positive(load_factor=load_factor)
    require_non_negative(tip_mass=tip_mass)
    beam = make_beam(shape, height, wall, width, length, modulus, load_factor * density, poisson_ratio)
    clamp = Attachment(0.0, stiffness=math.inf, turning_stiffness=math.inf)
    angular, _ = BeamModel(beam, [clamp, Attachment(length, mass=tip_mass)], modes).modes(modes)
    ratio = tip_mass / (beam.mass * length)
    unit = math.sqrt(beam.bending_stiffness / beam.mass) / length**2
    return CantileverFrequencies(
        frequencies=tuple((angular / (2.0 * math.pi)).tolist()),
        angular_frequencies=tuple(angular.tolist()),
        slender_angular_frequencies=tuple(unit * root**2 for root in _cantilever_roots(ratio, modes)),
    )


def _cantilever_roots(ratio: float, count: int) -> list[float]:
    """Return the lowest wave numbers of a slender cantilever, times its length: one in each half wave.

    Args:
        ratio: Mass at the free end over the mass of the beam.
        count: Number of roots.

    """

    def equation(z: float) -> float:
        return 1.0 / math.cosh(z) + math.cos(z) + ratio * z * (math.cos(z) * math.tanh(z) - math.sin(z))

    return [brentq(equation, half * math.pi, (half + 1) * math.pi) for half in range(count)]
