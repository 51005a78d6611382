"""Measuring beams weigh more when they are lifted fast: in the simulator, and in the chain that corrects for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor_drivers.simulator.arm import ArmSimulation, ArmTruth
from posor_drivers.simulator.switches import Switches
from posor_estimator.core.arm import Arm, load_arm

FIVE_AXIS = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms" / "five_axis" / "arm.yaml"
PERIOD_NS = 5_000_000
TICKS = np.arange(400, 1200)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm(FIVE_AXIS)


def errors(arm: Arm, truth: ArmTruth, window_s: float) -> np.ndarray:
    """Return how far the chain is off [m], (n, 3), if every POSOR measures exactly."""
    chain = arm.chain()
    poses = np.array(
        [[pin.SE3ToXYZQUAT(truth.T_parent_child[joint.name][n]) for joint in chain.joints] for n in range(len(TICKS))]
    )
    exact = np.zeros((*poses.shape[:2], 6, 6))
    stamps = np.arange(len(TICKS)) * PERIOD_NS
    found = chain.endpoints(poses, exact, stamps, acceleration_window=window_s)
    return np.asarray(found.poses[:, :3] - truth.endpoint.translations[: len(TICKS)])


def rms(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(vectors), axis=1))))


def test_at_rest_the_chain_corrects_the_whole_sag(arm: Arm) -> None:
    truth = ArmSimulation(arm, Switches.only("sag")).truth(TICKS)
    assert np.abs(errors(arm, truth, 0.0)).max() < 5e-9  # of second order: the sag turns the beam against gravity


def test_in_motion_it_does_once_it_knows_the_acceleration(arm: Arm) -> None:
    truth = ArmSimulation(arm, Switches.only("sag", "inertia")).truth(TICKS)
    uncorrected, corrected = (rms(errors(arm, truth, window_s)[20:]) for window_s in (0.0, 0.05))
    assert uncorrected > 2e-6
    assert corrected < 0.2 * uncorrected
