# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A few vibrating arms in CI; ``make vibration`` draws many. The judge's beams against the design calculators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.chain.arm_file import load_arm_file
from posor_lab.independent.finite_elements import end_motions
from posor_lab.independent.true_arm import TrueArm
from posor_lab.vibration.vibrating_arm import DAMPING, write_vibrating_arm
from posor_lab.vibration.vibration_command import CONTROL_ERROR, draw, failures
from posor_lab.vibration.vibration_study import DYNAMIC, STATIC, VibrationStudy, sample_vibration

ARMS, SEED, BELOW_HZ, BEYOND_HZ = 1, 1985, 75.0, 120.0


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_vibrating_arm(load_arm_file("five_axis"), tmp_path_factory.mktemp("arm"))


def test_the_dynamic_chain_holds_below_the_limit_and_says_so_beyond(path: Path, tmp_path: Path) -> None:
    limit_hz = VibrationStudy(path).limit_hz
    found = {each: sample_vibration(path, each, ARMS, SEED, workers=1) for each in (BELOW_HZ, BEYOND_HZ)}
    wrong = write_vibrating_arm(load_arm_file("five_axis"), tmp_path, frequency_error=CONTROL_ERROR)
    control = sample_vibration(path, BELOW_HZ, ARMS, SEED, chain=wrong, workers=1)[DYNAMIC]
    below, beyond = found[BELOW_HZ], found[BEYOND_HZ]
    assert below[DYNAMIC].rms_m < 0.1 * below[STATIC].rms_m
    assert below[DYNAMIC].inside > 0.8 > control.inside
    assert below[STATIC].inside < 0.2
    assert (below[DYNAMIC].bounded, beyond[DYNAMIC].bounded) == (1.0, 0.0)
    assert beyond[DYNAMIC].stated_m > beyond[DYNAMIC].rms_m
    good = {BELOW_HZ: {**below, DYNAMIC: below[DYNAMIC]._replace(inside=0.95)}, BEYOND_HZ: beyond}
    assert not failures(good, limit_hz, control)
    broken = {BELOW_HZ: {**below, DYNAMIC: below[STATIC]}, BEYOND_HZ: {**beyond, DYNAMIC: below[DYNAMIC]}}
    assert len(failures(broken, limit_hz, good[BELOW_HZ][DYNAMIC])) == 4
    draw(found, limit_hz, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 1000


def test_the_beams_of_the_judge_vibrate_as_the_design_calculators_say(path: Path) -> None:
    """The calculators have shear and rotary inertia in addition, which lower a frequency."""
    chain, truth = load_arm_file(path).chain(), TrueArm(path)
    for link, true in zip(chain.links, truth.links, strict=True):
        if link.beam is None or link.beam.entry.vibration is None:
            continue
        stated = link.beam.entry.vibration.frequency.number
        assert 0.9 * true.first_frequency < stated < true.first_frequency
        start, end = true.vibration_gains(np.array([0.0, 0.5, 1.0]) * true.first_frequency)
        static = end_motions(float(np.linalg.norm(true.end.translation)), true.sag)
        own = link.beam
        np.testing.assert_allclose(start[0].real, np.hstack([own.start_gain, own.start_tilt_gain]), rtol=0, atol=1e-14)
        np.testing.assert_allclose(end[0].real, np.hstack([own.end_gain, own.end_tilt_gain]), rtol=0, atol=1e-14)
        assert np.abs(end[0, :3, :3]).max() == pytest.approx(abs(static[1, 0]))
        turns = np.abs(end[:, 3:, :3] - start[:, 3:, :3]).max(axis=(1, 2))
        half, resonance = turns[1:] / turns[0]
        assert half == pytest.approx(1.0 / (1.0 - 0.25), rel=0.02)
        assert resonance == pytest.approx(0.5 / DAMPING, rel=0.1)
