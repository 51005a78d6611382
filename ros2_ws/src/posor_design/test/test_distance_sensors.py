# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fibre lever, capacitance probe, area and linearity: independent integrals, limits, finite differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor_design.distance_sensors import capacitance_probe, fibre_lever, linearity, probe_area
from scipy.constants import epsilon_0
from scipy.integrate import dblquad

LEVER: dict[str, Any] = {"core_radius": 1e-4, "spacing": 2.5e-4, "half_angle": math.radians(30.0)}
PROBE: dict[str, Any] = {"gap": 5e-4, "radius": 3e-3}


@pytest.mark.parametrize("distance", [6e-5, 1.2e-4, 2e-4, 6e-4])
def test_the_collected_light_is_the_share_of_rays_that_hit_a_core(distance: float) -> None:
    rng = np.random.default_rng(2)
    radius = LEVER["core_radius"] + 2.0 * distance * math.tan(LEVER["half_angle"])
    place = radius * np.sqrt(rng.random(400_000)) * np.exp(2j * np.pi * rng.random(400_000))
    cores = LEVER["spacing"] * np.exp(2j * np.pi * np.arange(6) / 6.0)
    hits = sum(np.abs(place - core) < LEVER["core_radius"] for core in cores)
    assert fibre_lever(distance, **LEVER, reflectivity=0.8).collected == pytest.approx(0.8 * np.mean(hits), rel=0.01)


@pytest.mark.parametrize("distance", [6e-5, 1.2e-4, 1.8e-4, 2.5e-4, 1e-3])
def test_the_slope_is_the_derivative(distance: float) -> None:
    step = 1e-9
    above, below = (fibre_lever(distance + s, **LEVER).collected for s in (step, -step))
    assert fibre_lever(distance, **LEVER).slope == pytest.approx((above - below) / (2.0 * step), rel=1e-5)


def test_dead_distance_peak_and_far_field() -> None:
    found = fibre_lever(0.0, **LEVER)
    assert found.collected == found.slope == 0.0
    assert fibre_lever(found.dead_distance * 0.999, **LEVER).collected == 0.0
    assert fibre_lever(found.dead_distance * 1.001, **LEVER).collected > 0.0
    curve = [fibre_lever(z, **LEVER).collected for z in np.linspace(0.0, 1e-3, 2001)]
    assert max(curve) <= found.peak_collected
    assert max(curve) == pytest.approx(found.peak_collected, rel=1e-5)
    assert fibre_lever(found.peak_distance, **LEVER).slope == pytest.approx(0.0, abs=1e-6 * found.peak_collected / 1e-4)
    far = fibre_lever(0.1, **LEVER)
    assert far.collected == pytest.approx(6.0 * (1e-4 / far.illuminated_radius) ** 2)


def test_a_guarded_probe_is_a_plane_capacitor() -> None:
    found = capacitance_probe(**PROBE, permittivity=1.0, capacitance_resolution=1e-18)
    assert found.capacitance == pytest.approx(epsilon_0 * math.pi * 3e-3**2 / 5e-4)
    assert found.resolution == pytest.approx(5e-4 * 1e-18 / found.capacitance)
    assert found.tilt_error == found.permittivity_error == 0.0


@pytest.mark.parametrize("edge", ["guarded", "free"])
def test_the_slope_of_the_capacitance_is_its_derivative(edge: Any) -> None:
    step = 1e-9
    above, below = (capacitance_probe(5e-4 + s, 3e-3, edge=edge).capacitance for s in (step, -step))
    assert capacitance_probe(**PROBE, edge=edge).slope == pytest.approx((above - below) / (2.0 * step), rel=1e-7)


