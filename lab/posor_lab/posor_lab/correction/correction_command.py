# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""correction: a simulated robot on the path of an arm, with corrected programs and in an outer loop.

``make correction``. Exit code 0: the errors of every robot fall as stated, and each failure stops the correction in
time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor.correction.correct_command import PROGRAM_LIMITS
from posor.correction.joint_correction import CorrectionLimits
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.correction.correction_study import CorrectionStudy, PathErrors, failures, stop_after
from posor_lab.correction.simulated_robot import SimulatedRobot
from posor_lab.lab_output import end_study, parse_study
from posor_lab.reports.process_pool import ordered_map

if TYPE_CHECKING:
    from collections.abc import Sequence

RATE = 250  # of the robot's interface [Hz]
ROBOTS, SEED = 5, 1985
RUNS, SMOOTHING_S = 2, 0.01  # of the program
DEAD_TIMES_S = 0.03, 0.12
FAILS_S = 2.0  # after the begin of the motion
STOP_S = 0.2  # time in which a failure must stop the correction
LEAST_GAIN, LEAST_PEAK_GAIN = 20.0, 5.0
LEAST_LATE_GAIN = 10.0  # of the rms with the longest dead time, which leaves what changes meanwhile
UNCORRECTED, PROGRAM, LOOP, WITHOUT = "uncorrected", "program after run {}", "loop, dead time {:g} s", ", no encoders"


def study_robot(seed: int, rows: int | None = None) -> dict[str, PathErrors]:
    """Return the errors of the robot of a seed, by case; ``rows``: of the path, default: all."""
    study = CorrectionStudy(SimulatedRobot(load_arm_file("five_axis"), RATE, seed), rows)
    planned, *corrected = study.corrected(RUNS, PROGRAM_LIMITS, SMOOTHING_S)
    found = {UNCORRECTED: planned} | {PROGRAM.format(n): each for n, each in enumerate(corrected, start=1)}
    for dead_s in DEAD_TIMES_S:
        found[LOOP.format(dead_s)] = study.loop(dead_s, CorrectionLimits(lead_time=dead_s)).errors
    longest_s = max(DEAD_TIMES_S)
    limits = CorrectionLimits(lead_time=longest_s)
    found[LOOP.format(longest_s) + WITHOUT] = study.loop(longest_s, limits, assumed_s=longest_s).errors
    return found


def stop_times(seed: int, rows: int | None = None) -> dict[str, float]:
    """Return the time from each failure to the last change of the offsets [s]."""
    study, tick = CorrectionStudy(SimulatedRobot(load_arm_file("five_axis"), RATE, seed), rows), round(FAILS_S * RATE)
    runs = {name: study.loop(DEAD_TIMES_S[0], CorrectionLimits(), change=each) for name, each in failures(tick).items()}
    return {name: stop_after(run, tick, RATE) for name, run in runs.items()}


def least_gains(robots: Sequence[dict[str, PathErrors]]) -> dict[str, tuple[float, float]]:
    """Return the least gain of the rms and of the peaks at reversals, by case."""
    return {
        case: (
            min(each[UNCORRECTED].rms_m / each[case].rms_m for each in robots),
            min(each[UNCORRECTED].peak_m / each[case].peak_m for each in robots),
        )
        for case in robots[0]
    }


def findings(gains: dict[str, tuple[float, float]], stops: dict[str, float]) -> list[str]:
    """Return what does not hold, one clause each."""
    late = LOOP.format(max(DEAD_TIMES_S))
    least_rms = {
        case: LEAST_LATE_GAIN if case.startswith(late) else LEAST_GAIN for case in gains if case != UNCORRECTED
    }
    found = [
        f"{case}: {what} falls to 1/{gain:.1f}; expected 1/{least:g} at most"
        for case, least_gain in least_rms.items()
        for what, gain, least in zip(
            ("rms", "the peak at reversals"), gains[case], (least_gain, LEAST_PEAK_GAIN), strict=True
        )
        if not gain >= least
    ]
    slow = {name: after_s for name, after_s in stops.items() if not after_s <= STOP_S}
    return found + [f"{name}: stops after {after_s:g} s; expected {STOP_S:g} s" for name, after_s in slow.items()]


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="correction", description="Correction of simulated robots.")
    text = "drawn robots (default: %(default)s)"
    parser.add_argument("--robots", type=whole_number_from(1), default=ROBOTS, help=text)
    options = parse_study(parser, "build/correction.json", arguments)
    seeds = range(SEED, SEED + options.robots)
    robots, stops = ordered_map(study_robot, seeds), stop_times(SEED)
    gains = least_gains(robots)
    rows = []
    for case, (gain, peak_gain) in gains.items():
        rms, peak, whole = np.array([each[case] for each in robots]).T * 1e6
        cells = (np.sqrt(np.mean(rms**2)), np.max(peak), np.sqrt(np.mean(whole**2)))
        rows.append([case, *(f"{each:.1f}" for each in cells), f"{gain:.0f}", f"{peak_gain:.0f}"])
    header = ("case", "rms [µm]", "peak at reversals [µm]", "rms, whole path [µm]", "least gain: rms", "peak")
    title = f"Simulated: path of five_axis, {options.robots} robots, {RATE} Hz"
    ReportTable(title, header, rows).print(report_console(140))
    stopped = [[name, f"{1e3 * after_s:.0f}"] for name, after_s in stops.items()]
    ReportTable("Simulated: failures in motion", ("failure", "correction stops after [ms]"), stopped).print(
        report_console(140)
    )
    cases = {case: [each[case]._asdict() for each in robots] for case in gains}
    return end_study("correction", findings(gains, stops), options.output, {"robots": cases, "stops_s": stops})
