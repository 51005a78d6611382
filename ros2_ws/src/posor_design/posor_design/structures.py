# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Structural beams: sizing for stress and for stiffness, and natural frequencies of a cantilever."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

from posor.chain.beam_bending import cantilever
from posor.errors import ParameterError
from scipy.constants import g as standard_gravity
from scipy.optimize import brentq

from posor_design.beam_section import make_section
from posor_design.calculators import (
    MODES,
    NON_NEGATIVE,
    POSITIVE,
    BeamLength,
    BoxWidth,
    Height,
    Modulus,
    PoissonRatio,
    Shape,
    Wall,
    WeightDensity,
    calculator,
)
from posor_design.timoshenko_beam import Attachment, BeamModel, make_beam

if TYPE_CHECKING:
    from collections.abc import Callable


_THINNEST = 1e-6  # least wall that sizing considers, relative to half of the smaller side


@dataclass(frozen=True)
class CantileverBeam:
    """A cantilever with a force at its free end."""

    wall: Annotated[float, "m", "Thickness of the walls."]
    second_moment: Annotated[float, "m^4", "Second moment of area about the axis across the plane of bending."]
    mass_per_length: Annotated[float, "kg/m", "Mass per length."]
    stress: Annotated[float, "Pa", "Largest bending stress, at the clamped end."]
    deflection: Annotated[float, "m", "Deflection of the free end."]
    slope: Annotated[float, "rad", "Slope of the free end."]


@calculator
def cantilever_beam(
    length: BeamLength,
    tip_force: Annotated[float, "N", NON_NEGATIVE, "Force at its free end, across the beam."],
    modulus: Modulus,
    height: Height,
    wall: Wall,
    shape: Shape = "box",
    width: BoxWidth = 0.0,
    density: WeightDensity = 0.0,
) -> CantileverBeam:
    """Stress and deflection of a cantilever with a force at its free end and its own weight.

    Source: thesis appendix 1A; bending theory of Euler and Bernoulli, without shear.
    """
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


@calculator
def cantilever_for_stress(
    length: BeamLength,
    tip_force: Annotated[float, "N", POSITIVE, "Force at its free end, across the beam."],
    modulus: Modulus,
    stress: Annotated[float, "Pa", POSITIVE, "Largest bending stress allowed."],
    height: Height,
    shape: Shape = "box",
    width: BoxWidth = 0.0,
    density: WeightDensity = 0.0,
) -> CantileverBeam:
    """Thinnest walls of a cantilever whose stress stays within a limit.

    Source: thesis appendix 1A (stress criterion).
    """
    beam = partial(cantilever_beam, length, tip_force, modulus, height, shape=shape, width=width, density=density)
    return _with_thinnest_walls(beam, "stress", stress, "Pa", height, width)


@calculator
def cantilever_for_stiffness(
    length: BeamLength,
    tip_force: Annotated[float, "N", POSITIVE, "Force at its free end, across the beam."],
    modulus: Modulus,
    deflection: Annotated[float, "m", POSITIVE, "Largest deflection allowed at the free end."],
    height: Height,
    shape: Shape = "box",
    width: BoxWidth = 0.0,
    density: WeightDensity = 0.0,
) -> CantileverBeam:
    """Thinnest walls of a cantilever whose deflection stays within a limit.

    Source: thesis appendix 1A (deflection criterion).
    """
    beam = partial(cantilever_beam, length, tip_force, modulus, height, shape=shape, width=width, density=density)
    return _with_thinnest_walls(beam, "deflection", deflection, "m", height, width)


def _with_thinnest_walls(
    beam: Callable[[float], CantileverBeam], name: str, limit: float, unit: str, height: float, width: float
) -> CantileverBeam:
    """Return the beam whose result of a name, which falls with the wall, is at its limit.

    Raises ParameterError: the result of the thickest wall exceeds the limit.
    """

    def excess(wall: float) -> float:
        return float(getattr(beam(wall), name)) / limit - 1.0

    half = 0.5 * (min(height, width) if width > 0.0 else height)
    thinnest, thickest = half * _THINNEST, half * (1.0 - _THINNEST)
    least = float(getattr(beam(thickest), name))
    if least > limit:
        what = f"{limit:g} {unit} cannot be met with these outer dimensions"
        expected = f"at least {least:.4g} {unit}, the value of the solid section"
        raise ParameterError(what, where=name, expected=expected)
    if excess(thinnest) <= 0.0:
        return beam(thinnest)
    return beam(float(brentq(excess, thinnest, thickest, xtol=half * 1e-9)))


@dataclass(frozen=True)
class CantileverFrequencies:
    """Natural frequencies of a cantilever."""

    frequencies: Annotated[tuple[float, ...], "Hz", "Lowest first, with shear and rotary inertia."]
    angular_frequencies: Annotated[tuple[float, ...], "rad/s", "The same, times 2 pi."]
    slender_angular_frequencies: Annotated[tuple[float, ...], "rad/s", "Without shear and rotary inertia."]


@calculator
def cantilever_frequencies(
    height: Height,
    wall: Wall,
    length: BeamLength,
    modulus: Modulus,
    density: Annotated[float, "kg/m^3", POSITIVE, "Density."],
    tip_mass: Annotated[float, "kg", NON_NEGATIVE, "Mass at the free end."] = 0.0,
    load_factor: Annotated[
        float,
        "1",
        POSITIVE,
        "Mass of the beam with all that it carries along its length, over its own mass; the rotary inertia of its "
        "sections grows by the same factor.",
    ] = 1.0,
    shape: Shape = "box",
    width: BoxWidth = 0.0,
    poisson_ratio: PoissonRatio = 0.33,
    modes: Annotated[int, MODES, "Number of modes."] = 3,
) -> CantileverFrequencies:
    """Natural frequencies of a cantilever with a mass at its free end.

    Source: thesis 6.2.2 and appendix 1A; Meirovitch, Elements of Vibration Analysis (1975), 5.10 (slender beam).
    """
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

    ``ratio``: mass at the free end over the mass of the beam. ``count``: number of roots.
    """

    def equation(z: float) -> float:
        return 1.0 / math.cosh(z) + math.cos(z) + ratio * z * (math.cos(z) * math.tanh(z) - math.sin(z))

    return [brentq(equation, half * math.pi, (half + 1) * math.pi) for half in range(count)]
