# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of a replayed motion test with the thesis, figure by figure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
from posor_calibration.attitude_fit import deviation_from_first

from posor_lab.lab_output import page_notes
from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.reports.findings import Finding, Findings, judge
from posor_lab.thesis_data import URAD, data_path, parse_number, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_lab.harness.rig_files import Bag, CalibrationName
    from posor_lab.replay_1985.printed_results import PrintedColumns

FigureKind = Literal["sd", "max"]

STEPS: Mapping[Bag, int] = {"ymo": 15, "yzmo": 14, "zmo": 20}  # number of steps of each test, appendix 8B
WITHOUT_POSE: Mapping[Bag, Mapping[int, str]] = {  # steps that must be refused, and the reason
    "ymo": {},
    "yzmo": {14: "no digit of its diode readings is legible, and the estimates lie outside the calibrated map"},
    "zmo": {},
}
KIND_NAMES: Mapping[FigureKind, str] = {"sd": "standard deviation", "max": "largest"}
PRINTED_LIMITS: Mapping[Angle, float] = {"alpha": 1.0, "beta": 1.0, "theta": 6.0}
"""Largest difference from a printed POSOR column [urad]: rounding, and for theta the error of the derived diode map."""
DERIVED_MAP = "; limit: the 1985 diode map is lost, and the derived one leaves some urad"
MEASURED_LIMIT = 1.0
"""Largest difference from a printed machining-centre column [urad]: rounding of the table and of its inputs."""
UNDER_TABLE = "appendix 8B, printed under the Y motion results"
"""Source of the standard deviations of YMO without compensated zero shifts."""
EXPECTATIONS_FILE = "motion_test_expectations.csv"


@dataclass(frozen=True)
class Expectation:
    """One figure of the error against the machining centre, over all steps that gave a pose."""

    angle: Angle
    kind: FigureKind  # standard deviation or largest magnitude
    stated: float | None  # figure of the thesis [urad]; None: the thesis states none
    low: float | None  # lower limit [urad]
    high: float | None  # upper limit [urad]; None: the figure is not judged
    source: str  # place in the thesis
    remark: str  # reason of the limit, or of its absence


@cache
def expectations(bag: Bag, calibration: CalibrationName) -> tuple[Expectation, ...]:
    """Return the expected figures of a motion test with a calibration.

    Raises DataFileError: the table of the figures cannot be read, or has an invalid number.
    """
    path, limits = data_path(EXPECTATIONS_FILE), ("stated_urad", "low_urad", "high_urad")
    found = []
    for row in read_table(path, ["test", "calibration", "angle", "kind", *limits, "source", "remark"]):
        if (row["test"], row["calibration"]) == (bag, calibration):
            where = f"{path}, {bag} {row['angle']}"
            stated, low, high = (parse_number(row, name, where) if row[name] else None for name in limits)
            angle, kind = cast("Angle", row["angle"]), cast("FigureKind", row["kind"])
            found.append(Expectation(angle, kind, stated, low, high, row["source"], row["remark"]))
    return tuple(found)


def reasons(bag: Bag, calibration: CalibrationName) -> dict[Angle, str]:
    """Return why the error of each angle is as large as it is, where a reason is known."""
    return {each.angle: each.remark for each in expectations(bag, calibration) if each.kind == "sd"}


def compare_with_thesis(
    test: MotionTest, bag: Bag, calibration: CalibrationName, printed: PrintedColumns | None
) -> Findings:
    """Return the findings of a replay; ``printed``: the printed result table of the test, if there is one.

    Raises DataFileError: the table of the expected figures is invalid.
    """
    findings = [_received_steps(test, bag), _refused_steps(test, bag)]
    # Rows of printed columns are steps; a wrong number of steps is a finding already.
    if printed is not None and test.numbers == list(range(1, len(printed.posor) + 1)):
        findings += [_against_printed_truth(test, printed, angle) for angle in ANGLES[1:]]
        if calibration == "printed":
            findings += [_against_printed_posor(test, printed, angle) for angle in ANGLES]
    findings += [_against_expectation(test, expected) for expected in expectations(bag, calibration)]
    return Findings(tuple(findings))


