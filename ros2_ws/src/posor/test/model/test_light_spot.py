# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from posor.model.reading_rows import SPOT_X, SPOT_Y, evaluate_rows, pair_spots
from posor.numerics.compiled import record_view
from posor_lab.harness.row_builder import make_rows, read_row

from .random_rows import random_spot


def test_a_spot_is_where_a_leaning_ray_meets_the_diode() -> None:
    """One millimetre above the diode a ray that leans by 0.1 along X and -0.2 along Y has moved by so much."""
    row = np.array([0.01, 0.02, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.012, 0.025, 0.0, 0.1, -0.2, -1.0, 0.0])
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))
    assert read_row(SPOT_X, row, pose) == pytest.approx(0.002 + 0.0001, abs=1e-16)
    assert read_row(SPOT_Y, row, pose) == pytest.approx(0.005 - 0.0002, abs=1e-16)


def test_coordinates_are_along_the_diodes_own_axes_even_if_these_are_skew() -> None:
    u, v = np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.8, 0.0])
    spot = 0.003 * u - 0.002 * v
    row = np.concatenate([np.zeros(3), u, v, spot, [0.0, 0.0, -1.0, 0.0]])
    pose = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))
    assert read_row(SPOT_X, row, pose) == pytest.approx(0.003, abs=1e-16)
    assert read_row(SPOT_Y, row, pose) == pytest.approx(-0.002, abs=1e-16)


def test_the_length_of_the_direction_has_no_effect_and_those_of_the_axes_scale(rng: np.random.Generator) -> None:
    for _ in range(20):
        row, pose = random_spot(rng)
        longer_ray, longer_u = row.copy(), row.copy()
        longer_ray[12:15] *= 3.0
        longer_u[3:6] *= 2.0
        for which in (SPOT_X, SPOT_Y):
            assert read_row(which, longer_ray, pose) == pytest.approx(read_row(which, row, pose), abs=1e-14)
        assert read_row(SPOT_X, longer_u, pose) == pytest.approx(read_row(SPOT_X, row, pose) / 2.0, abs=1e-14)
        assert read_row(SPOT_Y, longer_u, pose) == pytest.approx(read_row(SPOT_Y, row, pose), abs=1e-14)


def test_the_extra_turn_turns_the_direction_about_z_of_the_target(rng: np.random.Generator) -> None:
    for _ in range(20):
        row, pose = random_spot(rng)
        turned = row.copy()
        turned[12:15] = pin.utils.rotate("z", row[15]) @ row[12:15]
        turned[15] = 0.0
        for which in (SPOT_X, SPOT_Y):
            assert read_row(which, turned, pose) == pytest.approx(read_row(which, row, pose), abs=1e-14)


def test_a_pair_of_rows_reads_as_its_rows_do(rng: np.random.Generator) -> None:
    row, pose = random_spot(rng)
    rows = make_rows([SPOT_X, SPOT_Y], [row, row])
    alone = evaluate_rows(rows, pose.rotation, pose.translation)
    pair_spots(record_view(rows), 2)
    paired = evaluate_rows(rows, pose.rotation, pose.translation)
    for found, expected in zip(paired, alone, strict=True):
        np.testing.assert_array_equal(found, expected)
