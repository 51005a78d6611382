# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Structural beams: published closed forms, an independent finite-element solution, sizing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor.errors import ParameterError
from posor_design.beam_section import make_section
from posor_design.structures import (
    cantilever_beam,
    cantilever_for_stiffness,
    cantilever_for_stress,
    cantilever_frequencies,
)

from .beam_elements import ElementBeam

GRAVITY = 9.80665
LOADED: dict[str, Any] = {"length": 3.0, "tip_force": 1300.0, "modulus": 70e9, "height": 0.18, "width": 0.1}
VIBRATING: dict[str, Any] = {
    "height": 0.15,
    "width": 0.1,
    "wall": 0.003,
    "length": 1.5,
    "modulus": 73e9,
    "density": 2768.0,
}


def test_a_loaded_cantilever_has_the_published_stress_and_deflection() -> None:
    found = cantilever_beam(**LOADED, wall=0.005)
    moment_of_area = make_section("box", 0.18, 0.1, 0.005).second_moment
    assert found.second_moment == moment_of_area
    assert found.stress == pytest.approx(1300.0 * 3.0 * 0.09 / moment_of_area)
    assert found.deflection == pytest.approx(1300.0 * 3.0**3 / (3.0 * 70e9 * moment_of_area))
    assert found.slope == pytest.approx(1300.0 * 3.0**2 / (2.0 * 70e9 * moment_of_area))
    assert found.mass_per_length == 0.0


def test_its_own_weight_bends_a_cantilever() -> None:
    values = {**LOADED, "tip_force": 0.0}
    found = cantilever_beam(**values, wall=0.005, density=2700.0)
    section = make_section("box", 0.18, 0.1, 0.005)
    weight = 2700.0 * section.area * GRAVITY
    assert found.mass_per_length == pytest.approx(2700.0 * section.area)
    assert found.stress == pytest.approx(weight * 3.0**2 / 2.0 * 0.09 / section.second_moment)
    assert found.deflection == pytest.approx(weight * 3.0**4 / (8.0 * 70e9 * section.second_moment))


@pytest.mark.parametrize("density", [0.0, 2700.0])
def test_sizing_meets_its_limit_exactly(density: float) -> None:
    for_stress = cantilever_for_stress(**LOADED, stress=40e6, density=density)
    assert for_stress.stress == pytest.approx(40e6)
    assert for_stress == cantilever_beam(**LOADED, wall=for_stress.wall, density=density)
    for_stiffness = cantilever_for_stiffness(**LOADED, deflection=0.012, density=density)
    assert for_stiffness.deflection == pytest.approx(0.012)
    thinner = cantilever_beam(**LOADED, wall=0.99 * for_stiffness.wall, density=density)
    assert thinner.deflection > 0.012


def test_a_tube_is_sized_like_a_box() -> None:
    values = {**LOADED, "shape": "tube", "width": 0.0}
    found = cantilever_for_stress(**values, stress=60e6)
    radius, bore = 0.09, 0.09 - found.wall
    assert found.stress == pytest.approx(60e6)
    assert found.second_moment == pytest.approx(math.pi / 4.0 * (radius**4 - bore**4))


def test_a_weak_limit_needs_the_thinnest_wall() -> None:
    assert cantilever_for_stress(**LOADED, stress=1e15).wall == pytest.approx(0.05e-6)


@pytest.mark.parametrize("limit", [{"stress": 1e6}, {"deflection": 1e-6}])
def test_an_infeasible_limit_is_refused_with_the_nearest_feasible_one(limit: dict[str, float]) -> None:
    size: Any = cantilever_for_stress if "stress" in limit else cantilever_for_stiffness
    with pytest.raises(ParameterError) as caught:
        size(**LOADED, **limit)
    name = next(iter(limit))
    assert caught.value.where == name
    nearest = float(caught.value.expected.split()[2])
    assert getattr(size(**LOADED, **{name: 1.001 * nearest}), name) == pytest.approx(1.001 * nearest)
    with pytest.raises(ParameterError):
        size(**LOADED, **{name: 0.999 * nearest})


@pytest.mark.parametrize("tip_mass", [0.0, 3.0, 40.0])
def test_cantilever_frequencies_agree_with_finite_elements(tip_mass: float) -> None:
    found = cantilever_frequencies(**VIBRATING, tip_mass=tip_mass, load_factor=2.0, poisson_ratio=0.3)
    section = make_section("box", 0.15, 0.1, 0.003)
    beam = ElementBeam(
        1.5,
        73e9 * section.second_moment,
        section.shear_coefficient(0.3) * 73e9 / 2.6 * section.area,
        2.0 * 2768.0 * section.area,
        2.0 * 2768.0 * section.second_moment,
    )
    beam.clamp(0.0)
    beam.add(1.5, mass=tip_mass)
    np.testing.assert_allclose(found.angular_frequencies, beam.frequencies(3), rtol=1e-3)
    np.testing.assert_allclose(np.array(found.frequencies) * 2.0 * math.pi, found.angular_frequencies)


def test_a_slender_cantilever_has_the_closed_form() -> None:
    """1.8751, 4.6941, 7.8548; with as much mass at its end: 1.2479, 4.0311, 7.1341 (Blevins 1979, chapter 8)."""
    values = {**VIBRATING, "length": 60.0}
    section = make_section("box", 0.15, 0.1, 0.003)
    unit = math.sqrt(73e9 * section.second_moment / (2768.0 * section.area)) / 60.0**2
    for mass, roots in ((0.0, [1.875104, 4.694091, 7.854757]), (1.0, [1.24792, 4.03114, 7.13413])):
        found = cantilever_frequencies(**values, tip_mass=mass * 2768.0 * section.area * 60.0)
        np.testing.assert_allclose(found.slender_angular_frequencies, unit * np.square(roots), rtol=1e-5)
        np.testing.assert_allclose(found.angular_frequencies, found.slender_angular_frequencies, rtol=2e-3)


def test_a_heavy_end_on_a_light_cantilever_is_a_spring_with_a_mass() -> None:
    section = make_section("box", 0.15, 0.1, 0.003)
    found = cantilever_frequencies(**VIBRATING, tip_mass=1e5, modes=1)
    mass = 1e5 + 33.0 / 140.0 * 2768.0 * section.area * 1.5
    spring = 3.0 * 73e9 * section.second_moment / 1.5**3
    assert found.slender_angular_frequencies[0] == pytest.approx(math.sqrt(spring / mass), rel=1e-6)
