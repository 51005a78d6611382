# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""bringup: starts all nodes of an arm, reports a node that fails, and ends all nodes on Ctrl-C or SIGTERM."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from posor.arm_names import describe_argument
from posor.chain.arm_file import CHAIN_NODE
from posor.claim import claim
from posor.errors import ParameterError, PosorError
from posor.node_parameters import RECORDING
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_ros.node_program import SPIN_TIMEOUT_S, StopSignal
from posor_ros.parameter_files import OPTION, parameter_files_of
from posor_ros.ros_arguments import split_ros_arguments
from rich.console import Console

from posor_bringup.arm_programs import LAYOUTS, endpoint_frame_of, frame_prefix_of, full_name, group_programs
from posor_bringup.arms import check_arm
from posor_bringup.bringup_options import LOGS, add_arm_parameters, add_namespace, prepare_output_folder
from posor_bringup.graph_observer import GraphObserver, enclave_of_arm
from posor_bringup.supervisor import Supervisor
from posor_bringup.tool_views import VIEWS, write_views

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence
    from socket import socket

    from posor_bringup.supervisor import RunningProgram


GRAPH_CHECK_S = 10.0
"""Time after the start in which the nodes of a second arm of the same name are looked for."""


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    parser = CommandLineParser(
        prog="posor bringup", description="Start all nodes of an arm and watch them until Ctrl-C."
    )
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument("--recording", action="store_true", help="accept stamps of any age, as those of a bag")
    parser.add_argument("--use-sim-time", action="store_true", help="all nodes take the time from /clock")
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        default="separate",
        help="one process for each node; one for all drivers and one for the rest; one for all; default: separate",
    )
    add_namespace(parser)
    text = "prefix of the frames of chain_node, such as cell1/, for arms of one URDF; default: that of the arm file"
    parser.add_argument("--frame-prefix", metavar="PREFIX", help=text)
    add_arm_parameters(parser)
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
    own, of_ros = split_ros_arguments(argv[1:])
    options = parse_options(own)
    options.params_file += parameter_files_of(of_ros)
    if len(of_ros) != 2 * len(parameter_files_of(of_ros)):
        expected = f"{OPTION} FILE, -p NAME:=VALUE of the drivers, or parameters in the arm file"
        raise ParameterError("ROS arguments do not reach the nodes", where="bringup", expected=expected)
    _run_arm(options)
    return 0


def _claim_of_folder(folder: Path) -> socket:
    """Return the claim of an output folder, whose logs another bringup, such as one of another domain, would delete."""
    what, expected = "another bringup writes there", "another folder, with --output"
    return claim(str(folder.resolve()), PosorError(what, where=str(folder), expected=expected))


def _run_arm(options: Namespace) -> None:
    console = Console(highlight=False, soft_wrap=True, markup=False, emoji=False)
    parameters: dict[str, bool | float] = dict(RECORDING) if options.recording else {}
    if options.use_sim_time:
        parameters["use_sim_time"] = True
    process = CHAIN_NODE if options.layout == "separate" else "compose"
    with GraphObserver(enclave_of_arm(options.arm, options.namespace, process)) as graph:
        checked = check_arm(
            options.arm,
            namespace=options.namespace,
            drivers=not options.no_driver,
            driver_parameters=dict(options.parameters),
            chain_parameters={} if options.frame_prefix is None else {"frame_prefix": options.frame_prefix},
            parameters=parameters,
            parameter_files=options.params_file,
        )
        arm, nodes = checked.arm, checked.programs
        names = [full_name(node) for node in nodes]
        folder = options.output / arm.namespace.lstrip("/")
        with graph.claim(arm.namespace, endpoint_frame_of(nodes)), _claim_of_folder(folder):
            graph.refuse_running(names)
            prepare_output_folder(folder, tuple(VIEWS.values()))
            write_views(arm, folder, frame_prefix_of(nodes))
            with StopSignal() as stop, Supervisor(folder / LOGS) as supervisor:
                running = [supervisor.start(program) for program in group_programs(nodes, options.layout, folder)]
                for started in running:
                    console.print(f"{started.program.name}: process {started.process.pid}")
                ends = "Ctrl-C ends them"
                console.print(f"{arm.name}: {len(nodes)} nodes started, their logs in {folder / LOGS}; {ends}")
                console.print(f"views for RViz, Foxglove and PlotJuggler: {', '.join(VIEWS.values())} in {folder}")
                _watch(supervisor, running, stop, console, lambda: graph.refuse_second(names))
    console.print(f"{arm.name}: all nodes have ended")


def _watch(
    supervisor: Supervisor,
    running: Sequence[RunningProgram],
    stop: StopSignal,
    console: Console,
    check_graph: Callable[[], None],
) -> None:
    """Wait for Ctrl-C; print a line when a driver has ended without an error.

    ``check_graph`` is called for a while: an arm that started at the same time was not known before. Raises
    ProcessError: a node failed; PosorError: of ``check_graph``.
    """
    graph_end_s = time.monotonic() + GRAPH_CHECK_S
    drivers = [started for started in running if started.program.ends]
    while not stop.requested:
        supervisor.check()
        if time.monotonic() < graph_end_s:
            check_graph()
        for driver in [driver for driver in drivers if driver.has_ended]:
            drivers.remove(driver)
            console.print(f"{driver.program.name}: has ended; all scans are played, or it was stopped")
        time.sleep(SPIN_TIMEOUT_S)
