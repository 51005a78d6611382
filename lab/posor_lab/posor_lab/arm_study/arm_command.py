# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""arm: study of a simulated arm: runs its nodes with and without a controller, draws many arms, writes a report.

The exit code is 0 only if every judged figure holds.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.output_files import write_files
from posor.reporting.command_line_parser import CommandLineParser, number_above, whole_number_from
from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import LOGS, add_driver_parameters, prepare_output_folder
from posor_bringup.supervisor import Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_ros.node_program import StopSignal, non_ros_arguments, ros_context
from rich.console import Console

from posor_lab.arm_study.arm_budget_command import arm_budget
from posor_lab.arm_study.arm_coverage import ARMS, POSES, Coverage, arm_coverage
from posor_lab.arm_study.arm_receiver import ArmReceiver
from posor_lab.arm_study.arm_record import count_outcomes
from posor_lab.arm_study.arm_report import ArmOutcome, arm_figures, arm_findings, arm_page
from posor_lab.arm_study.arm_run import ArmLiveTable, ArmRun
from posor_lab.arm_study.shared_arm import write_shared_arm
from posor_lab.harness.ros_domain import isolated_network
from posor_lab.lab_output import write_json
from posor_lab.reports.console_progress import StageProgress, interruption_check
from posor_lab.reports.findings import COMPARISON_HEADINGS, exit_code_of_findings, print_findings, print_verdict

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor.chain.arm_file import ArmFile

    from posor_lab.reports.findings import Findings

OUTPUTS = ("report.html",)
BUDGET_DRAWS = 500
TRUTH = "independent"  # model of the readings of the live run
MIN_ARMS = 2  # number of arms with a standard deviation


def _parse_options(arguments: Sequence[str]) -> Namespace:
    parser = CommandLineParser(prog="arm", description="Run a simulated arm and report how well its endpoint is known.")
    add = parser.add_argument
    add("--arm", default="five_axis", metavar="ARM", help="name or path (default: five_axis)")
    add("--controller", type=Path, metavar="FILE.py", help="endpoint controller for a second cycle")
    default = "length of each cycle (default: that of the scenario)"
    add("--seconds", type=number_above(0.0, unit="s"), metavar="S", help=default)
    default = f"arms drawn for the coverage, 0: none (default: {ARMS})"
    add("--arms", type=whole_number_from(0), default=ARMS, metavar="N", help=default)
    add("--coverage-only", action="store_true", help="draw arms, start no node")
    default = "report; the figures go to FOLDER.json (default: build/arm)"
    add("--shared-terms", action="store_true", help="of an arm whose files state errors common to all parts")
    add("--output", type=Path, default=Path("build/arm"), metavar="FOLDER", help=default)
    add("--no-live", action="store_true", help="lines instead of a live table")
    add_driver_parameters(parser)
    options = parser.parse_args(list(arguments))
    if 0 < options.arms < MIN_ARMS:
        raise ParameterError(f"--arms {options.arms}", where="arm", expected=f"0, or at least {MIN_ARMS}")
    if options.coverage_only and not options.arms:
        raise ParameterError("--coverage-only with --arms 0", where="arm", expected=f"at least {MIN_ARMS} arms")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study as a program; the exit code is 0 if all judged figures hold."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of_findings(lambda: _study_arm(_parse_options(non_ros_arguments(argv)), argv))


