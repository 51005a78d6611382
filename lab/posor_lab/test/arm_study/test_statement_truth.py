# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Statements against arms drawn with the independent truth: a few in CI, ``make statement-truth`` draws many."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from posor_design.endpoint_components import Kind, total_covariance
from posor_lab.arm_study.statement_truth import Drawn, StatementTruth, write_four_joint_arm
from posor_lab.arm_study.statement_truth_command import main

DRAWS, POSES = 60, 2
LIMIT = 4.0 * np.sqrt(2.0 / (6.0 * DRAWS))
"""Four standard deviations of the mean of a chi-square with 6 degrees of freedom over 6, of so many draws."""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    path = write_four_joint_arm(tmp_path_factory.mktemp("four"))
    truth = StatementTruth(path, POSES, 7, deviation=0.2)
    return Drawn(truth.stated, truth.errors(range(1, DRAWS + 1)))


def test_drawn_errors_have_the_stated_covariance(drawn: Drawn) -> None:
    kinds = {component.kind for component in drawn.stated[0].components}
    assert kinds == set(Kind) - {Kind.STAMPS}
    for stated, errors in zip(drawn.stated, drawn.errors.swapaxes(0, 1), strict=True):
        solved = np.linalg.solve(total_covariance(stated.components), errors.T).T
        assert np.mean(np.sum(errors * solved, axis=1)) / 6.0 == pytest.approx(1.0, abs=LIMIT)
        without = [each for each in stated.components if each.kind is not Kind.SHARED]
        solved = np.linalg.solve(total_covariance(without), errors.T).T
        assert np.mean(np.sum(errors * solved, axis=1)) / 6.0 > 1.0 + LIMIT


def test_the_figures_compare_the_draws_with_the_statement(drawn: Drawn) -> None:
    exact = [np.linalg.cholesky(total_covariance(each.components)) for each in drawn.stated]
    whole = np.concatenate([np.stack(exact, axis=0).swapaxes(1, 2).swapaxes(0, 1)] * 2) * np.sqrt(6.0)
    perfect = Drawn(drawn.stated, whole)
    np.testing.assert_allclose(perfect.ratios(), 1.0, rtol=1e-9)
    np.testing.assert_allclose(perfect.largest_ratios(), 1.0, rtol=1e-9)
    assert drawn.coverage().min() > 0.8


@pytest.mark.long
def test_the_program_writes_its_figures(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    assert main(["--draws", "100", "--poses", "2", "--output", str(path)]) in {0, 1}
    found = json.loads(path.read_text(encoding="utf-8"))
    assert list(found) == ["five_axis", "six_axis", "four_joint"]
    assert all(0.7 < ratio < 1.3 for each in found.values() for ratio in each["U_drawn_over_stated"])
