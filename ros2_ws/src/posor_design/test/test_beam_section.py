# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sections of beams: published formulas and limits of shape."""

from __future__ import annotations

import math

import pytest
from posor_design.beam_section import make_section

POISSON = 0.3


def test_a_box_has_the_section_of_the_handbooks() -> None:
    """Flanges and webs apart, with Steiner's theorem."""
    box = make_section("box", height=7.0, width=4.0, wall=0.25)
    flange, web = 4.0 * 0.25, 6.5 * 0.25
    assert box.area == pytest.approx(2.0 * (flange + web))
    upright = 2.0 * (flange * 0.25**2 / 12.0 + flange * 3.375**2 + web * 6.5**2 / 12.0)
    sideways = 2.0 * (flange * 4.0**2 / 12.0 + web * 0.25**2 / 12.0 + web * 1.875**2)
    assert box.second_moment == pytest.approx(upright)
    assert box.polar_moment == pytest.approx(upright + sideways)


def test_a_tube_has_the_section_of_the_handbooks() -> None:
    tube = make_section("tube", height=2.0, width=0.0, wall=0.125)
    assert tube.area == pytest.approx(math.pi * (1.0 - 0.875**2))
    assert tube.second_moment == pytest.approx(math.pi / 4.0 * (1.0 - 0.875**4))
    assert tube.torsion_constant == tube.polar_moment == pytest.approx(2.0 * tube.second_moment)


def test_shear_coefficients_have_the_published_limits() -> None:
    """Cowper (1966): circle 6 (1 + nu) / (7 + 6 nu), thin tube 2 (1 + nu) / (4 + 3 nu), rectangle, thin square."""
    almost_solid = make_section("tube", 1.0, 0.0, 0.4999)
    assert almost_solid.shear_coefficient(POISSON) == pytest.approx(6.0 * 1.3 / 8.8, rel=1e-6)
    thin = make_section("tube", 1.0, 0.0, 1e-5)
    assert thin.shear_coefficient(POISSON) == pytest.approx(2.0 * 1.3 / 4.9, rel=1e-6)
    webs = make_section("box", 1.0, 1e-5, 1e-6)
    assert webs.shear_coefficient(POISSON) == pytest.approx(10.0 * 1.3 / 15.3, rel=1e-3)
    square = make_section("box", 1.0, 1.0, 1e-5)
    assert square.shear_coefficient(POISSON) == pytest.approx(20.0 * 1.3 / (48.0 + 39.0 * POISSON), rel=1e-6)
