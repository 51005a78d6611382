# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""demo: replays a motion test of 1985 through the nodes, shows it live, compares it with the thesis, writes a report.

Exit code 0 only if the comparison holds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor.calibration.calibration_file import load_calibration
from posor.output_files import write_files
from posor_bringup.bringup_options import LOGS, prepare_output_folder
from posor_bringup.supervisor import Supervisor
from posor_ros.node_program import non_ros_arguments, ros_context
from rich.console import Console

from posor_lab.harness.rig_files import BAGS, CALIBRATIONS, JOINT, bag_path, calibration_path, urdf_path
from posor_lab.harness.ros_domain import isolated_network
from posor_lab.replay_1985.comparison import compare_with_thesis, reasons
from posor_lab.replay_1985.motion_test import MotionTest
from posor_lab.replay_1985.printed_results import (
    EXPECTED_ERRORS_FILE,
    PRINTED_FILES,
    read_predicted_errors,
    read_printed,
)
from posor_lab.replay_1985.replay import Replay, ReplayPlan, StepCollector
from posor_lab.replay_1985.replay_report import HEADINGS, replay_page, replay_provenance, verdict_sentence
from posor_lab.replay_1985.step_table import LiveTable, steps_as_csv
from posor_lab.reports.findings import exit_code_of_findings, print_findings
from posor_lab.reports.trial_program import Option
from posor_lab.reports.trial_program import parse_options as parse
from posor_lab.thesis_data import data_path

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence

    from posor_lab.harness.rig_files import Bag, CalibrationName
    from posor_lab.reports.findings import Findings

OUTPUT_FILES = ("report.html", "steps.csv", "bag")  # content of the report's folder besides the logs
MOTIONS: Mapping[Bag, str] = {
    "ymo": "Y motion, side to side",
    "yzmo": "diagonal motion, Y and Z together",
    "zmo": "Z motion, up and down",
}
STATES: Mapping[CalibrationName, str] = {
    "printed": "as in the printed tables, zero shifts not compensated",
    "section84": "as in section 8.4, zero shifts compensated",
}


OPTIONS = (
    Option("--bag", "ymo", "motion test", choices=BAGS),
    Option("--calibration", "printed", "state to reproduce", choices=CALIBRATIONS),
    Option("--output", Path("build/report"), "folder of the report"),
    Option("--rate", 1.0, "speed, 1 is real time, 0 as fast as possible", least=0.0, most=1e6),
    Option("--no-live", default=False, text="plain lines instead of a live table"),
)


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value invalid."""
    return parse("demo", "Replay a motion test of 1985 and compare it with the thesis.", OPTIONS, arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if the comparison holds."""
    return exit_code_of_findings(lambda: _run(sys.argv if arguments is None else arguments))


def _run(argv: Sequence[str]) -> Findings:
    """Replay, compare and report."""
    options = parse_options(non_ros_arguments(argv))
    console = Console(highlight=False)
    folder = prepare_output_folder(options.output / f"{options.bag}_{options.calibration}", OUTPUT_FILES)
    plan = ReplayPlan(
        bag=bag_path(options.bag),
        calibration=calibration_path(options.calibration),
        session=options.bag,
        urdf=urdf_path(),
        output=folder,
        rate=options.rate,
    )
    title = (
        f"POSOR, test {options.bag.upper()} of 1985: {MOTIONS[options.bag]}\n"
        f"calibration '{options.calibration}': {STATES[options.calibration]}"
    )
    test, identity = _replay(plan, argv, LiveTable(title, console, live=not options.no_live))
    comparison = _write_report(options, title, plan, test, identity)
    print_findings(comparison, console, "comparison with the thesis", HEADINGS)
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)
    console.print(verdict_sentence(comparison), style="green" if comparison.holds else "bold red")
    return comparison


def _replay(plan: ReplayPlan, argv: Sequence[str], table: LiveTable) -> tuple[MotionTest, Mapping[str, str]]:
    """Run the graph; return the steps and the identity of the POSOR node's calibration."""
    with (
        isolated_network(),
        ros_context(argv) as stop,
        Supervisor(plan.output / LOGS) as supervisor,
        StepCollector(JOINT) as collector,
    ):
        with table:
            replay = Replay(plan, supervisor, collector, on_steps=table.show, interrupted=lambda: stop.requested)
            replay.start()
            replay.activate_driver()
            replay.wait_for_end()
        replay.stop()
        return MotionTest(tuple(collector.complete_steps())), replay.calibration_identity()


def _write_report(
    options: Namespace, title: str, plan: ReplayPlan, test: MotionTest, identity: Mapping[str, str]
) -> Findings:
    """Compare the steps with the thesis and write all files of the report."""
    table = PRINTED_FILES.get(options.bag)
    printed = read_printed(data_path(table)) if table else None
    comparison = compare_with_thesis(test, options.bag, options.calibration, printed)
    calibration = load_calibration(plan.calibration)
    page = replay_page(
        title,
        test=test,
        comparison=comparison,
        printed=printed if options.calibration == "printed" else None,
        reasons=reasons(options.bag, options.calibration),
        predictions=read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), options.bag),
        calibration=calibration,
        provenance=replay_provenance(plan.bag, calibration, plan.calibration, identity),
    )
    write_files({plan.output / "report.html": page, plan.output / "steps.csv": steps_as_csv(test)})
    return comparison
