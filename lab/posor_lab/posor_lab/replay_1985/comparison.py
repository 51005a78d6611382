"""Comparison of a replayed motion test with the thesis, figure by figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_calibration.attitude_fit import deviation_from_first

from posor_lab.replay_1985.expectations import (
    DERIVED_MAP,
    EXPECTATIONS,
    KIND_NAMES,
    MEASURED_LIMIT,
    PRINTED_LIMITS,
    STEPS,
    WITHOUT_POSE,
    Expectation,
)
from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor_bringup.installed import Bag, CalibrationName

    from posor_lab.replay_1985.printed_results import PrintedColumns


def compare_with_thesis(
    test: MotionTest, bag: Bag, calibration: CalibrationName, printed: PrintedColumns | None
) -> Findings:
    """Return the findings of a replay.

    Args:
        test: The replay of ``bag``.
        bag: The motion test.
        calibration: Calibration of the replay.
        printed: Printed result table of the test, if there is one.

    """
    findings = [_received_steps(test, bag), _refused_steps(test, bag)]
    # Rows of printed columns are steps; a wrong number of steps is a finding already.
    if printed is not None and test.numbers == list(range(1, len(printed.posor) + 1)):
        findings += [_against_printed_truth(test, printed, angle) for angle in ANGLES[1:]]
        if calibration == "printed":
            findings += [_against_printed_posor(test, printed, angle) for angle in ANGLES]
    findings += [_against_expectation(test, expectation) for expectation in EXPECTATIONS[bag, calibration]]
    return Findings(tuple(findings))


def _received_steps(test: MotionTest, bag: Bag) -> Finding:
    expected = list(range(1, STEPS[bag] + 1))
    return Finding(
        "steps received",
        f"{len(test.steps)}" if test.numbers == expected else ", ".join(map(str, test.numbers)),
        f"{STEPS[bag]}",
        f"1 to {STEPS[bag]}",
        "appendix 8B",
        Verdict.of(holds=test.numbers == expected),
        "each with a transform and a machining-centre reading",
        "messages of a step were lost or repeated: see the folder logs beside the report",
    )


def _refused_steps(test: MotionTest, bag: Bag) -> Finding:
    refused = [step for step in test.steps if not step.has_pose]
    limit = WITHOUT_POSE[bag]
    return Finding(
        "steps without a pose",
        ", ".join(f"{step.number} ({step.status})" for step in refused) or "none",
        "",
        ", ".join(str(number) for number in limit) or "none",
        "",
        Verdict.of(holds=[step.number for step in refused] == list(limit)),
        "; ".join(f"step {number}: {reason}" for number, reason in limit.items()),
        "the calibration or the checks of a scan differ from those of this comparison",
    )


def _largest(differences: FloatArray) -> float:
    """Return the largest magnitude [urad] from step 2 on; NaN, which holds nowhere, if there is no such step."""
    return float(np.max(np.abs(differences[1:]))) / URAD if len(differences) > 1 else float("nan")


def _standard_deviation(errors: FloatArray) -> float:
    """Return the standard deviation of the thesis [urad]."""
    return float(deviation_from_first(errors)) / URAD


def _printed_finding(quantity: str, largest: float, limit: float, remark: str, if_fails: str) -> Finding:
    verdict = Verdict.of(holds=largest <= limit)
    source = "appendix 8B, Y motion results"
    return Finding(quantity, f"{largest:.2f} urad", "", f"at most {limit:g} urad", source, verdict, remark, if_fails)


def _against_printed_posor(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    judged = test.fully_measured(angle)
    difference = (test.posor_angles - printed.posor)[:, ANGLES.index(angle)]
    excluded = [str(step.number) for step, counts in zip(test.steps, judged, strict=True) if not counts]
    remark = f"largest difference over {np.count_nonzero(judged[1:])} steps"
    if excluded:
        over_all = _largest(difference[test.has_pose])
        remark += f", without step {', '.join(excluded)} (estimated readings; with it {over_all:.2f})"
    if angle == "theta":
        remark += f"; {DERIVED_MAP}"
    quantity = f"{angle}: POSOR - printed POSOR column"
    if_fails = "the readings, the calibration or the estimator differ from those of 1985 by more than the rounding"
    return _printed_finding(quantity, _largest(difference[judged]), PRINTED_LIMITS[angle], remark, if_fails)


def _against_printed_truth(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    largest = _largest((test.truth_angles - printed.truth)[:, ANGLES.index(angle)])
    quantity = f"{angle}: machining centre - printed measured column"
    if_fails = "no POSOR takes part: the bag or the printed table has changed"
    return _printed_finding(quantity, largest, MEASURED_LIMIT, "largest difference; lever 798 mm (31.43 in)", if_fails)


def error_figure(test: MotionTest, expected: Expectation, counted: BoolArray | None = None) -> float:
    """Return the figure of an expectation [urad]: standard deviation or largest error against the machining centre.

    Args:
        test: The motion test.
        expected: Angle and kind of the figure.
        counted: Steps that count, (n,); None: all with a pose.

    """
    errors = test.angle_errors[:, ANGLES.index(expected.angle)][test.has_pose if counted is None else counted]
    return _standard_deviation(errors) if expected.kind == "sd" else _largest(errors)


def _against_expectation(test: MotionTest, expected: Expectation) -> Finding:
    value = error_figure(test, expected)
    measured = test.fully_measured(expected.angle)
    remark = f"over {np.count_nonzero(test.has_pose[1:])} steps"
    if not np.array_equal(measured, test.has_pose):
        remark += f"; {error_figure(test, expected, measured):.2f} without the steps whose readings are estimated"
    if expected.high is None:
        limit, verdict = "", Verdict.NOT_JUDGED
    else:
        limit = f"{expected.low:g} to {expected.high:g} urad" if expected.low else f"at most {expected.high:g} urad"
        verdict = Verdict.of(holds=expected.low <= value <= expected.high)
    return Finding(
        f"{expected.angle}: error against machining centre, {KIND_NAMES[expected.kind]}",
        f"{value:.2f} urad",
        "" if expected.stated is None else f"{expected.stated:g} urad",
        limit,
        expected.source,
        verdict,
        "; ".join(filter(None, [remark, expected.remark])),
        "the replayed errors are not those that the thesis states: compare the curves of POSOR and printed column",
    )