def _study_arm(options: Namespace, argv: Sequence[str]) -> Findings:
    """Run the study and write its report."""
    console = Console(highlight=False)
    arm = load_checked_arm(options.arm)
    if options.shared_terms:
        arm = load_checked_arm(str(write_shared_arm(arm, options.output.with_name(f"{options.output.name}_shared"))))
    console.print(f"{arm.name}: preparing the simulation", soft_wrap=True, markup=False)
    simulation = _checked_simulation(arm, options)
    folder = prepare_output_folder(options.output, OUTPUTS)
    outcome = ArmOutcome()
    if not options.coverage_only:
        outcome = _run_nodes(options, argv, simulation, folder / LOGS, console)
    coverage = _measure_coverage(arm, options.arms, console) if options.arms and arm.beams is not None else None
    console.print(f"{arm.name}: evaluating", soft_wrap=True, markup=False)
    outcome = replace(outcome, coverage=coverage, budget=arm_budget(arm, BUDGET_DRAWS))
    findings = arm_findings(outcome)
    write_files({folder / "report.html": arm_page(arm, simulation.scenario, outcome, findings)})
    print_findings(findings, console, f"{arm.name}: findings", COMPARISON_HEADINGS)
    write_json(options.output.with_name(f"{options.output.name}.json"), arm_figures(outcome))
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)
    print_verdict(findings, console)
    return findings


def _checked_simulation(arm: ArmFile, options: Namespace) -> ArmSimulation:
    """Return the simulation of an arm with the options' driver parameters; the drivers refuse invalid parameters."""
    if arm.driver.source != "simulated":
        expected = "'simulated', whose truth is known"
        raise ParameterError(f"source '{arm.driver.source}'", where=str(arm.path), expected=expected)
    if options.coverage_only and arm.beams is None:
        what = "has no beams file, without which no arms are drawn"
        raise ParameterError(what, where=str(arm.path), expected="an arm with beams, or no --coverage-only")
    parameters = {name.removeprefix("simulated."): value for name, value in options.parameters}
    known = {name: bool(value) for name, value in parameters.items() if name in Imperfections.model_fields}
    simulation = ArmSimulation(arm, Imperfections(**known), truth=str(parameters.get("truth", TRUTH)))
    if options.controller is not None and simulation.scenario.stage is None:
        what = "the scenario has no stage, which a controller could move"
        raise ParameterError(what, where=str(arm.scenario), expected="no --controller")
    if options.controller is not None and not options.controller.is_file():
        raise ParameterError(f"there is no file {options.controller}", where="arm", expected="a Python program")
    return simulation


def _run_nodes(
    options: Namespace, argv: Sequence[str], simulation: ArmSimulation, logs: Path, console: Console
) -> ArmOutcome:
    """Run one cycle without a controller, and one with it if there is one."""
    scenario, arm = simulation.scenario, simulation.arm
    ticks = scenario.cycle_ticks if options.seconds is None else math.ceil(options.seconds * scenario.ticks_per_second)
    with (
        isolated_network(),
        ros_context(argv) as stop,
        Supervisor(logs) as supervisor,
        ArmReceiver(arm.name, simulation.chain, stage=scenario.stage is not None) as receiver,
        ArmLiveTable(f"{arm.name}, simulated", console, live=not options.no_live) as table,
    ):
        parameters = {"simulated.truth": TRUTH, **dict(options.parameters)}
        run = ArmRun(
            simulation, supervisor, receiver, table, driver_parameters=parameters, interrupted=lambda: stop.requested
        )
        run.start_nodes()
        records = [run.run_cycle("without controller", ticks)]
        if options.controller is not None:
            run.start_controller(options.controller)
            records.append(run.run_cycle("with controller", ticks))
        table.show_state("reading the counters")
        counters = run.read_counters()
        run.end_nodes()
    before, after = records[0], records[1] if options.controller is not None else None
    return ArmOutcome(before, after, count_outcomes(records, simulation, counters))


def _measure_coverage(arm: ArmFile, arms: int, console: Console) -> Coverage:
    """Draw many arms and show the progress."""
    title = f"{arm.name}: drawing {arms} arms, {POSES} poses of each"
    if not console.is_terminal:
        console.print(title, soft_wrap=True, markup=False)
    with (
        StopSignal() as stop,
        StageProgress(console, interruption_check(stop, "arm")) as progress,
        progress.stage(title, arms) as on_drawn,
    ):
        return arm_coverage(arm, arms, on_drawn=on_drawn)
