# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Hertz contact against published closed forms and tables; limits."""

from __future__ import annotations

import math
from typing import Any

import pytest
from posor_design.contact import ball_race_contact, hertz_contact

STEEL = {"modulus": 206e9, "poisson_ratio": 0.3, "other_modulus": 206e9, "other_poisson_ratio": 0.3}
CONTACT_MODULUS = 206e9 / (2.0 * (1.0 - 0.3**2))


def test_a_sphere_on_a_plane_has_the_closed_form() -> None:
    """Johnson, Contact Mechanics, 4.22 to 4.24."""
    load, radius = 10.0, 0.004
    contact = hertz_contact(load, 1.0 / radius, 1.0 / radius, **STEEL)
    half_axis = math.cbrt(3.0 * load * radius / (4.0 * CONTACT_MODULUS))
    assert contact.large_half_axis == pytest.approx(half_axis, rel=1e-12)
    assert contact.small_half_axis == contact.large_half_axis
    stress = math.cbrt(6.0 * load * CONTACT_MODULUS**2 / (math.pi**3 * radius**2))
    assert contact.stress == pytest.approx(stress, rel=1e-12)
    assert contact.approach == pytest.approx(half_axis**2 / radius, rel=1e-12)
    assert contact.shear_stress / contact.stress == pytest.approx(0.31, abs=5e-3)
    assert contact.shear_depth / half_axis == pytest.approx(0.48, abs=5e-3)


def test_a_ball_in_a_conforming_socket_has_the_closed_form() -> None:
    """Roark's Formulas for Stress and Strain, table 14.1, case 1c: a ball of D2 in a socket of D1."""
    load, ball, socket = 10.0, 0.01, 0.0102
    contact = hertz_contact(load, 2.0 / ball - 2.0 / socket, 2.0 / ball - 2.0 / socket, **STEEL)
    k_d = ball * socket / (socket - ball)
    roark = 0.918 * math.cbrt(load / (k_d**2 * (2.0 * (1.0 - 0.3**2) / 206e9) ** 2))
    assert contact.stress == pytest.approx(roark, rel=1e-3)


def test_the_stress_under_a_sphere_has_the_closed_form() -> None:
    """Johnson, Contact Mechanics, 3.45: stresses along the axis; the greatest shear stress is half of their greatest
    difference."""
    for poisson_ratio in (0.2, 0.3, 0.4):
        contact = hertz_contact(10.0, 100.0, 100.0, 206e9, poisson_ratio, 70e9, 0.33)

        def shear(depth: float, nu: float = poisson_ratio) -> float:
            radial = -(1.0 + nu) * (1.0 - depth * math.atan(1.0 / depth)) + 0.5 / (1.0 + depth**2)
            return abs(0.5 * (radial + 1.0 / (1.0 + depth**2)))

        depths = [0.2 + 0.0001 * index for index in range(8000)]
        assert contact.shear_stress / contact.stress == pytest.approx(max(map(shear, depths)), rel=1e-6)
        assert contact.shear_depth / contact.small_half_axis == pytest.approx(max(depths, key=shear), abs=2e-4)


def test_a_long_ellipse_has_the_stress_of_parallel_cylinders() -> None:
    """Johnson, Contact Mechanics, 4.43 to 4.45: p0 = sqrt(P E* / (pi R)) with P the force over the length."""
    contact = hertz_contact(10.0, 500.0, 0.002, **STEEL)
    # The local force over the length of an elliptic contact is 3/2 of the mean, with the shape of an ellipse.
    force_per_length = 0.5 * math.pi * contact.stress * contact.small_half_axis
    assert contact.stress == pytest.approx(math.sqrt(force_per_length * CONTACT_MODULUS * 500.0 / math.pi), rel=1e-3)
    assert contact.shear_stress / contact.stress == pytest.approx(0.30, abs=2e-3)
    assert contact.shear_depth / contact.small_half_axis == pytest.approx(0.786, abs=2e-3)


@pytest.mark.parametrize(
    ("curvature_difference", "large", "small", "approach"),
    [
        (0.1075, 1.0760, 0.9318, 0.9974),
        (0.4795, 1.4556, 0.7278, 0.9429),
        (0.7332, 2.011, 0.5881, 0.8394),
        (0.90999, 3.233, 0.4499, 0.6636),
        (0.97290, 5.267, 0.3490, 0.4960),
    ],
)
def test_ellipses_agree_with_the_table_of_harris(
    curvature_difference: float, large: float, small: float, approach: float
) -> None:
    """Harris, Rolling Bearing Analysis (2001), table 6.1: dimensionless half axes and approach, 4 digits."""
    load, curvature_sum = 100.0, 800.0
    x, y = (0.5 * curvature_sum * (1.0 + sign * curvature_difference) for sign in (1.0, -1.0))
    contact = hertz_contact(load, x, y, **STEEL)
    unit = math.cbrt(3.0 * load / (2.0 * curvature_sum * CONTACT_MODULUS))
    assert contact.large_half_axis / unit == pytest.approx(large, rel=1e-3)
    assert contact.small_half_axis / unit == pytest.approx(small, rel=1e-3)
    assert contact.approach / (unit**2 * curvature_sum / 2.0) == pytest.approx(approach, rel=1e-3)


def test_directions_may_be_exchanged_and_the_stress_grows_with_the_cube_root_of_the_load() -> None:
    assert hertz_contact(10.0, 500.0, 40.0, **STEEL) == hertz_contact(10.0, 40.0, 500.0, **STEEL)
    light, heavy = (hertz_contact(load, 500.0, 40.0, **STEEL) for load in (10.0, 80.0))
    assert heavy.stress == pytest.approx(2.0 * light.stress, rel=1e-12)
    assert heavy.approach == pytest.approx(4.0 * light.approach, rel=1e-12)


def test_the_shear_stress_of_a_long_contact_without_lateral_strain_is_at_the_surface() -> None:
    contact = hertz_contact(10.0, 500.0, 0.002, 206e9, 0.0, 206e9, 0.0)
    assert contact.shear_depth < 1e-4 * contact.small_half_axis
    assert contact.shear_stress / contact.stress == pytest.approx(0.5, abs=1e-3)


BEARING: dict[str, Any] = {
    "load": 9.8,
    "ball_diameter": 0.004,
    "pitch_diameter": 0.0159,
    "conformity": 0.52,
    "ball_modulus": 206e9,
    "ball_poisson_ratio": 0.3,
    "race_modulus": 206e9,
    "race_poisson_ratio": 0.3,
}


def test_the_races_of_a_bearing_have_the_curvatures_of_harris() -> None:
    """Harris, Rolling Bearing Analysis (2001), 2.28 and 2.30: sums of the curvatures for contact angle 0."""
    gamma = BEARING["ball_diameter"] / BEARING["pitch_diameter"]
    inner, outer = (ball_race_contact(**BEARING, race="inner"), ball_race_contact(**BEARING, race="outer"))
    for contact, side in ((inner, 1.0), (outer, -1.0)):
        rolling = 2.0 / BEARING["ball_diameter"] * (1.0 + side * gamma / (1.0 - side * gamma))
        across = (2.0 - 1.0 / BEARING["conformity"]) / BEARING["ball_diameter"]
        expected = hertz_contact(9.8, rolling, across, **STEEL)
        assert contact.stress == pytest.approx(expected.stress, rel=1e-12)
    assert inner.stress > outer.stress
