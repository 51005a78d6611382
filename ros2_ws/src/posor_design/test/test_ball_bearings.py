# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ball bearings: loads of balls, scaling, and friction tests."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor_design.ball_bearings import ball_load, bearing_friction, bearing_scaling
from posor_design.contact import hertz_contact

TEST: dict[str, Any] = {
    "deflections": (1.0e-3, 1.3e-3, 1.1e-3),
    "spring_length": 0.05,
    "spring_width": 0.012,
    "spring_thickness": 2.5e-4,
    "modulus": 200e9,
    "thrust": 90.0,
    "allowed_friction_radius": 2e-4,
}


@pytest.mark.parametrize("balls", [7, 12, 31])
def test_the_load_of_a_ball_agrees_with_the_sum_over_all_balls(balls: int) -> None:
    """Without clearance each ball of the loaded half carries the power 3/2 of the cosine of its angle."""
    sums = []
    for start in np.linspace(0.0, 2.0 * math.pi / balls, 101):
        cosine = np.maximum(np.cos(start + np.arange(balls) * 2.0 * math.pi / balls), 0.0)
        sums.append(1.0 / np.sum(cosine**2.5))
    assert ball_load(100.0, balls).tight_ball_load == pytest.approx(100.0 * np.mean(sums), rel=0.01)
    assert ball_load(100.0, balls).ball_load == pytest.approx(500.0 / balls, rel=1e-12)


def test_two_balls_carry_the_load_together() -> None:
    assert 2.0 * ball_load(100.0, 7).two_ball_load * math.cos(math.pi / 7) == pytest.approx(100.0, rel=1e-12)


def test_the_stress_scales_as_that_of_a_hertz_contact() -> None:
    rated, light = (hertz_contact(load, 500.0, 40.0, 200e9, 0.3, 200e9, 0.3) for load in (300.0, 17.0))
    scaled = bearing_scaling(17.0, 300.0, rated.stress)
    assert scaled.stress == pytest.approx(light.stress, rel=1e-12)
    assert scaled.relative_life == pytest.approx((rated.stress / light.stress) ** 9, rel=1e-9)
    assert bearing_scaling(300.0, 300.0, 2e9).relative_life == 1.0


def test_friction_is_the_moment_of_the_spring_over_the_thrust() -> None:
    friction = bearing_friction(**TEST)
    inertia = 0.012 * 2.5e-4**3 / 12.0
    radii = [3.0 * 200e9 * inertia * deflection / 0.05**3 * 0.05 / 90.0 for deflection in TEST["deflections"]]
    assert friction.friction_radius == pytest.approx(np.mean(radii), rel=1e-12)
    assert friction.standard_deviation == pytest.approx(np.std(radii, ddof=1), rel=1e-12)
    assert friction.standard_uncertainty == pytest.approx(np.std(radii, ddof=1) / math.sqrt(3.0), rel=1e-12)
    assert friction.largest_share == pytest.approx(max(radii) / 2e-4, rel=1e-12)
