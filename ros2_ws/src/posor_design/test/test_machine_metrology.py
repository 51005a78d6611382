# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of stages and setups: values of the thesis, exact geometry, finite differences."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from posor_design.machine_metrology import (
    abbe_error,
    alignment,
    probe_zero,
    straightness,
    straightness_runs,
    thermal_growth,
)

INCH = 0.0254
UIN = 1e-6 * INCH
ARCSEC = math.radians(1.0 / 3600.0)


def test_straightness_takes_the_line_away() -> None:
    x = np.linspace(0.0, 0.75 * INCH, 16)
    wave = 200.0 * UIN * np.sin(math.tau * x / x[-1])
    found = straightness(tuple(x), tuple(-300.0 * UIN + 0.0127 * x + wave))
    level = straightness(tuple(x + 5.0), tuple(wave))
    assert found.slope - level.slope == pytest.approx(0.0127)
    assert found.least_squares == pytest.approx(level.least_squares)
    assert found.minimum_zone == pytest.approx(level.minimum_zone)
    assert found.deviation == pytest.approx(level.deviation)
    slope, intercept = np.polyfit(x, wave, 1)
    assert found.intercept == pytest.approx(-300.0 * UIN + intercept)
    assert found.least_squares == pytest.approx(np.ptp(wave - slope * x - intercept))


def test_the_minimum_zone_is_the_narrowest_of_all_edges() -> None:
    """Chetwynd (1979): one side of the zone holds two of the points, the other the farthest point from this edge."""
    rng = np.random.default_rng(3)
    x, y = np.linspace(0.0, 1.0, 12), 1e-6 * rng.normal(size=12)
    widths = [
        np.ptp(residuals)
        for i, j in combinations(range(12), 2)
        for residuals in (y - (y[j] - y[i]) / (x[j] - x[i]) * x,)
    ]
    found = straightness(tuple(x), tuple(y))
    assert found.minimum_zone == pytest.approx(min(widths), rel=1e-9)
    assert found.minimum_zone <= found.least_squares


def test_runs() -> None:
    found = straightness_runs((0.0, 1e-6), (0.01, 0.0101), (4e-6, 6e-6), 0.02)
    assert found.mean_deviation == pytest.approx(5e-6)
    assert found.deviation_scatter == pytest.approx(math.sqrt(2.0) * 1e-6)
    assert found.mean_slope == pytest.approx(0.01005)
    assert found.spread == pytest.approx(1e-6 + 0.02 * 1e-4)
    crossing = straightness_runs((0.0, 5e-6), (0.0101, 0.01), (4e-6, 6e-6), 0.02)
    assert crossing.spread == pytest.approx(5e-6)  # the lines lie farthest apart at the start


def test_alignment_of_the_thesis() -> None:
    found = alignment((0.001, 0.002, 0.005), 0.625 * INCH)
    assert found.angle == pytest.approx(0.005477, rel=1e-4)
    assert found.cosine_error / UIN == pytest.approx(9.375, rel=1e-4)
    assert alignment((0.002, 0.002), 0.0).angle == pytest.approx(0.0028284, rel=1e-4)


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 0.1, -0.1])
def test_alignment_is_exact_geometry(angle: float) -> None:
    found = alignment((angle,), 2.0)
    assert (2.0 - found.cosine_error) ** 2 + found.lateral_error**2 == pytest.approx(4.0, rel=1e-15)
    assert found.cosine_error == pytest.approx(angle**2, rel=2e-3)  # 2 (1 - cos), also where cos is 1 to all digits


def test_abbe_and_growth_of_the_thesis() -> None:
    assert abbe_error(2.0 * INCH, 25e-6).error / UIN == pytest.approx(50.0)
    assert abbe_error(-2.0 * INCH, 5.0 * ARCSEC).error / UIN == pytest.approx(-48.48, rel=1e-3)
    assert thermal_growth(10.0 * INCH, 10.8e-6, 0.1 / 1.8).growth / UIN == pytest.approx(6.0)


COEFFICIENTS = (-0.0061186, -0.0537874, -0.0013568, -0.0125008, 0.0040221)  # probe 1, table 7.10 [inch]


def test_the_zero_of_the_thesis() -> None:
    found = probe_zero(tuple(INCH * value for value in COEFFICIENTS), 0.1, 0.8, 0.001 * INCH, 0.05 * INCH)
    assert found.zero_error == pytest.approx(0.02)
    assert abs(found.motion_error) / UIN == pytest.approx(350.4, abs=0.1)


def test_a_small_error_of_the_zero_acts_by_the_difference_of_the_slopes() -> None:
    def slope(voltage: float) -> float:
        return sum(power * value * voltage ** (power - 1) for power, value in enumerate(COEFFICIENTS) if power)

    found = probe_zero(COEFFICIENTS, 0.1, 0.8, 1e-7, 1.0)
    assert found.motion_error == pytest.approx(1e-7 * (slope(0.8) - slope(0.1)), rel=1e-5)


def test_the_zero_of_a_straight_line_does_not_matter() -> None:
    found = probe_zero((0.1, -0.05), 0.1, 0.8, 1e-3, -0.05)
    assert found.motion == pytest.approx(-0.035)
    assert found.motion_error == pytest.approx(0.0, abs=1e-17)
    assert found.zero_error == pytest.approx(-0.02)
