# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gimbals: motion, torques and wires against beam theory; limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor_design.gimbals import (
    dither_acceleration,
    gimbal_motion,
    gimbal_torques,
    shortest_wires,
    wire_gimbal,
    yoke_friction,
)
from scipy.integrate import trapezoid

TUBE: dict[str, Any] = {
    "length": 0.762,
    "outside_diameter": 0.0508,
    "inside_diameter": 0.04445,
    "modulus": 70e9,
    "shear_modulus": 26e9,
    "endpoint_error": 1e-6,
    "far_distance": 0.762,
    "near_distance": 0.5,
}
INERTIA = math.pi / 4.0 * (0.0254**4 - 0.022225**4)
WIRES: dict[str, Any] = {
    "wires": 3,
    "lever": 0.03,
    "angle": 0.002,
    "wire_diameter": 5e-4,
    "modulus": 200e9,
    "tension": 50.0,
    "mass": 5.0,
}
YOKE: dict[str, Any] = {
    "beam_length": 0.762,
    "outside_diameter": 0.0508,
    "inside_diameter": 0.04445,
    "modulus": 70e9,
    "density": 2700.0,
    "added_mass": 5.0,
    "yoke_distance": 0.45,
    "acceleration": 20.0,
    "endpoint_error": 1e-6,
}


def test_the_motion_is_that_of_a_cantilever() -> None:
    """Force F on length l: deflection F l^3 / (3 E I), greatest stress F l h / (2 I)."""
    force, length, height, inertia, modulus = 2000.0, 1.5, 0.1, 4e-6, 70e9
    motion = gimbal_motion(length, height, force * length * height / (2.0 * inertia), modulus)
    assert motion.angle == pytest.approx(force * length**2 / (3.0 * modulus * inertia), rel=1e-12)
    place = np.linspace(0.0, length, 2001)
    slope = force / (modulus * inertia) * (length * place - 0.5 * place**2)
    assert motion.shortening == pytest.approx(trapezoid(0.5 * slope**2, place), rel=1e-6)


def test_the_torques_make_the_endpoint_error() -> None:
    torques = gimbal_torques(**TUBE)
    place = np.linspace(0.0, 0.762, 2001)
    # A constant moment; deflections of the beam relative to the line between its ends.
    slope = torques.bending_torque / (70e9 * INERTIA) * (place - 0.381)
    assert slope[-1] * 0.762 - slope[0] * 0.5 == pytest.approx(1e-6, rel=1e-9)
    twist = torques.twisting_torque * 0.762 / (26e9 * 2.0 * INERTIA)
    assert twist * 0.5 == pytest.approx(1e-6, rel=1e-12)


def test_wires_pull_back_with_their_length_on_turning() -> None:
    """The exact length of a turned wire, without the approximation of small angles."""
    length = 0.02
    gimbal = wire_gimbal(**WIRES, wire_length=length)
    side = 0.002 * 0.03
    stretched = math.hypot(length, side)
    area = math.pi * (2.5e-4) ** 2
    force = 50.0 + area * 200e9 * (stretched - length) / length
    assert gimbal.torque == pytest.approx(3 * 0.03 * force * side / stretched, rel=1e-4)
    assert gimbal.stretch_stress == pytest.approx(200e9 * (stretched - length) / length, rel=1e-5)
    assert gimbal.initial_stress == pytest.approx(50.0 / area, rel=1e-12)
    stiffness = area * 200e9 / length
    assert gimbal.natural_frequency == pytest.approx(math.sqrt(stiffness / 2.5), rel=1e-12)


@pytest.mark.parametrize("tension", [0.0, 1e-3, 50.0, 1e6])
@pytest.mark.parametrize("torque", [1e-6, 0.02, 50.0])
def test_the_shortest_wires_have_the_allowed_torque(tension: float, torque: float) -> None:
    gimbal = shortest_wires(**{**WIRES, "tension": tension}, torque=torque)
    assert gimbal.torque == pytest.approx(torque, rel=1e-10)
    assert gimbal == wire_gimbal(**{**WIRES, "tension": tension}, wire_length=gimbal.wire_length)


def test_friction_at_the_limit_makes_the_endpoint_error() -> None:
    friction = yoke_friction(**YOKE)
    beam = 2700.0 * math.pi * (0.0254**2 - 0.022225**2) * 0.762
    assert friction.bearing_load == pytest.approx(0.5 * (5.0 + beam) * 20.0, rel=1e-12)
    assert friction.torque == pytest.approx(friction.friction_radius * friction.bearing_load, rel=1e-12)
    slope = friction.torque * 0.45 / (2.0 * 70e9 * INERTIA)
    assert 4.0 * 0.762 * slope == pytest.approx(1e-6, rel=1e-12)


def test_dither_has_the_acceleration_of_a_sine() -> None:
    time = np.linspace(0.0, 0.1, 100_001)
    position = 1e-3 * np.sin(2.0 * math.pi * time / 0.1)
    acceleration = np.gradient(np.gradient(position, time), time)
    assert dither_acceleration(1e-3, 0.1).acceleration == pytest.approx(acceleration[2:-2].max(), rel=1e-4)
