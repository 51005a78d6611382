# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the estimator on simulated scans: exact inversion, consistent uncertainty, detection of faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from posor.calibration.designs import DesignName, design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native
from posor_lab.accuracy.consistency import closure, monte_carlo, nees
from posor_lab.accuracy.fault_detection import FAULTS, detectable_shifts, detection
from posor_lab.accuracy.golden_command import largest_errors
from posor_lab.harness.random_poses import STACKS, TICK_NS

CASES = Path(__file__).resolve().parents[4] / "ros2_ws" / "src" / "posor" / "test" / "data" / "posor_cases.jsonl"
SEED = 7


def test_ray_traced_cases(tmp_path: Path) -> None:
    """A part of the cases, through calibrations and scans; the tests of model and solver read all."""
    part = tmp_path / "cases.jsonl"
    part.write_text("".join(CASES.read_text(encoding="utf-8").splitlines(keepends=True)[:20]), encoding="utf-8")
    for stack, errors in largest_errors(part).items():
        assert errors["prediction_m"] < 1e-12, stack
        assert errors["translation_m"] < 1e-9, stack
        assert errors["rotation_rad"] < 1e-9, stack


@pytest.mark.parametrize("stack", STACKS)
def test_closure_over_the_full_range(stack: DesignName) -> None:
    exact, simple = closure(stack, 200, SEED)
    assert exact.translation_m < 1e-9
    assert exact.rotation_rad < 1e-9
    assert simple.translation_m > 1e-6  # the closed form is worth replacing
    assert simple.rotation_rad > 1e-5


@pytest.mark.parametrize("stack", STACKS)
def test_normalised_errors_are_in_their_band(stack: DesignName) -> None:
    figures = nees(stack, 400, SEED)
    assert figures.low < figures.mean < figures.high


@pytest.mark.long
@pytest.mark.parametrize("stack", STACKS)
def test_both_covariances_agree_with_monte_carlo(stack: DesignName) -> None:
    figures = monte_carlo(stack, 4000, SEED)
    assert figures.random_ratio == pytest.approx(1.0, abs=0.05)
    assert figures.systematic_ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_flagged_in_their_first_scan(fault: str) -> None:
    figures = detection(fault, 40, SEED)
    assert figures.detected_fraction == 1.0
    assert figures.false_alarm_fraction < 5e-3


def test_smallest_detectable_shift_is_the_one_that_the_estimator_flags() -> None:
    posor = Posor(design("triad_diodes", motion=True))
    rotations = np.tile(rotation_from_native(1e-4, -2e-4, 0.0), (2, 1, 1))
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (2, 1))
    scans = scans_at(posor.stack, rotations, translations, np.array([1, 2], dtype=np.int64) * TICK_NS)
    smallest_m = detectable_shifts("triad_diodes")[0].smallest_m
    slope = -0.118e-3  # [m/V] of the design's probes in the middle of their range
    for factor, state in ((0.8, State.OK), (1.25, State.LOST)):
        posor.reset()
        posor.estimate(scans[0])
        volts = scans[1].gap_voltages.copy()
        volts[0] += factor * smallest_m / slope
        assert posor.estimate(replace(scans[1], gap_voltages=volts)).state is state
