# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of diodes, converters and angles: values of the thesis, limits in which one noise remains."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor_design.sensor_noise import angle_resolution, converter_resolution, diode_noise

INCH = 0.0254
THESIS: dict[str, float] = {
    "side": 1.25 * INCH,
    "power": 1e-3,
    "responsivity": 0.25,
    "resistance": 1000.0,
    "amplifier_voltage_noise": 10e-9,
    "bandwidth": 1.0 / 400e-6,
}
CONVERTER: dict[str, Any] = {"travel": 0.05 * INCH, "input_range": 1.0, "accuracy": 65e-6}


def test_the_diode_of_the_thesis() -> None:
    found = diode_noise(**THESIS)
    assert found.position_noise / INCH == pytest.approx(4.96e-8, rel=1e-3)
    assert found.resolution / INCH == pytest.approx(2.48e-6, rel=1e-3)
    assert found.bits == pytest.approx(math.log2(1.25 / 2.479e-6), abs=1e-3)


def test_published_noise_currents() -> None:
    """Of 1 kOhm at 300 K: 4.07 nV/Hz^0.5; of 1 A: 0.566 nA/Hz^0.5 (Horowitz and Hill, The Art of Electronics)."""
    found = diode_noise(**{**THESIS, "power": 4.0})  # 1 A
    assert found.thermal_noise * 1000.0 == pytest.approx(4.07e-9, rel=1e-3)
    assert found.shot_noise == pytest.approx(0.566e-9, rel=1e-3)
    assert found.amplifier_noise == pytest.approx(10e-12)


def test_position_noise_falls_with_the_light_as_its_source_says() -> None:
    """Dark: with the light, as fixed noise does. Bright: with its root, as shot noise does."""

    def noise(power: float) -> float:
        return diode_noise(**{**THESIS, "power": power}).position_noise

    assert noise(1e-9) / noise(2e-9) == pytest.approx(2.0, rel=1e-4)
    assert noise(100.0) / noise(200.0) == pytest.approx(math.sqrt(2.0), rel=1e-4)


def test_noise_of_a_simulated_diode() -> None:
    """The position is side / 2 times difference over sum of two currents, each with all three noises."""
    found = diode_noise(**THESIS)
    current = THESIS["power"] * THESIS["responsivity"]
    total = math.hypot(found.thermal_noise, found.amplifier_noise, found.shot_noise) * math.sqrt(THESIS["bandwidth"])
    rng = np.random.default_rng(1)
    one, other = 0.5 * current + rng.normal(scale=total, size=(2, 200_000))
    positions = 0.5 * THESIS["side"] * (one - other) / (one + other)
    assert positions.std() == pytest.approx(found.resolution, rel=0.01)


def test_the_converter_of_the_thesis() -> None:
    found = converter_resolution(**CONVERTER)
    assert found.parts == pytest.approx(15385, abs=1.0)
    assert round(found.bits) == 14
    assert found.step / INCH == pytest.approx(3.25e-6)
    samples = np.random.default_rng(4).random(1_000_000)
    rounded = np.round(samples / 65e-6) * 65e-6
    assert (rounded - samples).std() * 0.05 * INCH == pytest.approx(found.rounding, rel=2e-3)


def test_the_mean_of_samples_lowers_noise_but_not_the_step() -> None:
    one = converter_resolution(**CONVERTER, sample_noise=1e-3)
    many = converter_resolution(**CONVERTER, sample_noise=1e-3, samples=400, sample_time=25e-6)
    assert many.noise == pytest.approx(one.noise / 20.0)
    assert one.noise == pytest.approx(0.05 * INCH * 1e-3)
    assert many.step == one.step
    assert many.time == pytest.approx(10e-3)


def test_angles_of_the_thesis() -> None:
    assert angle_resolution(0.05 / 4096, 5.0).step == pytest.approx(2.44e-6, rel=1e-3)
    assert angle_resolution(1.0, 3.0).noise == pytest.approx(math.sqrt(2.0) * math.atan(1.0 / 3.0))
