"""bringup: starts all nodes of an arm, watches them, says which ended and why, and ends all on Ctrl-C or SIGTERM."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.ros.main import WAKE_S, StopSignal, exit_code_of, own_arguments
from rich.console import Console

from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import checked_arm, installed_arms
from posor_bringup.command_line import LOGS, Parser, add_driver_parameters, prepare
from posor_bringup.layouts import LAYOUTS, laid_out
from posor_bringup.supervisor import Supervisor

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor_bringup.supervisor import RunningProgram


def parse(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="bringup", description="Start all nodes of an arm and watch them until Ctrl-C.")
    parser.add_argument(
        "arm",
        metavar="ARM",
        help=f"path of an arm file, or the name of an installed one: {', '.join(installed_arms())}",
    )
    parser.add_argument("--no-driver", action="store_true", help="without drivers: the scans come from elsewhere")
    parser.add_argument("--use-sim-time", action="store_true", help="all nodes take the time from /clock")
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        default="separate",
        help="a process for each node; one for all drivers and one for all else; one for everything; default: separate",
    )
    add_driver_parameters(parser)
    parser.add_argument(
        "--output", type=Path, default=Path("build/bringup"), metavar="FOLDER", help="logs; default: build/bringup"
    )
    return parser.parse_args(list(arguments))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all nodes ended as they were asked to."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of(lambda: _bring_up(argv))


def _bring_up(argv: Sequence[str]) -> None:
    options = parse(own_arguments(argv))
    console = Console(highlight=False, soft_wrap=True, markup=False)
    arm = checked_arm(options.arm)
    programs = arm_programs(
        arm,
        drivers=not options.no_driver,
        driver_parameters=dict(options.parameters),
        parameters={"use_sim_time": True} if options.use_sim_time else {},
    )
    folder = prepare(options.output / arm.name, (), "bringup")
    stop = StopSignal()
    try:
        with Supervisor(folder / LOGS) as supervisor:
            nodes, programs = len(programs), laid_out(programs, options.layout, folder)
            running = [supervisor.start(program) for program in programs]
            for started in running:
                console.print(f"{started.program.name}: process {started.process.pid}")
            console.print(f"{arm.name}: {nodes} nodes started, their logs in {folder / LOGS}; Ctrl-C ends them")
            _watch(supervisor, running, stop, console)
    finally:
        stop.restore()
    console.print(f"{arm.name}: all nodes have ended")


def _watch(supervisor: Supervisor, running: Sequence[RunningProgram], stop: StopSignal, console: Console) -> None:
    """Wait until asked to stop; say of each driver when it has come to its end, what it sent may still be on its way.

    Raises:
        ProcessError: A node ended as it should not.

    """
    drivers = [started for started in running if started.program.ends]
    while not stop.requested:
        supervisor.check()
        for driver in [driver for driver in drivers if driver.has_ended]:
            drivers.remove(driver)
            console.print(f"{driver.program.name}: has come to the end of its scans")
        time.sleep(WAKE_S)


if __name__ == "__main__":
    sys.exit(main())
