# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from posor.model.native_coordinates import native_from_rotation, native_jacobian, rotation_from_native
from posor.numerics.array_types import FloatArray

LEAN = 0.06  # rad, more than a POSOR's gaps allow


def test_native_coordinates_come_back_from_the_rotation_over_full_turns(rng: np.random.Generator) -> None:
    for _ in range(500):
        alpha, beta = rng.uniform(-LEAN, LEAN, 2)
        theta = rng.uniform(-math.pi, math.pi)
        back = native_from_rotation(rotation_from_native(alpha, beta, theta))
        np.testing.assert_allclose(back, (alpha, beta, theta), rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("theta", [-3.0 * math.pi, -math.pi, 0.0, math.pi / 2.0, math.pi, 2.0 * math.pi, 7.0])
def test_theta_is_the_same_heading_whatever_turns_it_counts(theta: float) -> None:
    back = native_from_rotation(rotation_from_native(0.01, -0.02, theta))
    assert math.remainder(back[2] - theta, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-15)
    assert -math.pi <= back[2] <= math.pi


def test_the_rotation_is_a_rotation_and_comes_back_from_its_native_coordinates(rng: np.random.Generator) -> None:
    for _ in range(500):
        lean = np.array([*rng.uniform(-LEAN, LEAN, 2), 0.0])
        rotation = pin.exp3(lean) @ pin.utils.rotate("z", rng.uniform(-math.pi, math.pi))
        back = rotation_from_native(*native_from_rotation(rotation))
        np.testing.assert_allclose(back, rotation, rtol=0.0, atol=1e-15)


def test_alpha_and_beta_are_the_lean_of_z_about_x_and_y_of_the_receiving_plate(rng: np.random.Generator) -> None:
    for alpha, beta, theta in rng.uniform(-1.0, 1.0, (200, 3)) * (LEAN, LEAN, math.pi):
        rotation = rotation_from_native(alpha, beta, theta)
        leaned = pin.utils.rotate("y", beta) @ pin.utils.rotate("x", alpha) @ np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(rotation[:, 2], leaned, rtol=0.0, atol=1e-15)


def test_theta_is_the_heading_of_the_y_axis_in_the_xy_plane_of_the_receiving_plate(rng: np.random.Generator) -> None:
    for alpha, beta, theta in rng.uniform(-1.0, 1.0, (200, 3)) * (LEAN, LEAN, math.pi):
        y = rotation_from_native(alpha, beta, theta)[:, 1]
        heading = math.atan2(-y[0], y[1])  # zero along Y of R, positive toward -X
        assert math.remainder(heading - theta, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-15)


def test_rounding_beyond_a_right_angle_is_no_error() -> None:
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0 - 1e-15], [0.0, 1.0, 0.0]])
    assert native_from_rotation(rotation)[0] == math.pi / 2.0


def test_derivatives_by_a_small_turn(
    rng: np.random.Generator, central_difference: Callable[[Callable[[FloatArray], float], int], FloatArray]
) -> None:
    for alpha, beta, theta in rng.uniform(-1.0, 1.0, (20, 3)) * (LEAN, LEAN, math.pi):
        rotation = rotation_from_native(alpha, beta, theta)

        def turned(turn: FloatArray, at: int, rotation: FloatArray = rotation) -> float:
            return native_from_rotation(pin.exp3(turn) @ rotation)[at]

        found = [central_difference(lambda turn, at=at: turned(turn, at), 3) for at in range(3)]  # type: ignore[misc]
        np.testing.assert_allclose(native_jacobian(rotation), found, rtol=0.0, atol=1e-9)
