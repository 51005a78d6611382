"""reprocess: from recorded raw scans to transforms and endpoint poses, the same numbers as the live graph's."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from posor_estimator.arm_chain import chain_parameters
from posor_estimator.core.arm import load_arm
from posor_estimator.errors import ParameterError, PosorError
from posor_estimator.reporting.command_line import Parser
from posor_estimator.reprocess.cluster import on_cluster
from posor_estimator.reprocess.interrupts import interruptible
from posor_estimator.reprocess.output import clear_unfinished
from posor_estimator.reprocess.place import refuse, refuse_among
from posor_estimator.reprocess.processes import in_processes
from posor_estimator.reprocess.show import show
from posor_estimator.reprocess.task import FORMATS, JointSettings, Settings, Summary, Task
from posor_estimator.reprocess.topics import topics_of
from posor_estimator.starting import INTERRUPTED

if TYPE_CHECKING:
    import argparse
    from collections.abc import Collection, Iterator, Sequence

    from posor_estimator.core.arm import ParameterValue

WIDTH = 118
COVARIANCES = ("total", "random", "systematic")


def parser() -> Parser:
    """Return the parser of the command line."""
    whole = Parser(prog="reprocess", description="From recorded raw scans to transforms and endpoint poses.")
    whole.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="folder of a rosbag2 bag, or its file")
    whole.add_argument("--arm", type=Path, metavar="FILE.yaml", help="arm file: URDF, beams and calibrations")
    text = "calibration file of a joint's POSOR; may be repeated; replaces the arm file's"
    whole.add_argument("--calibration", action="append", default=[], metavar="JOINT=FILE", help=text)
    text = "session of the joint's calibration file"
    whole.add_argument("--session", action="append", default=[], metavar="JOINT=NAME", help=text)
    text = "topic of the joint's raw scans (default: the only one that ends in /JOINT/raw)"
    whole.add_argument("--topic", action="append", default=[], metavar="JOINT=TOPIC", help=text)
    whole.add_argument("--urdf", type=Path, help="robot description; without one there are transforms only")
    whole.add_argument("--beams", type=Path, help="beams file")
    whole.add_argument("--endpoint-frame", metavar="LINK", help="link of the URDF whose pose is wanted")
    whole.add_argument("--acceleration-window", type=float, metavar="S", help="as the parameter of chain_node [s]")
    whole.add_argument("--reference", choices=("absolute", "home"), help="as the parameter of chain_node")
    whole.add_argument("--covariance", choices=COVARIANCES, default="total", help="as the parameter of posor_node")
    whole.add_argument("--false-alarm", type=float, default=1e-3, metavar="P", help="as the parameter of posor_node")
    text = "folder for the results; of several bags, a folder of such folders (default: only a summary)"
    whole.add_argument("--output", type=Path, help=text)
    whole.add_argument("--format", choices=FORMATS, default="bag", help="of the results (default: bag)")
    whole.add_argument("--force", action="store_true", help="replace results that are there")
    whole.add_argument("--jobs", type=int, default=1, metavar="N", help="bags at a time, each in its own process")
    whole.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster whose workers see the same files")
    return whole


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 where all bags were reprocessed."""
    try:
        with interruptible():
            _run(parser().parse_args(arguments))
    except PosorError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    except KeyboardInterrupt:
        sys.stderr.write("reprocess: interrupted; what was not finished is not there.\n")
        return INTERRUPTED
    return 0


def _run(options: argparse.Namespace) -> None:
    tasks = tasks_of(options)
    _check(options, tasks)
    console = Console(width=WIDTH)
    try:
        for summary in _summaries(options, tasks):
            show(summary, console)
    finally:
        for task in tasks:
            if task.output is not None:
                clear_unfinished(task.output.parent, task.run)


