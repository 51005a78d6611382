# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from posor.model.gap import plane_normal
from posor.model.reading_rows import GAP
from posor_lab.harness.row_builder import read_row


def test_a_gap_is_the_distance_along_a_slanted_axis() -> None:
    slant = math.radians(60.0)
    row = np.array([0.01, 0.02, 0.0, math.sin(slant), 0.0, math.cos(slant), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert read_row(GAP, row, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))) == pytest.approx(0.002, abs=1e-16)


def test_the_tilt_of_the_plane_turns_with_the_target() -> None:
    """A plane raised along Y of T by its tilt about X is raised along -X of R after a quarter turn about Z."""
    tilt = 0.01
    probe_at_minus_x = np.array([-0.05, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, tilt, 0.0, 0.0])
    quarter_turn = pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([0.0, 0.0, 0.001]))
    assert read_row(GAP, probe_at_minus_x, quarter_turn) == pytest.approx(0.001 + 0.05 * math.tan(tilt), abs=1e-15)
    by_parameter = probe_at_minus_x + math.pi / 2.0 * np.eye(12)[11]
    assert read_row(GAP, by_parameter, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))) == pytest.approx(
        0.001 + 0.05 * math.tan(tilt), abs=1e-15
    )


def test_the_normal_is_a_unit_vector_toward_the_probes(rng: np.random.Generator) -> None:
    assert plane_normal(0.0, 0.0, 0.0) == (0.0, 0.0, -1.0)
    for tilt_x, tilt_y, turn in rng.uniform(-1.5, 1.5, (100, 3)):
        expected = (
            pin.utils.rotate("z", turn)
            @ pin.utils.rotate("x", tilt_x)
            @ pin.utils.rotate("y", tilt_y)
            @ np.array([0.0, 0.0, -1.0])
        )
        np.testing.assert_allclose(plane_normal(tilt_x, tilt_y, turn), expected, rtol=0.0, atol=1e-15)
