"""What the estimator remembers of a motion, and how it goes on from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.core.kernels.memory import (
    BUMP,
    INTERVAL,
    LONGEST_GAP,
    MEMORY,
    RATE,
    SETTINGS,
    THETA,
    VELOCITY,
    carry_on,
    goes_on,
    remember,
    remember_motion,
    theta_of,
    turn_about_z,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

ELAPSED = 0.5e-3


@pytest.fixture
def memory() -> FloatArray:
    """Return what is remembered of a target that has just moved by (1, 2, 3) um and 1 mrad."""
    memory = np.zeros(MEMORY)
    remember(memory, np.eye(3), np.zeros(3))
    memory[THETA] = 0.2
    moved = np.array([1e-6, 2e-6, 3e-6])
    remember_motion(ELAPSED, 0.201, moved, memory)
    remember(memory, np.eye(3), moved)
    memory[THETA], memory[INTERVAL] = 0.201, ELAPSED
    return memory


def carried(memory: FloatArray, elapsed: float, bump: float = 0.0) -> tuple[float, FloatArray]:
    """Return by how much a start is moved on: about Z, and across."""
    settings = np.zeros(SETTINGS)
    settings[BUMP] = bump
    rotation, translation = np.eye(3), np.zeros(3)
    turn_about_z(rotation, 0.3)
    if goes_on(elapsed, memory):
        carry_on(elapsed, settings, memory, rotation, translation)
    return theta_of(rotation) - 0.3, translation


def test_motion_is_rate_and_velocity_since_the_last_pose(memory: FloatArray) -> None:
    assert memory[RATE] == pytest.approx(2.0)
    np.testing.assert_allclose(memory[VELOCITY : VELOCITY + 3], [2e-3, 4e-3, 6e-3])


@pytest.mark.parametrize("scans", [1.0, 2.0, 3.0])
def test_start_goes_on_as_the_target_has_moved(memory: FloatArray, scans: float) -> None:
    turned, moved = carried(memory, scans * ELAPSED)
    assert turned == pytest.approx(scans * 1e-3)
    np.testing.assert_allclose(moved, scans * np.array([1e-6, 2e-6, 3e-6]))


def test_motion_before_a_long_gap_says_nothing(memory: FloatArray) -> None:
    assert carried(memory, 1.01 * LONGEST_GAP * ELAPSED)[0] == pytest.approx(0.0, abs=1e-15)
    assert not carried(memory, 1.01 * LONGEST_GAP * ELAPSED)[1].any()


def test_nothing_is_known_of_the_motion_to_a_pose_that_was_given(memory: FloatArray) -> None:
    memory[INTERVAL] = 0.0
    turned, moved = carried(memory, ELAPSED)
    assert turned == pytest.approx(0.0, abs=1e-15)
    assert not moved.any()


def test_counted_theta_is_turned_on_elsewhere(memory: FloatArray) -> None:
    turned, moved = carried(memory, ELAPSED, bump=math.pi / 32.0)
    assert turned == pytest.approx(0.0, abs=1e-15)
    assert moved.any()