def tasks_of(options: argparse.Namespace) -> list[Task]:
    """Return what a parsed command line asks for.

    Raises:
        ParameterError: Options that do not go together.
        CalibrationError: The arm file cannot be used.
        NodeError: The arm file gives chain_node parameters that it does not take.

    """
    settings = _settings(options)
    names = [bag.resolve().stem if bag.is_file() else bag.resolve().name for bag in options.bags]
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
        Task(
            _absolute(bag), settings, None if output is None else _absolute(output), options.format, options.force, run
        )
        for bag, output in zip(options.bags, outputs, strict=True)
    ]


def _settings(options: argparse.Namespace) -> Settings:
    joints: dict[str, JointSettings] = {}
    chain: dict[str, ParameterValue] = {}
    if options.arm is not None:
        arm = load_arm(options.arm)
        joints = {name: JointSettings(path, arm.sessions[name]) for name, path in arm.calibrations.items()}
        chain = chain_parameters(arm)
    for joint, file in _by_joint("--calibration", options.calibration).items():
        joints[joint] = JointSettings(_absolute(Path(file)))
    if not joints:
        raise ParameterError("no joint is named", where="reprocess", expected="--arm FILE, or --calibration JOINT=FILE")
    for joint, session in _by_joint("--session", options.session, joints).items():
        joints[joint] = replace(joints[joint], session=session)
    for joint, topic in _by_joint("--topic", options.topic, joints).items():
        joints[joint] = replace(joints[joint], topic=topic)
    given = {
        "urdf": options.urdf and str(_absolute(options.urdf)),
        "beams": options.beams and str(_absolute(options.beams)),
        "endpoint_frame": options.endpoint_frame,
        "acceleration_window": options.acceleration_window,
        "reference": options.reference,
    }
    chain |= {name: value for name, value in given.items() if value is not None}
    if chain and "urdf" not in chain:
        named = next(iter(chain)).replace("_", "-")
        raise ParameterError("there is no robot description", where=f"option --{named}", expected="--urdf too")
    return Settings(joints, chain or None, options.covariance, options.false_alarm)


def _by_joint(option: str, given: Sequence[str], joints: Collection[str] = ()) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in given:
        joint, equals, value = text.partition("=")
        if not (joint and equals and value):
            raise ParameterError(f"'{text}'", where=f"option {option}", expected="JOINT=..., such as elbow=...")
        if joint in found:
            raise ParameterError(f"joint {joint} is named twice", where=f"option {option}", expected="once")
        if joints and joint not in joints:
            expected = f"one of {', '.join(joints)}"
            raise ParameterError(f"there is no joint {joint}", where=f"option {option}", expected=expected)
        found[joint] = value
    return found


def _absolute(path: Path) -> Path:
    return path.absolute()


def _check(options: argparse.Namespace, tasks: Sequence[Task]) -> None:
    """Refuse what is known to be wrong before any work is done."""
    if not 0.0 < options.false_alarm < 1.0:
        raise ParameterError(f"{options.false_alarm:g}", where="option --false-alarm", expected="between 0 and 1")
    if options.jobs < 1:
        raise ParameterError(f"{options.jobs}", where="option --jobs", expected="at least 1")
    if options.scheduler is not None and options.jobs > 1:
        raise ParameterError("both are given", where="options --jobs and --scheduler", expected="one of them")
    for task in tasks:
        if task.output is not None:
            refuse_among(task.output, options.bags)
            refuse(task.output, force=task.force)


def _summaries(options: argparse.Namespace, tasks: Sequence[Task]) -> Iterator[Summary]:
    """Do the tasks and show how far they are."""
    if options.scheduler is not None:
        with _progress() as progress:
            bar = progress.add_task("bags on the cluster", total=len(tasks))
            for summary in on_cluster(tasks, options.scheduler):
                progress.advance(bar)
                yield summary
        return
    with _progress() as progress:
        bars = [
            progress.add_task(task.bag.name, total=topics_of(task.bag, task.settings.joints).messages) for task in tasks
        ]
        yield from in_processes(
            tasks, min(options.jobs, os.cpu_count() or 1), lambda number, count: progress.advance(bars[number], count)
        )


def _progress() -> Progress:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    return Progress(*columns, console=console, transient=True, disable=not console.is_interactive)


if __name__ == "__main__":
    sys.exit(main())
