# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Predicted endpoints of a few arms in CI; ``make prediction`` draws many."""

from __future__ import annotations

from pathlib import Path

import pytest
from posor.arm_names import find_arm
from posor_lab.arm_study.prediction_truth import AHEAD, BETWEEN, GAPS, SCANS
from posor_lab.arm_study.prediction_truth_command import failures, sample_predictions

ARMS, SECONDS, COST_S = 2, 2.0, 1e-5


@pytest.fixture(scope="module")
def path() -> Path:
    return find_arm("five_axis")


def test_predictions_are_as_good_as_scans_and_in_their_region(path: Path) -> None:
    found = sample_predictions(path, ARMS, SECONDS, workers=1)
    for motion in ("in motion", "at rest"):
        assert found[f"{BETWEEN}, {motion}"]["rms_m"] < found[f"{SCANS}, {motion}"]["rms_m"]
        assert found[f"{GAPS}, {motion}"]["rms_m"] < 1.5 * found[f"{SCANS}, {motion}"]["rms_m"]
        for case in (BETWEEN, AHEAD, GAPS):
            assert found[f"{case}, {motion}"]["inside"] > 0.85
            assert found[f"{case}, {motion}"]["missing"] == 0.0
    good = {**found}
    for each in good.values():
        each["inside"] = 0.95
    assert not failures(good, COST_S)
    assert len(failures(good, 1e-4)) == 1
    good[f"{AHEAD}, at rest"]["inside"] = 0.98
    good[f"{BETWEEN}, in motion"]["rms_m"] *= 4.0
    assert len(failures(good, COST_S)) == 2