def love_capacitance(radius: float, gap: float) -> float:
    """Return the exact capacitance of a free disc before a plane in vacuum, by the integral equation of Love (1949)."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    ratio = 2.0 * gap / radius  # the image of the disc lies behind the plane
    kernel = ratio / math.pi / (ratio**2 + (nodes[:, None] - nodes) ** 2)
    density = np.linalg.solve(np.eye(len(nodes)) - kernel * weights, np.ones(len(nodes)))
    return float(4.0 * epsilon_0 * radius * weights @ density)


@pytest.mark.parametrize(("share", "accuracy"), [(0.02, 2e-4), (0.05, 1e-3), (0.1, 4e-3), (0.2, 0.015)])
def test_a_free_disc_agrees_with_the_equation_of_love(share: float, accuracy: float) -> None:
    found = capacitance_probe(share * 3e-3, 3e-3, permittivity=1.0, edge="free")
    assert found.capacitance == pytest.approx(love_capacitance(3e-3, share * 3e-3), rel=accuracy)


def test_the_error_of_a_tilt_is_that_of_the_integral_over_the_disc() -> None:
    radius, gap, tilt = 3e-3, 5e-4, math.radians(4.0)
    inverse, _ = dblquad(
        lambda _, x: 1.0 / (gap + x * math.tan(tilt)),
        -radius,
        radius,
        lambda x: -math.sqrt(radius**2 - x**2),
        lambda x: math.sqrt(radius**2 - x**2),
    )
    read = math.pi * radius**2 / inverse
    assert capacitance_probe(**PROBE, tilt=tilt).tilt_error == pytest.approx(read - gap, rel=1e-6)
    assert capacitance_probe(**PROBE, tilt=-tilt).tilt_error == capacitance_probe(**PROBE, tilt=tilt).tilt_error
    small = 1e-3
    expected = -((radius * small) ** 2) / (4.0 * gap)
    assert capacitance_probe(**PROBE, tilt=small).tilt_error == pytest.approx(expected, rel=1e-4)


def test_a_denser_medium_looks_like_a_smaller_gap() -> None:
    found = capacitance_probe(**PROBE, permittivity=1.0, permittivity_change=1e-4)
    assert found.permittivity_error == pytest.approx(-5e-4 * 1e-4)


def disc_mean(function: Any, radius: float) -> float:
    """Return the mean of a function of the position over a disc, by Gauss nodes along the axis."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    chords = np.sqrt(1.0 - nodes**2)
    return float(weights @ (chords * function(radius * nodes)) / (weights @ chords))


@pytest.mark.parametrize("radius", [1e-3, 4e-3, 8e-3])
def test_the_curvature_error_is_the_mean_height_of_a_cylinder(radius: float) -> None:
    height = disc_mean(lambda x: 0.04 - np.sqrt(0.04**2 - x**2), radius)
    assert probe_area(radius, 0.04, 0.02).curvature_error == pytest.approx(height, rel=3e-4)


@pytest.mark.parametrize("wavelength", [0.003, 0.006, 0.1])
def test_the_amplitude_ratio_is_the_mean_of_a_wave(wavelength: float) -> None:
    mean = disc_mean(lambda x: np.cos(math.tau * x / wavelength), 0.002)
    assert probe_area(0.002, 0.04, wavelength).amplitude_ratio == pytest.approx(mean, abs=1e-4)


def test_a_small_probe_shows_every_bump() -> None:
    found = probe_area(1e-6, 0.04, 0.02)
    assert found.amplitude_ratio == pytest.approx(1.0)
    assert found.curvature_error < 1e-11


def test_linearity_of_a_parabola() -> None:
    """y = x^2 on -1 to 1: the narrowest band has half the width 1/2; fewer points do not change it."""
    x = np.linspace(-1.0, 1.0, 201)
    found = linearity(tuple(x), tuple(1e-3 * (3.0 * x + x**2)))
    assert found.sensitivity == pytest.approx(3e-3)
    assert found.linearity == pytest.approx(0.5e-3)
    assert found.largest_deviation == pytest.approx(np.abs(x**2 - np.mean(x**2)).max() * 1e-3)
    assert found.deviation == pytest.approx(1e-3 * math.sqrt(np.sum((x**2 - np.mean(x**2)) ** 2) / 199.0))
    assert found.relative_linearity == pytest.approx(0.5 / (np.ptp(3.0 * x + x**2)))


def test_a_straight_line_is_linear() -> None:
    found = linearity((0.0, 1.0, 2.0, 5.0), (1.0, 3.0, 5.0, 11.0))
    assert found.sensitivity == pytest.approx(2.0)
    assert found.linearity == pytest.approx(0.0, abs=1e-14)
