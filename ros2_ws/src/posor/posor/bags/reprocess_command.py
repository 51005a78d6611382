# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""reprocess: from recorded raw scans to transforms and endpoint poses, the same numbers as in the live graph."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from posor.arm_names import describe_argument
from posor.bags.executors import dask_cluster, local_processes, run_tasks
from posor.bags.offline_pipeline import reprocess_bag, topics_of
from posor.bags.reprocess_task import FORMATS, JointSettings, Settings, Summary, Task
from posor.bags.result_folder import check_outside_of_bags, check_replaceable, clear_unfinished, name_of_bag
from posor.chain.arm_file import load_arm_file
from posor.errors import ParameterError
from posor.lazy_program import EXIT_INTERRUPTED, handle_interrupts, interrupts_handled
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.progress import progress_display

if TYPE_CHECKING:
    import argparse
    from collections.abc import Collection, Iterator, Sequence


WIDTH = 118


def parser() -> CommandLineParser:
    """Return the parser of the command line."""
    command = CommandLineParser(
        prog="posor reprocess", description="From recorded raw scans to transforms and endpoint poses."
    )
    command.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folder of a rosbag2 bag, or its file")
    command.add_argument("--arm", metavar="ARM", help=f"URDF, beams and calibrations: {describe_argument()}")
    text = "calibration file of a joint's POSOR; may be repeated; replaces that of the arm file"
    command.add_argument("--calibration", action="append", default=[], metavar="JOINT=FILE", help=text)
    text = "session of the joint's calibration file"
    command.add_argument("--session", action="append", default=[], metavar="JOINT=NAME", help=text)
    text = "topic of the joint's raw scans (default: the only one that ends in /JOINT/raw, or that of the arm)"
    command.add_argument("--topic", action="append", default=[], metavar="JOINT=TOPIC", help=text)
    command.add_argument("--urdf", type=Path, help="robot description; without it, only transforms are written")
    command.add_argument("--beams", type=Path, help="beams file")
    command.add_argument("--endpoint-frame", metavar="LINK", help="link of the URDF that is the endpoint")
    command.add_argument("--acceleration-window", type=float, metavar="S", help="as the parameter of chain_node [s]")
    command.add_argument("--reference", choices=("absolute", "home"), help="as the parameter of chain_node")
    command.add_argument("--false-alarm", type=float, metavar="P", help="as the parameter of posor_node")
    text = "folder for the results; of several bags, a folder of such folders (default: only a summary)"
    command.add_argument("--output", type=Path, help=text)
    command.add_argument("--format", choices=FORMATS, default="bag", help="of the results (default: bag)")
    command.add_argument("--force", action="store_true", help="replace existing results")
    command.add_argument(
        "--jobs", type=whole_number_from(1), default=1, metavar="N", help="bags at a time, each in its own process"
    )
    command.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster whose workers see the same files")
    text = "use a --scheduler on another machine without TLS: whoever reaches it runs code on its workers"
    command.add_argument("--unencrypted", action="store_true", help=text)
    return command


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all bags were reprocessed."""
    try:
        with interrupts_handled(_interrupt_once):
            _run(parser().parse_args(arguments))
    except KeyboardInterrupt:
        sys.stderr.write("reprocess: interrupted; what was not finished is not there.\n")
        return EXIT_INTERRUPTED
    return 0


def _interrupt_once(_number: int, _frame: object) -> None:
    """Raise KeyboardInterrupt; later signals must not disturb the clean-up."""
    handle_interrupts(signal.SIG_IGN)
    raise KeyboardInterrupt


def _run(options: argparse.Namespace) -> None:
    tasks = tasks_of(options)
    _check(options, tasks)
    console = Console(width=WIDTH)
    try:
        for summary in _run_tasks(options, tasks):
            print_summary(summary, console)
    finally:
        for task in tasks:
            if task.output is not None:
                clear_unfinished(task.output.parent, task.run)


def tasks_of(options: argparse.Namespace) -> list[Task]:
    """Return the tasks of a parsed command line.

    Raises ParameterError: options contradict one another; CalibrationError: the arm file is invalid; NodeError: the arm
    file gives chain_node an invalid parameter.
    """
    settings = _settings(options)
    names = [name_of_bag(bag) for bag in options.bags]
    for name in names:
        if options.output is not None and names.count(name) > 1:
            raise ParameterError(
                f"two bags are called {name}", where="option --output", expected="bags of different names, or one bag"
            )
    outputs: list[Path | None] = [options.output] * len(names)
    if options.output is not None and len(names) > 1:
        outputs = [options.output / name for name in names]
    run = uuid4().hex
    return [
        Task(bag.absolute(), settings, output and output.absolute(), options.format, options.force, run)
        for bag, output in zip(options.bags, outputs, strict=True)
    ]


def _settings(options: argparse.Namespace) -> Settings:
    arm = Settings({}) if options.arm is None else Settings.of_arm(load_arm_file(options.arm))
    joints, chain = dict(arm.joints), dict(arm.chain or {})
    for joint, file in _by_joint("--calibration", options.calibration).items():
        own_topic = joints[joint].own_topic if joint in joints else ""
        joints[joint] = JointSettings(Path(file).absolute(), own_topic=own_topic)
    if not joints:
        raise ParameterError("no joint is named", where="reprocess", expected="--arm FILE, or --calibration JOINT=FILE")
    for joint, session in _by_joint("--session", options.session, joints).items():
        joints[joint] = replace(joints[joint], session=session)
    for joint, topic in _by_joint("--topic", options.topic, joints).items():
        joints[joint] = replace(joints[joint], topic=topic)
    given = {
        "urdf": options.urdf and str(options.urdf.absolute()),
        "beams": options.beams and str(options.beams.absolute()),
        "endpoint_frame": options.endpoint_frame,
        "acceleration_window": options.acceleration_window,
        "reference": options.reference,
    }
    chain |= {name: value for name, value in given.items() if value is not None}
    if chain and "urdf" not in chain:
        option = next(iter(chain)).replace("_", "-")
        raise ParameterError("there is no robot description", where=f"option --{option}", expected="--urdf too")
    return Settings(joints, chain or None).with_false_alarm(options.false_alarm)


def _by_joint(option: str, given: Sequence[str], joints: Collection[str] = ()) -> dict[str, str]:
    """Return the values of a repeated option JOINT=VALUE; ``joints``: the known ones, empty: any."""
    values: dict[str, str] = {}
    for text in given:
        joint, equals, value = text.partition("=")
        if not (joint and equals and value):
            raise ParameterError(f"'{text}'", where=f"option {option}", expected="JOINT=..., such as elbow=...")
        if joint in values:
            raise ParameterError(f"joint {joint} is named twice", where=f"option {option}", expected="once")
        if joints and joint not in joints:
            expected = f"one of {', '.join(joints)}"
            raise ParameterError(f"there is no joint {joint}", where=f"option {option}", expected=expected)
        values[joint] = value
    return values


def _check(options: argparse.Namespace, tasks: Sequence[Task]) -> None:
    if options.scheduler is not None and options.jobs > 1:
        raise ParameterError("both are given", where="options --jobs and --scheduler", expected="one of them")
    for task in tasks:
        if task.output is not None:
            check_outside_of_bags(task.output, options.bags)
            check_replaceable(task.output, force=task.force)


def _run_tasks(options: argparse.Namespace, tasks: Sequence[Task]) -> Iterator[Summary]:
    jobs = min(options.jobs, os.cpu_count() or 1, len(tasks))
    with progress_display() as progress:
        if options.scheduler is None and jobs == 1:
            totals = [topics_of(task.bag, task.settings.joints, option="--topic").messages for task in tasks]
            steps = [progress.add(task.bag.name, total) for task, total in zip(tasks, totals, strict=True)]
            for step, task in zip(steps, tasks, strict=True):
                yield reprocess_bag(task, step.advance)
            return
        step = progress.add("bags", len(tasks))
        if options.scheduler is None:
            parallel = local_processes(jobs)
        else:
            parallel = dask_cluster(options.scheduler, unencrypted=options.unencrypted)
        with parallel as executor:
            at_once = jobs if options.scheduler is None else len(tasks)
            for summary in run_tasks(executor, reprocess_in_worker, tasks, at_once):
                step.advance(1)
                yield summary


def reprocess_in_worker(task: Task) -> Summary:
    """Reprocess one bag in a worker process; the process ends if the program has been killed meanwhile."""
    try:
        return reprocess_bag(task)
    except KeyboardInterrupt:
        os._exit(EXIT_INTERRUPTED)


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary of a bag."""
    chain = summary.endpoint is not None
    table = Table(title=escape(str(summary.bag)), title_justify="left")
    table.add_column("joint", no_wrap=True)
    for column in ("scans", "lost", *(("missing", "no endpoint") if chain else ())):
        table.add_column(column, justify="right")
    table.add_column("faults of the lost")
    for name, joint in summary.joints.items():
        of_chain = (f"{joint.missing:,}", f"{joint.refused:,}") if chain else ()
        faults = ", ".join(f"{fault.lower()} {count:,}" for fault, count in joint.faults.items()) or "none"
        table.add_row(name, f"{joint.scans:,}", f"{joint.lost:,}", *of_chain, faults)
    console.print(table)
    if summary.endpoint is not None:
        end = summary.endpoint
        console.print(
            f"endpoint: {end.poses:,} poses, {end.degraded:,} of them degraded; no pose at {end.refused:,} complete "
            f"stamps, and {end.incomplete:,} incomplete ones"
        )
    if summary.left_out:
        console.print(f"left out, of no joint named: {', '.join(summary.left_out)}", markup=False)
    for sentence in (*summary.notes, *summary.differences):
        console.print(f"warning: {sentence}", markup=False, soft_wrap=True)
    speed = summary.scans / summary.cpu_s if summary.cpu_s else 0.0
    console.print(
        f"{summary.scans:,} scans in {summary.wall_s:.1f} s, {summary.cpu_s:.1f} s of processor time: "
        f"{speed:,.0f} scans/s per core"
    )
    where = "no --output: nothing is written" if summary.output is None else f"written to {summary.output}"
    console.print(where, markup=False, soft_wrap=True)
