# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Coverage and sag over many arms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from posor.errors import ParameterError, PosorError
from posor_bringup.arms import load_checked_arm
from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.arm_study.arm_coverage import ArmSample, ArmSampler, arm_coverage, coverage_figures, sample_arms
from scipy.stats import binom, chi2

ARMS, POSES, SEED = 40, 3, 4711


@pytest.fixture(scope="module")
def sampler() -> ArmSampler:
    return ArmSampler(load_checked_arm("five_axis"), POSES)


@pytest.fixture(scope="module")
def sample(sampler: ArmSampler) -> ArmSample:
    return sampler.draw(range(SEED, SEED + ARMS))


def test_coverage_of_the_published_region(sample: ArmSample) -> None:
    assert sample.lost == 0
    # One pose of each arm: only poses of different arms are independent.
    for of_pose in sample.normalised.T:
        inside = int(np.sum(of_pose <= REGION_LIMIT))
        assert binom.ppf(1e-4, ARMS, 0.95) <= inside <= binom.ppf(1.0 - 1e-4, ARMS, 0.95)
        assert chi2.ppf(1e-4, 6 * ARMS) <= of_pose.sum() <= chi2.ppf(1.0 - 1e-4, 6 * ARMS)


def test_displacement_by_uncorrected_sag_is_as_predicted(sampler: ArmSampler, sample: ArmSample) -> None:
    predicted = sampler.predicted_shift()
    found, chance = sample.without_sag.mean(axis=0), sample.without_sag.std(axis=0) / math.sqrt(ARMS)
    assert np.all(np.abs(found - predicted) <= 4.0 * chance + 1e-9)
    assert np.linalg.norm(predicted[:, :3], axis=1).min() > 1e-4  # the sag is not negligible
    assert np.all(np.abs(sample.errors.mean(axis=0)) <= 4.0 * sample.errors.std(axis=0) / math.sqrt(ARMS))


def test_seed_determines_an_arm(sampler: ArmSampler, sample: ArmSample) -> None:
    one = sampler.draw(range(SEED + 7, SEED + 8))
    assert np.array_equal(one.errors[0], sample.errors[7])
    assert not np.array_equal(one.errors[0], sample.errors[8])


@pytest.mark.long
def test_sample_does_not_depend_on_the_number_of_processes(sample: ArmSample) -> None:
    drawn: list[int] = []
    parts = sample_arms(load_checked_arm("five_axis"), ARMS, POSES, SEED, workers=2, on_drawn=drawn.append)
    assert sum(drawn) == ARMS
    assert np.array_equal(parts.normalised, sample.normalised)
    assert np.array_equal(parts.without_sag, sample.without_sag)


def test_figures_and_their_standard_uncertainties() -> None:
    normalised = np.array([[1.0, 20.0], [1.0, 1.0], [np.nan, 1.0], [2.0, 3.0]])
    errors = np.zeros((4, 2, 6))
    errors[..., 1] = 2e-6
    predicted = np.array([[0.0, 0.0, 1e-4], [0.0, 0.0, 2e-4]])
    without = errors.copy()
    without[..., 2] = 1.1 * predicted[:, 2]
    without[2, 0] = errors[2, 0] = np.nan
    found = coverage_figures(ArmSample(normalised, errors, without, lost=1), predicted)
    assert found.inside.value == pytest.approx((0.5 + 1.0 + 0.5 + 1.0) / 4)  # a lost pose counts as outside
    assert found.inside.sigma == pytest.approx(np.std([0.5, 1.0, 0.5, 1.0], ddof=1) / 2.0)
    assert found.nees.value == pytest.approx((10.5 + 1.0 + 1.0 + 2.5) / 4)
    assert found.lost == 1
    assert len(found.normalised) == 7
    assert found.rms_m == pytest.approx(2e-6)
    assert found.shift_ratio.value == pytest.approx(1.1)
    assert found.shift_ratio.sigma == pytest.approx(0.0, abs=1e-12)
    assert found.shift_found_m == pytest.approx(np.array([[0.0, 2e-6, 1.1e-4], [0.0, 2e-6, 2.2e-4]]))


def test_sampling_can_be_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posor_lab.arm_study.arm_coverage.BATCH", 1)

    def stop(_more: int) -> None:
        raise PosorError("enough")

    with pytest.raises(PosorError, match="enough"):
        sample_arms(load_checked_arm("test_rig"), 2, 1, SEED, workers=1, on_drawn=stop)


def test_arm_without_scenario_is_refused(tmp_path: Path) -> None:
    text = load_checked_arm("test_rig").path.read_text(encoding="utf-8")
    folder = load_checked_arm("test_rig").path.resolve().parent
    for name in ("test_rig.urdf", "beams.yaml", "calibrations"):
        (tmp_path / name).symlink_to(folder / name)
    text = text.replace("scenario: scenario.yaml\n", "").replace("source: simulated", "source: bag")
    (tmp_path / "arm.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=r"arm\.yaml: has no scenario or no beams file; expected a simulated arm"):
        arm_coverage(load_checked_arm(str(tmp_path)), 2)
