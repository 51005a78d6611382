# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""statement_truth: U of ``posor statement`` against arms drawn with the independent truth.

``make statement-truth`` draws five_axis, six_axis and an arm of four joints as ``posor arm new`` makes it, with shared
errors, each at 20 poses.
"""

from __future__ import annotations

import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.arm_names import find_arm
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.arm_study.statement_truth import Drawn, StatementTruth, write_four_joint_arm
from posor_lab.lab_output import parse_study, write_json
from posor_lab.reports.process_pool import draw_batches

if TYPE_CHECKING:
    from collections.abc import Sequence

ARMS, FOUR_JOINTS = ("five_axis", "six_axis"), "four_joint"
POSES, DRAWS, SEED, BATCH = 20, 2000, 1985, 50
DEVIATION = 0.5  # of the temperature of the beams [K], so that it does not hide the other causes
TOLERANCE = 0.05  # of U


def draw_arm(path: Path, poses: int, draws: int, seed: int, deviation: float) -> Drawn:
    """Draw arms with the files of an arm."""
    truth = partial(StatementTruth, path, poses, seed, deviation=deviation)
    errors = draw_batches(truth, StatementTruth.errors, range(seed, seed + draws), BATCH)
    return Drawn(truth().stated, np.concatenate(errors))


def figures(drawn: Drawn) -> dict[str, Any]:
    """Return what is compared, for one arm."""
    ratios, largest, coverage = drawn.ratios(), drawn.largest_ratios(), drawn.coverage()
    return {
        "draws": len(drawn.errors),
        "poses": len(drawn.stated),
        "largest_U_m": max(each.largest for each in drawn.stated),
        "U_drawn_over_stated": [float(largest.min()), float(largest.max())],
        "u_of_axes_drawn_over_stated": [float(ratios.min()), float(ratios.max())],
        "coverage_of_U": [float(coverage.min()), float(coverage.max())],
        "confirmed": bool(np.abs(largest - 1.0).max() <= TOLERANCE),
    }


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: U is confirmed to 5 % for all arms."""
    parser = CommandLineParser(prog="statement_truth", description="U of statements against the independent truth.")
    count = whole_number_from(1)
    parser.add_argument("--draws", type=count, default=DRAWS, help="arms drawn of each (default: %(default)s)")
    parser.add_argument("--poses", type=count, default=POSES, help="poses of each arm (default: %(default)s)")
    options = parse_study(parser, "build/statement_truth.json", arguments)
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: find_arm(name) for name in ARMS}
        paths[FOUR_JOINTS] = write_four_joint_arm(Path(folder))
        for name, path in paths.items():
            found[name] = figures(draw_arm(path, options.poses, options.draws, SEED, DEVIATION))
            sys.stderr.write(f"{name}: U drawn over stated {found[name]['U_drawn_over_stated']}\n")
    rows = [
        [
            name,
            f"{1e6 * each['largest_U_m']:.1f}",
            *(
                "{:.3f} to {:.3f}".format(*each[key])
                for key in ("U_drawn_over_stated", "u_of_axes_drawn_over_stated", "coverage_of_U")
            ),
            "yes" if each["confirmed"] else "no",
        ]
        for name, each in found.items()
    ]
    header = ("arm", "largest U [µm]", "U: drawn / stated", "u of each axis: drawn / stated", "coverage", "within 5 %")
    title = f"Simulated: {options.draws} arms of each at {options.poses} poses, beams within {DEVIATION:g} K"
    ReportTable(title, header, rows).print(report_console(140))
    write_json(options.output, found)
    return 0 if all(each["confirmed"] for each in found.values()) else 1
