from __future__ import annotations

from typing import TYPE_CHECKING, get_args

import numpy as np
import pytest
from posor_bringup.comparison import compare
from posor_bringup.expectations import BAGS, CALIBRATIONS, EXPECTATIONS, STEPS, WITHOUT_POSE, Bag
from posor_bringup.findings import Finding, Findings, Verdict
from posor_bringup.motion import DIODES_ESTIMATED, PROBES_ESTIMATED

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_bringup.motion import MotionTest
    from posor_bringup.thesis import PrintedColumns

URAD = 1e-6


def finding(comparison: Findings, beginning: str) -> Finding:
    return next(item for item in comparison.findings if item.what.startswith(beginning))


def failing(comparison: Findings) -> list[str]:
    return [item.what for item in comparison.findings if item.verdict is Verdict.FAILS]


def test_every_test_and_calibration_has_expectations() -> None:
    assert get_args(Bag) == BAGS
    assert set(EXPECTATIONS) == {(bag, calibration) for bag in BAGS for calibration in CALIBRATIONS}
    for expectations in EXPECTATIONS.values():
        assert any(expected.high is not None for expected in expectations)
    assert set(STEPS) == set(WITHOUT_POSE) == set(BAGS)


def test_the_printed_table_agrees_with_itself(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    comparison = compare(printed_test(), "ymo", "printed", printed)
    assert comparison.holds
    assert finding(comparison, "theta: POSOR - printed").computed == "0.00 urad"
    assert finding(comparison, "alpha: error").stated == "51 urad"


@pytest.mark.parametrize(("column", "angle", "limit"), [(0, "alpha", 1.0), (1, "beta", 1.0), (2, "theta", 6.0)])
def test_one_step_beyond_the_limit_fails(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns, column: int, angle: str, limit: float
) -> None:
    within, beyond = np.zeros(3), np.zeros(3)
    within[column], beyond[column] = 0.99 * limit * URAD, -1.01 * limit * URAD
    assert compare(printed_test({9: within}), "ymo", "printed", printed).holds
    assert failing(compare(printed_test({9: beyond}), "ymo", "printed", printed)) == [
        f"{angle}: POSOR - printed POSOR column"
    ]


def test_a_step_with_an_estimated_reading_is_shown_but_not_judged(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    far = np.array([0.0, 0.0, 20.0 * URAD])
    comparison = compare(printed_test({14: far}, statuses={14: DIODES_ESTIMATED}), "ymo", "printed", printed)
    theta = finding(comparison, "theta: POSOR - printed")
    assert theta.verdict is Verdict.HOLDS
    assert "over 13 steps, without step 14 (estimated readings; with it 20.00)" in theta.remark
    probes = compare(printed_test({14: far}, statuses={14: PROBES_ESTIMATED}), "ymo", "printed", printed)
    assert finding(probes, "theta: POSOR - printed").verdict is Verdict.FAILS


def test_no_judged_step_is_no_agreement(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    comparison = compare(printed_test(statuses={1: DIODES_ESTIMATED}), "ymo", "printed", printed)
    assert finding(comparison, "theta: POSOR - printed").verdict is Verdict.FAILS
    assert not comparison.holds


def test_a_missing_step_fails(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    comparison = compare(printed_test(count=14), "ymo", "printed", printed)
    assert finding(comparison, "steps received").verdict is Verdict.FAILS
    assert not comparison.holds


def test_a_step_without_pose_fails_unless_it_must_be_refused(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    comparison = compare(printed_test(lost=(7,)), "ymo", "printed", printed)
    refused = finding(comparison, "steps without a pose")
    assert (refused.computed, refused.limit) == ("7 (lost:OUT_OF_RANGE)", "none")
    assert refused.verdict is Verdict.FAILS
    diagonal = compare(printed_test(lost=(14,), count=14), "yzmo", "printed", None)
    assert finding(diagonal, "steps without a pose").verdict is Verdict.HOLDS
    unrefused = compare(printed_test(count=14), "yzmo", "printed", None)
    assert finding(unrefused, "steps without a pose").verdict is Verdict.FAILS


def test_a_wrong_machining_centre_fails(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    wrong = printed.measured + np.linspace(0.0, 5.0, 15)[:, None] * URAD
    moved = type(printed)(printed.posor, wrong)
    assert "beta: machining centre - printed measured column" in failing(
        compare(printed_test(), "ymo", "printed", moved)
    )


def test_the_printed_state_is_not_the_one_of_section_8_4(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    comparison = compare(printed_test(), "ymo", "section84", printed)
    assert failing(comparison) == [
        "alpha: error against machining centre, largest",
        "beta: error against machining centre, standard deviation",
    ]
