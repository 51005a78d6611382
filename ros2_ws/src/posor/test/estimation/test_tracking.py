# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the tracker keeps of a motion, and how it predicts the next pose."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from posor.estimation.tracking import LONGEST_GAP, predict, turn_about_z, update_tracker
from posor.estimation.workspace import WORKSPACE
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import record_view
from posor.numerics.vector import theta_of

ELAPSED = 0.5e-3
MOVED = np.array([1e-6, 2e-6, 3e-6])


@pytest.fixture
def workspace() -> Any:
    """Return the workspace of a target that has just moved by (1, 2, 3) um and 1 mrad."""
    workspace = record_view(np.zeros(1, dtype=WORKSPACE))[0]
    tracker, pose = workspace["tracker"], workspace["pose"]
    pose["rotation"], pose["translation"] = np.eye(3), 0.0
    update_tracker(tracker, pose, 0.2, math.nan)
    pose["translation"] = MOVED
    update_tracker(tracker, pose, 0.201, ELAPSED)
    return workspace


def predicted(workspace: Any, elapsed: float, bump: float = 0.0) -> tuple[float, FloatArray]:
    """Return by how much a start is moved on: about Z, and across."""
    workspace["settings"]["bump_angle"] = bump
    pose = workspace["pose"]
    pose["rotation"], pose["translation"] = np.eye(3), 0.0
    turn_about_z(pose["rotation"], 0.3)
    predict(workspace["settings"], workspace["tracker"], elapsed, pose)
    return theta_of(np.ascontiguousarray(pose["rotation"])) - 0.3, pose["translation"].copy()


def test_motion_is_rate_and_velocity_since_the_previous_pose(workspace: Any) -> None:
    assert workspace["tracker"]["theta_rate"] == pytest.approx(2.0)
    np.testing.assert_allclose(workspace["tracker"]["velocity"], [2e-3, 4e-3, 6e-3])


@pytest.mark.parametrize("scans", [1.0, 2.0, 3.0])
def test_a_start_moves_on_as_the_target_has_moved(workspace: Any, scans: float) -> None:
    turned, moved = predicted(workspace, scans * ELAPSED)
    assert turned == pytest.approx(scans * 1e-3)
    np.testing.assert_allclose(moved, scans * MOVED)


@pytest.mark.parametrize("start_is_given", [False, True])
def test_motion_before_a_long_gap_or_to_a_given_start_is_unknown(workspace: Any, *, start_is_given: bool) -> None:
    if start_is_given:
        update_tracker(workspace["tracker"], workspace["pose"], 0.201, math.nan)
    turned, moved = predicted(workspace, ELAPSED if start_is_given else 1.01 * LONGEST_GAP * ELAPSED)
    assert turned == pytest.approx(0.0, abs=1e-15)
    assert not moved.any()


def test_a_counted_theta_is_predicted_with_the_start(workspace: Any) -> None:
    turned, moved = predicted(workspace, ELAPSED, bump=math.pi / 32.0)
    assert turned == pytest.approx(0.0, abs=1e-15)
    assert moved.any()