def _received_steps(test: MotionTest, bag: Bag) -> Finding:
    count, holds = STEPS[bag], test.numbers == list(range(1, STEPS[bag] + 1))
    numbers = len(test.steps) if holds else ", ".join(map(str, test.numbers))
    return judge(_texts("received"), holds=holds, numbers=numbers, count=count)


def _refused_steps(test: MotionTest, bag: Bag) -> Finding:
    refused = [step for step in test.steps if not step.has_pose]
    limit = WITHOUT_POSE[bag]
    return judge(
        _texts("refused"),
        holds=[step.number for step in refused] == list(limit),
        numbers=", ".join(f"{step.number} ({step.status})" for step in refused) or "none",
        expected=", ".join(map(str, limit)) or "none",
        reasons="; ".join(f"step {number}: {reason}" for number, reason in limit.items()),
    )


def _texts(finding: str) -> Mapping[str, str]:
    texts: Mapping[str, str] = page_notes("motion_test")["findings"][finding]
    return texts


def _largest(differences: FloatArray) -> float:
    """Return the largest magnitude [urad] from step 2 on; NaN, which no limit accepts, without a further step."""
    return float(np.max(np.abs(differences[1:]))) / URAD if len(differences) > 1 else float("nan")


def _against_printed_posor(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    judged = test.fully_measured(angle)
    difference = (test.posor_angles - printed.posor)[:, ANGLES.index(angle)]
    largest, over_all = _largest(difference[judged]), _largest(difference[test.has_pose])
    excluded = ", ".join(str(step.number) for step, counts in zip(test.steps, judged, strict=True) if not counts)
    return judge(
        _texts("printed_posor"),
        holds=largest <= PRINTED_LIMITS[angle],
        angle=angle,
        largest=largest,
        limit=PRINTED_LIMITS[angle],
        count=np.count_nonzero(judged[1:]),
        excluded=excluded and f", without step {excluded} (estimated readings; with it {over_all:.2f})",
        derived=DERIVED_MAP if angle == "theta" else "",
    )


def _against_printed_truth(test: MotionTest, printed: PrintedColumns, angle: Angle) -> Finding:
    largest, limit = _largest((test.truth_angles - printed.truth)[:, ANGLES.index(angle)]), MEASURED_LIMIT
    return judge(_texts("printed_truth"), holds=largest <= limit, angle=angle, largest=largest, limit=limit)


def error_figure(test: MotionTest, expected: Expectation, counted: BoolArray | None = None) -> float:
    """Return the figure of an expectation [urad]: standard deviation or largest error against the machining centre.

    ``counted``: steps that count, (n,); None: all with a pose.
    """
    errors = test.angle_errors[:, ANGLES.index(expected.angle)][test.has_pose if counted is None else counted]
    return float(deviation_from_first(errors)) / URAD if expected.kind == "sd" else _largest(errors)


def _against_expectation(test: MotionTest, expected: Expectation) -> Finding:
    value, low, high = error_figure(test, expected), expected.low or 0.0, expected.high
    measured = test.fully_measured(expected.angle)
    remark = f"over {np.count_nonzero(test.has_pose[1:])} steps"
    if not np.array_equal(measured, test.has_pose):
        remark += f"; {error_figure(test, expected, measured):.2f} without the steps whose readings are estimated"
    return judge(
        _texts("error"),
        holds=None if high is None else low <= value <= high,
        angle=expected.angle,
        kind=KIND_NAMES[expected.kind],
        value=value,
        stated="" if expected.stated is None else f"{expected.stated:g} urad",
        limit="" if high is None else f"{low:g} to {high:g} urad" if low else f"at most {high:g} urad",
        source=expected.source,
        remark="; ".join(filter(None, [remark, expected.remark])),
    )
