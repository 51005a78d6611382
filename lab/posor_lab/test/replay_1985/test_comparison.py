# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of a motion test with the thesis: what holds, what fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, Bag
from posor_lab.replay_1985.comparison import STEPS, WITHOUT_POSE, compare_with_thesis, expectations
from posor_lab.replay_1985.motion_test import MotionTest
from posor_lab.replay_1985.printed_results import PrintedColumns
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.thesis_data import URAD

Compare = Callable[..., Findings]


@pytest.fixture
def compare(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> Compare:
    """Return a function that compares YMO with its printed table, some steps changed."""

    def compare_changed(*, calibration: Any = "printed", columns: PrintedColumns = printed, **changes: Any) -> Findings:
        return compare_with_thesis(printed_test(**changes), "ymo", calibration, columns)

    return compare_changed


def finding(comparison: Findings, beginning: str) -> Finding:
    return next(item for item in comparison.findings if item.quantity.startswith(beginning))


def failing(comparison: Findings) -> list[str]:
    return [item.quantity for item in comparison.findings if item.verdict is Verdict.FAILS]


def test_every_test_and_calibration_has_expectations() -> None:
    assert get_args(Bag) == BAGS
    for bag in BAGS:
        for calibration in CALIBRATIONS:
            assert any(expected.high is not None for expected in expectations(bag, calibration))
    assert set(STEPS) == set(WITHOUT_POSE) == set(BAGS)


def test_the_printed_table_agrees_with_itself(compare: Compare) -> None:
    comparison = compare()
    assert comparison.holds
    assert finding(comparison, "theta: POSOR - printed").computed == "0.00 urad"
    assert finding(comparison, "alpha: error").stated == "51 urad"


@pytest.mark.parametrize(("column", "angle", "limit"), [(0, "alpha", 1.0), (1, "beta", 1.0), (2, "theta", 6.0)])
def test_one_step_beyond_the_limit_fails(compare: Compare, column: int, angle: str, limit: float) -> None:
    shift = limit * URAD * np.eye(3)[column]
    assert compare(shifts={9: 0.99 * shift}).holds
    assert failing(compare(shifts={9: -1.01 * shift})) == [f"{angle}: POSOR - printed POSOR column"]


def test_a_step_with_an_estimated_reading_is_not_judged(compare: Compare) -> None:
    far = {14: np.array([0.0, 0.0, 20.0 * URAD])}
    theta = finding(compare(shifts=far, statuses={14: DIODES_ESTIMATED}), "theta: POSOR - printed")
    assert theta.verdict is Verdict.HOLDS
    assert "over 13 steps, without step 14 (estimated readings; with it 20.00)" in theta.remark
    probes = finding(compare(shifts=far, statuses={14: PROBES_ESTIMATED}), "theta: POSOR - printed")
    assert probes.verdict is Verdict.FAILS


@pytest.mark.parametrize(
    ("change", "name"),
    [({"statuses": {1: DIODES_ESTIMATED}}, "theta: POSOR - printed"), ({"count": 14}, "steps received")],
)
def test_no_judged_step_or_a_missing_one_fails(compare: Compare, change: dict[str, Any], name: str) -> None:
    comparison = compare(**change)
    assert finding(comparison, name).verdict is Verdict.FAILS
    assert not comparison.holds


def test_a_step_without_pose_fails(compare: Compare) -> None:
    refused = finding(compare(lost=(7,)), "steps without a pose")
    assert (refused.computed, refused.limit) == ("7 (lost:OUT_OF_RANGE)", "none")
    assert refused.verdict is Verdict.FAILS


@pytest.mark.parametrize(("lost", "verdict"), [((14,), Verdict.HOLDS), ((), Verdict.FAILS)])
def test_step_14_of_yzmo_must_be_refused(
    printed_test: Callable[..., MotionTest], lost: tuple[int, ...], verdict: Verdict
) -> None:
    comparison = compare_with_thesis(printed_test(lost=lost, count=14), "yzmo", "printed", None)
    assert finding(comparison, "steps without a pose").verdict is verdict


def test_a_wrong_machining_centre_fails(compare: Compare, printed: PrintedColumns) -> None:
    wrong = printed.truth + np.linspace(0.0, 5.0, 15)[:, None] * URAD
    comparison = compare(columns=PrintedColumns(printed.posor, wrong))
    assert "beta: machining centre - printed measured column" in failing(comparison)


def test_the_printed_state_is_not_the_one_of_section_8_4(compare: Compare) -> None:
    assert failing(compare(calibration="section84")) == [
        "alpha: error against machining centre, largest",
        "beta: error against machining centre, standard deviation",
    ]
