"""fuzz: damages messages and files at random and counts what the programs make of them.

The exit code is 0 only if no damaged message gives a wrong pose, the nodes answer every sound message and their memory
does not grow, and every reader of a file gives a result or one sentence. The rule is in ``docs/integrity.md``.
"""

from __future__ import annotations

import math
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_bringup.arms import load_checked_arm
from posor_ros.node_program import non_ros_arguments, ros_context
from posor_ros.ros_domain import isolated_network
from rich.console import Console

from posor_lab.fuzz.file_fuzz import FileFailureError, fuzz_files, readers
from posor_lab.fuzz.message_fuzz import ScanFuzz, TransformFuzz, fuzz_simulation
from posor_lab.fuzz.node_fuzz import MOST_GROWTH_MB, NodeFuzzError, NodeScanFuzz, NodeTransformFuzz
from posor_lab.reports.console_progress import InterruptedRunError, StageProgress

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Sequence

    from posor_drivers.simulator.arm_simulation import ArmSimulation

    from posor_lab.fuzz.message_fuzz import FuzzCount
    from posor_lab.fuzz.node_fuzz import NodeCount

SEED = 1985
STEP = 1000
"""Mutations between two looks at Ctrl-C."""


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value is invalid.

    """
    parser = CommandLineParser(prog="fuzz", description="Damage messages and files and count wrong poses.")
    parser.add_argument("--arm", default="six_axis", help="a simulated arm (default: six_axis)")
    parser.add_argument("--scans", type=int, default=1_000_000, metavar="N", help="damaged raw scans (1,000,000)")
    parser.add_argument("--transforms", type=int, default=1_000_000, metavar="N", help="damaged transforms (1,000,000)")
    parser.add_argument(
        "--nodes", type=int, default=50_000, metavar="N", help="damaged raw scans, and transforms, to nodes (50,000)"
    )
    parser.add_argument("--files", type=int, default=1000, metavar="N", help="damaged files of each format (1000)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the damage (default: {SEED})")
    options = parser.parse_args(list(arguments))
    for name in ("scans", "transforms", "nodes", "files"):
        if getattr(options, name) < 0:
            raise ParameterError(f"--{name} {getattr(options, name)}", where="fuzz", expected="0 or more")
    return options


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if nothing failed."""
    argv = sys.argv if arguments is None else arguments
    return int(bool(_run(parse_options(non_ros_arguments(argv)), argv)))


def _run(options: Namespace, argv: Sequence[str]) -> list[str]:
    console = Console(highlight=False, soft_wrap=True)
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        isolated_network(),
        ros_context(argv) as stop,
    ):

        def check() -> None:
            if stop.requested:
                raise InterruptedRunError("interrupted", where="fuzz")

        with StageProgress(console, check) as progress:
            simulation = fuzz_simulation(load_checked_arm(options.arm))
            counts = run_messages(simulation, options, progress)
            nodes, failures = run_nodes(simulation, options, Path(folder), progress)
            failures += run_files(options, Path(folder), progress)
    for name, node in nodes.items():
        growth = "memory not judged" if math.isnan(node.growth_mb) else f"memory grown by {node.growth_mb:.2f} MB"
        console.print(
            f"{name}: the slowest answer in {node.slowest_s:.2f} s, {node.acknowledged} faults acknowledged, {growth}"
        )
        counts[name] = node.messages
        if node.growth_mb >= MOST_GROWTH_MB:
            failures.append(f"{name}: memory grown by {node.growth_mb:.2f} MB; expected below {MOST_GROWTH_MB:g} MB")
    for name, count in counts.items():
        console.print(
            f"{name}: {count.mutations} damaged: {count.refused} refused, {count.unharmed} unharmed, {count.covered} "
            f"within the protection level, {count.possible} possible, {count.wrong} wrong"
        )
        failures += [f"{name}: {text}" for text in count.examples]
    for failure in failures:
        console.print(f"FAILS  {failure}", markup=False)
    console.print("Nothing failed." if not failures else "Something failed.")
    return failures


def run_messages(simulation: ArmSimulation, options: Namespace, progress: StageProgress) -> dict[str, FuzzCount]:
    """Return what became of damaged messages, by kind of message."""
    joints, counts = simulation.joints, {}
    runs: list[tuple[str, Callable[[], ScanFuzz | TransformFuzz], int]] = [
        (f"raw scans of {joint}", partial(ScanFuzz, simulation, joint, options.seed), options.scans // len(joints))
        for joint in joints
    ]
    runs.append(("transforms", partial(TransformFuzz, simulation, options.seed), options.transforms))
    for name, make, mutations in runs:
        if not mutations:
            continue
        fuzz = make()
        with progress.stage(name, mutations) as on_done:
            for begin in range(0, mutations, STEP):
                step = min(STEP, mutations - begin)
                fuzz.run(step)
                on_done(step)
        counts[name] = fuzz.count
    return counts


def run_nodes(
    simulation: ArmSimulation, options: Namespace, folder: Path, progress: StageProgress
) -> tuple[dict[str, NodeCount], list[str]]:
    """Return the figures of damaged messages to nodes, by node, and the failures.

    Raises:
        ProcessError: A node ended, or cannot be started.
        InterruptedRunError: The user interrupted the run.

    """
    joints, counts, failures = simulation.joints, {}, []
    runs: list[tuple[str, Callable[[], NodeScanFuzz | NodeTransformFuzz], int]] = [
        (f"posor_node of {joint}", partial(NodeScanFuzz, simulation, joint, options.seed), options.nodes // len(joints))
        for joint in joints
    ]
    runs.append(("chain_node", partial(NodeTransformFuzz, simulation, options.seed), options.nodes))
    for name, make, mutations in runs:
        if not mutations:
            continue
        fuzz = make()
        counts[name] = fuzz.count
        with progress.stage(name, mutations) as on_done:
            try:
                fuzz.run(mutations, folder, on_done)
            except NodeFuzzError as error:
                failures.append(f"{name}: {error}")
    return counts, failures


def run_files(options: Namespace, folder: Path, progress: StageProgress) -> list[str]:
    """Damage files of every format; return the failures."""
    failures = []
    for name in readers() if options.files else ():
        with progress.stage(f"{name} files", options.files) as on_done:
            try:
                count = fuzz_files(name, options.files, options.seed, folder)
            except FileFailureError as error:
                failures.append(str(error))
                continue
            on_done(count.mutations)
        progress.line(f"{name}: {count.refused} refused, {count.read} read, the slowest in {count.slowest_s:.2f} s")
    return failures


if __name__ == "__main__":
    sys.exit(main())
