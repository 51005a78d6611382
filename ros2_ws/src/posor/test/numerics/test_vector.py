# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from posor.numerics import vector
from posor.numerics.array_types import FloatArray
from scipy.linalg import expm


def test_a_vector_is_three_entries_of_an_array() -> None:
    assert vector.at(np.arange(6.0), 2) == (2.0, 3.0, 4.0)


def test_vector_algebra_is_that_of_numpy(rng: np.random.Generator) -> None:
    for pair in rng.normal(size=(100, 2, 3)):
        a, b = vector.at(pair[0], 0), vector.at(pair[1], 0)
        assert vector.dot(a, b) == pytest.approx(float(pair[0] @ pair[1]), rel=1e-14, abs=1e-15)
        np.testing.assert_allclose(vector.cross(a, b), np.cross(*pair), rtol=1e-14, atol=1e-15)
        assert vector.plus(a, b) == tuple(pair[0] + pair[1])
        assert vector.minus(a, b) == tuple(pair[0] - pair[1])
        assert vector.times(3.0, a) == tuple(3.0 * pair[0])


def test_rotate_and_rotate_back_are_products_with_the_matrix_and_its_transpose(
    rng: np.random.Generator, random_rotation: Callable[[], FloatArray]
) -> None:
    for entries in rng.normal(size=(100, 3)):
        rotation, a = random_rotation(), vector.at(entries, 0)
        np.testing.assert_allclose(vector.rotate(rotation, a), rotation @ entries, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(vector.rotate_back(rotation, a), rotation.T @ entries, rtol=0.0, atol=1e-15)


def test_turned_is_a_turn_about_z(rng: np.random.Generator) -> None:
    for angle in (0.0, *rng.uniform(-7.0, 7.0, 50)):
        entries = rng.normal(size=3)
        expected = pin.utils.rotate("z", angle) @ entries
        np.testing.assert_allclose(vector.rotated_about_z(vector.at(entries, 0), angle), expected, rtol=0.0, atol=1e-15)


def random_step(angle: float, rng: np.random.Generator) -> FloatArray:
    axis = rng.normal(size=3)
    return np.concatenate([rng.uniform(-0.1, 0.1, 3), angle * axis / np.linalg.norm(axis)])


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 9e-5, 9.999e-5, 3e-3, 0.1, 1.0, 3.0, np.pi])
def test_apply_tangent_is_exp6_of_pinocchio(
    angle: float, rng: np.random.Generator, random_rotation: Callable[[], FloatArray]
) -> None:
    for _ in range(50):
        step = random_step(angle, rng)
        rotation, translation = random_rotation(), rng.uniform(-0.1, 0.1, 3)
        expected = pin.SE3(rotation, translation) * pin.exp6(step)
        vector.apply_tangent(rotation, translation, step)
        np.testing.assert_allclose(rotation, expected.rotation, rtol=0.0, atol=2e-15)
        np.testing.assert_allclose(translation, expected.translation, rtol=0.0, atol=2e-15)


def test_apply_tangent_keeps_its_digits_where_the_series_ends(rng: np.random.Generator) -> None:
    """Against the exponential of the 4x4 matrix, since pinocchio's own series ends near here too."""
    for angle in rng.uniform(0.9e-4, 3e-4, 200):
        step = random_step(angle, rng)
        rotation, translation = np.eye(3), np.zeros(3)
        vector.apply_tangent(rotation, translation, step)
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = pin.skew(step[3:]), step[:3]
        expected = expm(twist)
        np.testing.assert_allclose(rotation, expected[:3, :3], rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(translation, expected[:3, 3], rtol=0.0, atol=1e-16)


def test_orthonormalise_takes_rounding_away(
    rng: np.random.Generator, random_rotation: Callable[[], FloatArray]
) -> None:
    for error in (1e-15, 1e-10, 1e-6):
        for _ in range(50):
            rotation = random_rotation() + error * rng.uniform(-1.0, 1.0, (3, 3))
            left, _, right = np.linalg.svd(rotation)
            nearest = left @ right
            vector.orthonormalise(rotation)
            # One Newton step: what is left is of the square of the error.
            np.testing.assert_allclose(rotation, nearest, rtol=0.0, atol=10.0 * error**2 + 5e-15)


def test_orthonormalise_keeps_a_pose_orthonormal_over_a_day_of_scans(rng: np.random.Generator) -> None:
    rotation, translation = np.eye(3), np.zeros(3)
    for step in rng.normal(scale=0.02, size=(20_000, 6)):
        vector.apply_tangent(rotation, translation, step)
        vector.orthonormalise(rotation)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), rtol=0.0, atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-15)
