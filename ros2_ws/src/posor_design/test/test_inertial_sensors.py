# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inertial sensors: limits and drift are inverse to each other, phase of a fibre gyroscope."""

from __future__ import annotations

import math

import pytest
from posor_design.inertial_sensors import fibre_gyroscope, inertial_drift, inertial_limits


def test_the_largest_drift_uses_the_accuracy_up() -> None:
    limits = inertial_limits(25e-6, 2.5, 1800.0)
    drift = inertial_drift(limits.drift_rate, limits.acceleration, 2.5, 1800.0)
    assert drift.gyroscope_error == pytest.approx(25e-6)
    assert drift.accelerometer_error == pytest.approx(25e-6)
    assert drift.angle == pytest.approx(1e-5)


def test_the_earths_rate_has_the_published_phase() -> None:
    """The two beams differ by the path 4 A rate / c (Lefevre, The Fiber-Optic Gyroscope, 2014, chapter 2)."""
    area, rate, wavelength = 100.0 * math.pi * 0.05**2, math.radians(15.041) / 3600.0, 1.55e-6
    path = 4.0 * area * rate / 299792458.0
    assert fibre_gyroscope(area, rate, wavelength).phase == pytest.approx(2.0 * math.pi * path / wavelength)
