# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Coverage of arms whose joints and beams share the errors of one laboratory, added coherently or not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor import load_arm
from posor.chain.arm_file import load_arm_file
from posor.chain.joint_measurements import MeasuredJoint
from posor.uncertainty.budget_poses import model_covariances
from posor.uncertainty.common_errors import LENGTH_SCALE, TEMPERATURE
from posor_bringup.arms import load_checked_arm
from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.arm_study.arm_coverage import ArmSampler, coverage_figures, sample_arms
from posor_lab.arm_study.shared_arm import write_shared_arm
from scipy.stats import binom, chi2

ARMS, SEED = 40, 4711
ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def shared_arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_shared_arm(load_checked_arm("five_axis"), tmp_path_factory.mktemp("shared"))


def variances_along_x(sampler: ArmSampler, path: Path) -> tuple[float, float]:
    """Return the variance of the endpoint at the sampled pose: by the chain, and with all terms independent."""
    arm, names = load_arm_file(path), [joint.name for joint in sampler.chain.joints]
    angles = dict(zip(names, map(float, sampler._commanded[0]), strict=True))
    model = model_covariances({name: arm.calibration(name) for name in names}, sampler.chain, angles)
    measured = {
        name: MeasuredJoint(
            sampler.chain.nominal_joint(name, angles[name]),
            model.random[name],
            model.systematic[name],
            model.shared[name],
        )
        for name in names
    }
    alone = {name: replace(each, shared_effects={}) for name, each in measured.items()}
    found = sampler.chain.estimate(measured), sampler._independent.estimate(alone)
    return found[0].covariance()[0, 0], found[1].covariance()[0, 0]


def test_the_coherent_sum_covers_common_errors_and_the_independent_one_does_not(shared_arm: Path) -> None:
    """One pose of each arm, drawn by parameters and geometry. The terms are 36 um along X, the rest 3 um."""
    sampler = ArmSampler(load_checked_arm(str(shared_arm)), 1)
    sample = sampler.draw(range(SEED, SEED + ARMS))
    assert sample.lost == 0
    assert sample.independent is not None
    inside = int(np.sum(sample.normalised <= REGION_LIMIT))
    assert binom.ppf(1e-4, ARMS, 0.95) <= inside <= binom.ppf(1.0 - 1e-4, ARMS, 0.95)
    assert chi2.ppf(1e-4, 6 * ARMS) <= sample.normalised.sum() <= chi2.ppf(1.0 - 1e-4, 6 * ARMS)
    assert np.sum(sample.independent <= REGION_LIMIT) < inside
    along_x = float(np.square(sample.errors[:, 0, 0]).sum())
    coherent, independent = (along_x / variance for variance in variances_along_x(sampler, shared_arm))
    assert chi2.ppf(1e-4, ARMS) <= coherent <= chi2.ppf(1.0 - 1e-4, ARMS) < independent


def test_recorded_scans_get_the_coherent_sum(shared_arm: Path) -> None:
    """The covariance of a reprocessed bag is that of the chain, of each joint's transform with its shared terms."""
    arm = load_arm(shared_arm)
    found, chain, at = arm.estimate(ROOT / "bags/five_axis"), arm.chain(), 300
    measured = {}
    for name, joint in found.joints.items():
        n = int(np.searchsorted(joint.stamps_ns, found.endpoint.stamps_ns[at]))
        effects = dict(zip(arm.calibration(name).shared, joint.shared_effects[n], strict=False))
        parts = joint.covariances_random[n], joint.covariances_systematic[n], effects
        measured[name] = MeasuredJoint(pin.SE3(joint.rotations[n], joint.translations[n]), *parts)
    expected = chain.estimate(measured)
    assert expected.shared_effects.keys() == {LENGTH_SCALE, TEMPERATURE}
    own = found.endpoint.covariances_systematic[at]
    np.testing.assert_allclose(own, expected.covariance_systematic, rtol=1e-3, atol=1e-3 * own.max())


@pytest.mark.long
def test_95_percent_of_1000_arms_are_in_their_region(shared_arm: Path) -> None:
    arm = load_checked_arm(str(shared_arm))
    found = coverage_figures(sample_arms(arm, 1000, 3, SEED), ArmSampler(arm, 3).predicted_shift()[:, :3])
    assert abs(found.inside.value - 0.95) <= 0.015
    assert found.inside_independent is not None
    assert found.inside_independent.value < 0.92
