"""bringup: starts all nodes of an arm, reports a node that fails, and ends all nodes on Ctrl-C or SIGTERM."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from posor.node_parameters import RECORDING
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_ros.node_program import SPIN_TIMEOUT_S, StopSignal, non_ros_arguments
from rich.console import Console

from posor_bringup.arm_programs import LAYOUTS, arm_programs, group_programs
from posor_bringup.arms import installed_arms, load_checked_arm
from posor_bringup.bringup_options import LOGS, add_driver_parameters, prepare_output_folder
from posor_bringup.supervisor import Supervisor
from posor_bringup.tool_views import VIEWS, write_views

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor_bringup.supervisor import RunningProgram


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    parser = CommandLineParser(
        prog="posor bringup", description="Start all nodes of an arm and watch them until Ctrl-C."
    )
    parser.add_argument(
        "arm", metavar="ARM", help=f"path of an arm file, or name of an installed arm: {', '.join(installed_arms())}"
    )
    parser.add_argument("--no-driver", action="store_true", help="without drivers: the scans come from elsewhere")
    parser.add_argument("--recording", action="store_true", help="accept stamps of any age, as those of a bag")
    parser.add_argument("--use-sim-time", action="store_true", help="all nodes take the time from /clock")
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        default="separate",
        help="one process for each node; one for all drivers and one for the rest; one for all; default: separate",
    )
    add_driver_parameters(parser)
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("build/bringup"),
        metavar="FOLDER",
        help="logs and views; default: build/bringup",
    )
    return parser.parse_args(list(arguments))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all nodes ended without error."""
    argv = sys.argv if arguments is None else arguments
    _run_arm(parse_options(non_ros_arguments(argv)))
    return 0


def _run_arm(options: Namespace) -> None:
    console = Console(highlight=False, soft_wrap=True, markup=False)
    arm = load_checked_arm(options.arm)
    parameters: dict[str, bool | float] = dict(RECORDING) if options.recording else {}
    if options.use_sim_time:
        parameters["use_sim_time"] = True
    nodes = arm_programs(
        arm, drivers=not options.no_driver, driver_parameters=dict(options.parameters), parameters=parameters
    )
    folder = prepare_output_folder(options.output / arm.name, tuple(VIEWS.values()))
    write_views(arm, folder)
    with StopSignal() as stop, Supervisor(folder / LOGS) as supervisor:
        running = [supervisor.start(program) for program in group_programs(nodes, options.layout, folder)]
        for started in running:
            console.print(f"{started.program.name}: process {started.process.pid}")
        console.print(f"{arm.name}: {len(nodes)} nodes started, their logs in {folder / LOGS}; Ctrl-C ends them")
        console.print(f"views for RViz, Foxglove and PlotJuggler: {', '.join(VIEWS.values())} in {folder}")
        _watch(supervisor, running, stop, console)
    console.print(f"{arm.name}: all nodes have ended")


def _watch(supervisor: Supervisor, running: Sequence[RunningProgram], stop: StopSignal, console: Console) -> None:
    """Wait for Ctrl-C; print a line when a driver has played all its scans. Raises ProcessError: a node failed."""
    drivers = [started for started in running if started.program.ends]
    while not stop.requested:
        supervisor.check()
        for driver in [driver for driver in drivers if driver.has_ended]:
            drivers.remove(driver)
            console.print(f"{driver.program.name}: all scans have been played")
        time.sleep(SPIN_TIMEOUT_S)


if __name__ == "__main__":
    sys.exit(main())
