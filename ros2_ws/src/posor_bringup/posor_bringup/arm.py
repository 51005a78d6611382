"""arm: runs a simulated arm, shows how well its endpoint is known, with and without a controller, and writes a report.

Exit code 0 only if every figure that is judged holds.
"""

from __future__ import annotations

import math
import sys
from argparse import ArgumentTypeError
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from posor_drivers.simulator.arm import ArmSimulation
from posor_drivers.simulator.switches import Switches
from posor_estimator.accuracy.report import write_json
from posor_estimator.errors import ParameterError
from posor_estimator.ros.domain import own_network
from posor_estimator.ros.main import StopSignal, exit_code_of, own_arguments, ros
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from posor_bringup.arm_accounts import accounts
from posor_bringup.arm_budget import arm_budget
from posor_bringup.arm_coverage import ARMS, POSES, Coverage, coverage
from posor_bringup.arm_findings import ArmOutcome, findings
from posor_bringup.arm_live_table import ArmLiveTable
from posor_bringup.arm_receiver import ArmReceiver
from posor_bringup.arm_report import HEADINGS, figures_of, write_report
from posor_bringup.arm_run import ArmPlan, ArmRun
from posor_bringup.arms import checked_arm
from posor_bringup.command_line import LOGS, Parser, add_driver_parameters, prepare
from posor_bringup.findings_table import print_findings
from posor_bringup.supervisor import Supervisor
from posor_bringup.watch import InterruptedRunError

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.arm import Arm

    from posor_bringup.findings import Findings
    from posor_bringup.supervisor import Parameter

MADE_HERE = ("report.html", "report.png")
"""What a report's folder holds beside the logs."""
BUDGET_DRAWS = 500
LEAST_ARMS = 2
"""Fewer have no spread."""


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise ArgumentTypeError(f"'{text}' is no duration, a number greater than 0")
    return seconds


def parse(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="arm", description="Run a simulated arm and report how well its endpoint is known.")
    parser.add_argument("--arm", default="five_axis", metavar="ARM", help="name or path (default: five_axis)")
    parser.add_argument("--controller", type=Path, metavar="FILE.py", help="endpoint controller for a second part")
    parser.add_argument(
        "--seconds", type=_seconds, metavar="S", help="length of each part (default: one cycle of the scenario)"
    )
    parser.add_argument(
        "--arms", type=int, default=ARMS, metavar="N", help=f"arms to draw for the coverage, 0: none (default: {ARMS})"
    )
    parser.add_argument("--coverage-only", action="store_true", help="draw arms, start no node")
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("build/arm"),
        metavar="FOLDER",
        help="report; the figures go to FOLDER.json (default: build/arm)",
    )
    parser.add_argument("--no-live", action="store_true", help="plain lines instead of a live table")
    add_driver_parameters(parser)
    options = parser.parse_args(list(arguments))
    if options.arms < 0 or 0 < options.arms < LEAST_ARMS:
        raise ParameterError(f"--arms {options.arms}", where="arm", expected=f"0, or at least {LEAST_ARMS}")
    if options.coverage_only and not options.arms:
        raise ParameterError("--coverage-only with --arms 0", where="arm", expected=f"at least {LEAST_ARMS} arms")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo as a program."""
    argv = sys.argv if arguments is None else arguments
    verdicts: list[Findings] = []
    code = exit_code_of(lambda: verdicts.append(_arm(argv)))
    return code or int(not verdicts[0].holds)


def _arm(argv: Sequence[str]) -> Findings:
    options = parse(own_arguments(argv))
    console = Console(highlight=False)
    arm = checked_arm(options.arm)
    if arm.driver.source != "simulated":
        raise ParameterError(
            f"source '{arm.driver.source}'", where=str(arm.path), expected="'simulated', which has a truth"
        )
    simulation = ArmSimulation(arm, _switches(dict(options.parameters)))
    if options.controller is not None and simulation.scenario.stage is None:
        raise ParameterError(
            "the scenario has no stage, which a controller could move",
            where=str(arm.scenario),
            expected="no --controller",
        )
    if options.controller is not None and not options.controller.is_file():
        raise ParameterError(f"there is no file {options.controller}", where="arm", expected="a Python program")
    folder = prepare(options.output, MADE_HERE, "arm")
    outcome = ArmOutcome()
    if not options.coverage_only:
        outcome = _run(options, argv, simulation, folder, console)
    drawn = _drawn(arm, options.arms, console) if options.arms and arm.beams is not None else None
    outcome = outcome.with_computed(drawn, arm_budget(arm, BUDGET_DRAWS))
    found = findings(outcome)
    write_report(folder, arm, simulation.scenario, outcome, found)
    print_findings(found, console, f"{arm.name}: what was found", HEADINGS)
    write_json(options.output.with_name(f"{options.output.name}.json"), figures_of(outcome))
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)
    if found.holds:
        console.print("Everything holds.", style="green")
    else:
        console.print("Not everything holds.", style="bold red")
    return found


def _switches(parameters: Mapping[str, Parameter]) -> Switches:
    """Return what the drivers simulate when they get these parameters; they themselves refuse what is wrong."""
    prefix = "simulated."
    names = {field.name for field in fields(Switches)}
    given = {name.removeprefix(prefix): bool(value) for name, value in parameters.items() if name.startswith(prefix)}
    return replace(Switches(), **{name: value for name, value in given.items() if name in names})


def _run(
    options: Namespace, argv: Sequence[str], simulation: ArmSimulation, folder: Path, console: Console
) -> ArmOutcome:
    """Run the arm's nodes: one part without controller, one with it if there is one."""
    scenario, arm = simulation.scenario, simulation.arm
    ticks = scenario.cycle_ticks if options.seconds is None else math.ceil(options.seconds * scenario.ticks_per_second)
    plan = ArmPlan(simulation, ticks, folder / LOGS, options.controller, dict(options.parameters))
    with own_network(), ros(argv) as stop, Supervisor(plan.logs) as supervisor:
        receiver = ArmReceiver(arm.name, simulation.chain, stage=scenario.stage is not None)
        try:
            with ArmLiveTable(f"{arm.name}, simulated", console, live=not options.no_live) as table:
                run = ArmRun(plan, supervisor, receiver, table, interrupted=lambda: stop.requested)
                run.begin()
                records = [run.cycle("without controller")]
                if plan.controller is not None:
                    run.control()
                    records.append(run.cycle("with controller"))
                table.say("counting up")
                counted = run.counted()
                run.finish()
        finally:
            receiver.close()
    return ArmOutcome(
        before=records[0],
        after=records[1] if plan.controller is not None else None,
        accounts=accounts(records, simulation, counted),
    )


def _drawn(arm: Arm, arms: int, console: Console) -> Coverage:
    """Draw many arms, and show how far that is."""
    stop = StopSignal()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    title = f"{arm.name}: drawing {arms} arms, {POSES} poses of each"
    if not console.is_terminal:
        console.print(title)
    try:
        with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
            task = progress.add_task(title, total=arms)

            def on_drawn(more: int) -> None:
                if stop.requested:
                    raise InterruptedRunError("interrupted", where="arm")
                progress.advance(task, more)

            return coverage(arm, arms, on_drawn=on_drawn)
    finally:
        stop.restore()


if __name__ == "__main__":
    sys.exit(main())
