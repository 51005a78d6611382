# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""calibration_truth: calibration of whole arms against the independent truth; or the files of one such calibration.

``make calibration-truth`` draws 100 arms, calibrates each from 40 poses, and compares it at 200 others.
"""

from __future__ import annotations

import tempfile
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from posor.chain.arm_file import load_arm_file
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.arm_study.calibration_truth import CalibrationTruth, Consistency, Outcome, write_assembled_arm
from posor_lab.arm_study.tracker_recording import write_calibration_recording
from posor_lab.lab_output import parse_study, write_json
from posor_lab.reports.process_pool import draw_batches

if TYPE_CHECKING:
    from collections.abc import Sequence

ARM, USED, TESTED, ARMS, SEED, BATCH = "five_axis", 40, 200, 100, 1985, 5


def calibrated_arms(path: Path, used: int, tested: int, arms: int) -> list[Outcome]:
    """Return the outcomes of drawn arms."""
    truth = partial(CalibrationTruth, path, used, tested, SEED)
    return list(chain(*draw_batches(truth, CalibrationTruth.outcomes, range(SEED, SEED + arms), BATCH)))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the errors are of the stated size, or the files are written."""
    parser = CommandLineParser(prog="calibration_truth", description="Calibrated arms against the independent truth.")
    count = whole_number_from(1)
    parser.add_argument("--arms", type=count, default=ARMS, help="arms drawn (default: %(default)s)")
    parser.add_argument("--poses", type=count, default=USED, help="poses of each calibration (default: %(default)s)")
    parser.add_argument("--tested", type=count, default=TESTED, help="poses that are compared (default: %(default)s)")
    text = "write arm, bag, table and map of one simulated calibration, in place of the comparison"
    parser.add_argument("--files", type=Path, metavar="FOLDER", help=text)
    options = parse_study(parser, "build/calibration_truth.json", arguments)
    arm = load_arm_file(ARM)
    if options.files is not None:
        write_calibration_recording(arm, options.files, options.poses, SEED)
        print(f"arm.yaml, bag, tracker.csv, map.yaml: {options.files}")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = write_assembled_arm(arm, Path(folder))
        found = Consistency.of(calibrated_arms(path, options.poses, options.tested, options.arms))
    title = (
        f"Simulated: {ARM}, {options.arms} arms, {options.poses} poses of a tracker, errors at {options.tested} others"
    )
    header = ("rms before [µm]", "rms after [µm]", "NEES / 6", "its 95 % band", "within 95 %", "consistent")
    row = [
        *(f"{1e6 * each:.1f}" for each in (found.before_rms, found.after_rms)),
        f"{found.nees:.3f}",
        "{:.3f} to {:.3f}".format(*found.band),
        f"{100.0 * found.within_95:.1f} %",
        "yes" if found.in_band else "no",
    ]
    ReportTable(title, header, [row]).print(report_console(140))
    write_json(options.output, {**found._asdict(), "poses": options.poses, "tested": options.tested})
    return 0 if found.in_band else 1
