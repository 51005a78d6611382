# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sag of accelerated measuring beams, in the simulator and in the chain that corrects it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import ArmFile, load_arm_file
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.pose_array import ArmTruth

FIVE_AXIS = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms" / "five_axis" / "arm.yaml"
PERIOD_NS = 5_000_000
TICKS = np.arange(400, 1200)


@pytest.fixture(scope="module")
def arm() -> ArmFile:
    return load_arm_file(FIVE_AXIS)


def errors(arm: ArmFile, truth: ArmTruth, window_s: float) -> np.ndarray:
    """Return how far the chain is off [m], (n, 3), if every POSOR measures exactly."""
    chain = arm.chain()
    poses = np.array(
        [[pin.SE3ToXYZQUAT(truth.T_parent_child[joint.name][n]) for joint in chain.joints] for n in range(len(TICKS))]
    )
    exact = np.zeros((*poses.shape[:2], 6, 6))
    stamps = np.arange(len(TICKS)) * PERIOD_NS
    found = chain.estimate_all(poses, exact, exact, stamps, acceleration_window=window_s)
    return np.asarray(found.poses[:, :3] - truth.endpoint.translations[: len(TICKS)])


def rms(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))


def test_chain_corrects_the_sag_at_rest(arm: ArmFile) -> None:
    truth = ArmSimulation(arm, Imperfections.only("sag")).truth(TICKS)
    assert np.abs(errors(arm, truth, 0.0)).max() < 5e-9  # of second order: the sag turns the beam against gravity


def test_chain_corrects_the_sag_in_motion_from_the_acceleration(arm: ArmFile) -> None:
    truth = ArmSimulation(arm, Imperfections.only("sag", "inertia")).truth(TICKS)
    uncorrected, corrected = (rms(errors(arm, truth, window_s)[20:]) for window_s in (0.0, 0.05))
    assert uncorrected > 2e-6
    assert corrected < 0.2 * uncorrected
