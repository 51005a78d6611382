# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""prediction_truth: endpoints predicted between scans, against the independent truth.

``make prediction`` draws 60 arms with scans at 200 Hz and encoders at 1 kHz. Exit code 0: between scans the error is at
most 1.5 times that at scans, the errors are in the stated region as often as stated, and a reading costs at most 30 us.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import find_arm
from posor.reporting.command_line_parser import CommandLineParser, number_from, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.accuracy.consistency import REGION_LIMIT, MeanEstimate
from posor_lab.arm_study.prediction_truth import AHEAD, BETWEEN, GAPS, SCANS, PredictionTruth
from posor_lab.lab_output import end_study, parse_study
from posor_lab.reports.process_pool import draw_batches

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor_lab.arm_study.prediction_truth import Sample

ARM, ARMS, SEED = "five_axis", 60, 1985
STATED, TOLERANCE = 0.95, 0.02  # share of the poses inside their 95 % region
LARGEST_RATIO = 1.5  # rms error between scans over that at scans
LARGEST_COST_S = 30e-6  # of a reading of all encoders, median
MOTION = {False: "in motion", True: "at rest"}


def _summaries(truth: PredictionTruth, seeds: range) -> dict[tuple[str, bool], dict[str, float]]:
    """Return mean square error [m^2] and share inside the region of a drawn arm, by case and whether it is at rest."""
    (seed,) = seeds  # one arm in a batch
    return {key: summary(sample) for key, sample in truth.samples(seed).items()}


def summary(sample: Sample) -> dict[str, float]:
    """Return mean square error of the position [m^2], share inside the 95 % region, and share without a pose."""
    known = np.isfinite(sample.squares)
    return {
        "square": float(np.mean(np.sum(np.square(sample.errors[known]), axis=1))),
        "inside": float(np.mean(sample.squares <= REGION_LIMIT)),
        "missing": float(np.mean(~known)),
    }


def figures(arms: Sequence[Mapping[tuple[str, bool], Mapping[str, float]]]) -> dict[str, dict[str, float]]:
    """Return the figures of each case of many arms."""
    found = {}
    for case, at_rest in arms[0]:
        inside = MeanEstimate.of(np.array([arm[case, at_rest]["inside"] for arm in arms]))
        found[f"{case}, {MOTION[at_rest]}"] = {
            "rms_m": float(np.sqrt(np.mean([arm[case, at_rest]["square"] for arm in arms]))),
            "inside": inside.value,
            "inside_sigma": inside.sigma,
            "missing": float(np.mean([arm[case, at_rest]["missing"] for arm in arms])),
        }
    return found


def failures(found: Mapping[str, Mapping[str, float]], cost_s: float) -> list[str]:
    """Return what does not hold, one clause each."""
    wrong = []
    for motion in MOTION.values():
        ratio = found[f"{BETWEEN}, {motion}"]["rms_m"] / found[f"{SCANS}, {motion}"]["rms_m"]
        if not ratio <= LARGEST_RATIO:
            wrong.append(f"{motion}: the error between scans is {ratio:.2f} times that at scans")
        for case in (BETWEEN, AHEAD, GAPS):
            inside = found[f"{case}, {motion}"]["inside"]
            if not abs(inside - STATED) <= TOLERANCE:
                wrong.append(f"{case}, {motion}: {inside:.1%} inside; expected {STATED:.0%} +- {TOLERANCE:.0%}")
    if not cost_s <= LARGEST_COST_S:
        wrong.append(f"a reading costs {1e6 * cost_s:.1f} us; expected at most {1e6 * LARGEST_COST_S:g} us")
    return wrong


def sample_predictions(path: Path, arms: int, seconds: float, *, workers: int = 0) -> dict[str, dict[str, float]]:
    """Return the figures of drawn arms; ``workers``: number of processes, 0: one for each processor."""
    truth = partial(PredictionTruth, path, seconds)
    return figures(draw_batches(truth, _summaries, range(SEED, SEED + arms), 1, workers))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(
        prog="prediction_truth", description="Predicted endpoints against the independent truth."
    )
    parser.add_argument("--arms", type=whole_number_from(1), default=ARMS, help="arms drawn (default: %(default)s)")
    text = "part of the scenario that is run [s]; 0: all of it"
    parser.add_argument("--seconds", type=number_from(0.0, unit="s"), default=0.0, help=text)
    options = parse_study(parser, "build/prediction.json", arguments)
    path = find_arm(ARM)
    found = sample_predictions(path, options.arms, options.seconds)
    cost_s = PredictionTruth(path, 1.0).reading_cost()
    rows = [
        [case, f"{1e6 * each['rms_m']:.1f}", f"{each['inside']:.1%}", f"{each['missing']:.3%}"]
        for case, each in found.items()
    ]
    header = ("endpoint of five_axis", "rms error [µm]", "inside 95 % region", "without a pose")
    title = f"Simulated: {options.arms} arms, scans at 200 Hz, encoders at 1 kHz"
    console = report_console(140)
    ReportTable(title, header, rows).print(console)
    console.print(f"A reading of all encoders costs {1e6 * cost_s:.1f} µs (median).", markup=False)
    content = {"arms": options.arms, "cost_s": cost_s, "cases": found}
    return end_study("prediction_truth", failures(found, cost_s), options.output, content)
