"""Coverage of arms whose joints and beams share the errors of one laboratory, added coherently or not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_bringup.arms import load_checked_arm
from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.arm_study.arm_coverage import ArmSample, ArmSampler, coverage_figures, sample_arms
from posor_lab.arm_study.shared_arm import write_shared_arm
from scipy.stats import binom, chi2

if TYPE_CHECKING:
    from pathlib import Path

ARMS, SEED = 80, 4711


@pytest.fixture(scope="module")
def shared_arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shared_arm(load_checked_arm("five_axis"), tmp_path_factory.mktemp("shared"))


def inside(normalised: np.ndarray) -> int:
    return int(np.sum(normalised[:, 0] <= REGION_LIMIT))


def test_the_coherent_sum_covers_common_errors_and_the_independent_one_does_not(shared_arm: Path) -> None:
    """One pose of each arm, drawn by parameters and geometry."""
    sample: ArmSample = ArmSampler(load_checked_arm(str(shared_arm)), 1).draw(range(SEED, SEED + ARMS))
    assert sample.lost == 0
    assert sample.independent is not None
    least, most = (float(binom.ppf(p, ARMS, 0.95)) for p in (1e-4, 1.0 - 1e-4))
    assert least <= inside(sample.normalised) <= most
    assert chi2.ppf(1e-4, 6 * ARMS) <= sample.normalised.sum() <= chi2.ppf(1.0 - 1e-4, 6 * ARMS)
    assert inside(sample.independent) < least
    assert sample.independent.sum() > chi2.ppf(1.0 - 1e-9, 6 * ARMS)
    along = np.std(sample.errors[:, 0, :3], axis=0)
    assert np.linalg.norm(along) > 20e-6  # the common temperature moves the endpoint


@pytest.mark.long
def test_95_percent_of_1000_arms_are_in_their_region(shared_arm: Path) -> None:
    arm = load_checked_arm(str(shared_arm))
    found = coverage_figures(sample_arms(arm, 1000, 3, SEED), ArmSampler(arm, 3).predicted_shift()[:, :3])
    assert abs(found.inside.value - 0.95) <= 0.015
    assert found.inside_independent is not None
    assert found.inside_independent.value < 0.9
