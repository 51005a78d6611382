"""Compares a replayed motion test with what the thesis says of it, figure by figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_bringup.expectations import (
    EXPECTATIONS,
    MEASURED_LIMIT,
    PRINTED_LIMITS,
    STEPS,
    WITHOUT_POSE,
    Bag,
    CalibrationName,
    Expectation,
)
from posor_bringup.findings import Finding, Findings, Verdict
from posor_bringup.motion import ANGLES, Angle, MotionTest, standard_deviation
from posor_bringup.thesis import URAD, PrintedColumns

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


def compare(test: MotionTest, bag: Bag, calibration: CalibrationName, printed: PrintedColumns | None) -> Findings:
    """Compare ``test`` with the thesis.

    Args:
        test: The replay of ``bag``.
        bag: Which motion test.
        calibration: The calibration it was replayed with.
        printed: The printed result table of this test, where there is one.

    """
    findings = [_steps(test, bag), _refused(test, bag)]
    if printed is not None and _same_steps(test, printed):
        findings += [_against_printed_measured(test, printed, angle) for angle in ANGLES[1:]]
        if calibration == "printed":
            findings += [_against_printed(test, printed, angle) for angle in ANGLES]
    findings += [_against_stated(test, expectation) for expectation in EXPECTATIONS[bag, calibration]]
    return Findings(tuple(findings))


def _same_steps(test: MotionTest, printed: PrintedColumns) -> bool:
    """Return whether the rows belong together; if not, the step count has failed already."""
    return test.numbers == list(range(1, len(printed.posor) + 1))


def _steps(test: MotionTest, bag: Bag) -> Finding:
    expected = list(range(1, STEPS[bag] + 1))
    return Finding(
        "steps received",
        f"{len(test.steps)}" if test.numbers == expected else ", ".join(map(str, test.numbers)),
        f"{STEPS[bag]}",
        f"1 to {STEPS[bag]}",
        "appendix 8B",
        Verdict.of(holds=test.numbers == expected),
        "each with a transform and a machining-centre reading",
    )


def _refused(test: MotionTest, bag: Bag) -> Finding:
    refused = [step for step in test.steps if not step.has_pose]
    limit = WITHOUT_POSE[bag]
    return Finding(
        "steps without a pose",
        ", ".join(f"{step.number} ({step.status})" for step in refused) or "none",
        "",
        ", ".join(str(number) for number in limit) or "none",
        "",
        Verdict.of(holds=[step.number for step in refused] == list(limit)),
        "; ".join(f"step {number}: {why}" for number, why in limit.items()),
    )


def _largest(differences: FloatArray) -> float:
    """Return the largest magnitude [urad] from step 2 on; NaN, which holds nowhere, if there is no such step."""
    return float(np.max(np.abs(differences[1:]))) / URAD if len(differences) > 1 else float("nan")


def _against_printed(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    column, limit = ANGLES.index(angle), PRINTED_LIMITS[angle]
    judged = test.measured_throughout(angle)
    difference = (test.posor - printed.posor)[:, column]
    largest = _largest(difference[judged])
    left_out = [step.number for step, counts in zip(test.steps, judged, strict=True) if not counts]
    remark = f"largest difference over {np.count_nonzero(judged[1:])} steps"
    if left_out:
        every = _largest(difference[test.has_pose])
        remark += f", without step {', '.join(map(str, left_out))} (estimated readings; with it {every:.2f})"
    return Finding(
        f"{angle}: POSOR - printed POSOR column",
        f"{largest:.2f} urad",
        "",
        f"at most {limit:g} urad",
        "appendix 8B, Y motion results",
        Verdict.of(holds=largest <= limit),
        remark,
    )


def _against_printed_measured(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    column = ANGLES.index(angle)
    largest = _largest((test.measured - printed.measured)[:, column])
    return Finding(
        f"{angle}: machining centre - printed measured column",
        f"{largest:.2f} urad",
        "",
        f"at most {MEASURED_LIMIT:g} urad",
        "appendix 8B, Y motion results",
        Verdict.of(holds=largest <= MEASURED_LIMIT),
        "largest difference; lever 31.43 in",
    )


def _against_stated(test: MotionTest, expected: Expectation) -> Finding:
    error = test.error[:, ANGLES.index(expected.angle)]
    figure, name = {
        "sd": (lambda chosen: standard_deviation(chosen) / URAD, "standard deviation"),
        "max": (_largest, "largest"),
    }[expected.kind]
    value = figure(error[test.has_pose])
    clean = test.measured_throughout(expected.angle)
    remarks = [f"over {np.count_nonzero(test.has_pose[1:])} steps"]
    if not np.array_equal(clean, test.has_pose):
        remarks[0] += f"; {figure(error[clean]):.2f} without the steps whose readings are estimated"
    if expected.remark:
        remarks.append(expected.remark)
    if expected.high is None:
        limit, verdict = "", Verdict.SHOWN
    else:
        limit = f"{expected.low:g} to {expected.high:g} urad" if expected.low else f"at most {expected.high:g} urad"
        verdict = Verdict.of(holds=expected.low <= value <= expected.high)
    return Finding(
        f"{expected.angle}: error against machining centre, {name}",
        f"{value:.2f} urad",
        "" if expected.stated is None else f"{expected.stated:g} urad",
        limit,
        expected.source,
        verdict,
        "; ".join(remarks),
    )
