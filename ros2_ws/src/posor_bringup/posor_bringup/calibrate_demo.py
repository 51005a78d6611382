"""calibrate_demo: a simulated calibration campaign from bags to a calibrated POSOR, judged by the truth.

``./run posor_bringup calibrate_demo``: draws a POSOR, records every step of its calibration as a rosbag2 bag,
calibrates it by the command line's own code, checks it at fresh poses, and asks many more campaigns whether the stated
uncertainties hold. Exit code 0 only if everything does.
"""

from __future__ import annotations

import json
import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from posor_estimator.errors import ParameterError, PosorError
from rich.console import Console

from posor_bringup.campaign.bagged import calibrate_bags, make_bags
from posor_bringup.campaign.figures import draw
from posor_bringup.campaign.many import coverage_of, many_campaigns
from posor_bringup.campaign.numbers import as_json
from posor_bringup.campaign.page import HEADINGS, INSTEAD, page
from posor_bringup.campaign.plant import POSORS, Plant, PosorName
from posor_bringup.campaign.steps import steps_of
from posor_bringup.campaign.told import Told, holds
from posor_bringup.command_line import Parser, prepare
from posor_bringup.findings import Findings
from posor_bringup.findings_table import print_findings
from posor_bringup.stages import Stages
from posor_bringup.watch import InterruptedRunError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType

SEED = 1985
CAMPAIGNS = 6
LEAST = 4
"""Campaigns from which a scatter can be told at all."""
MADE_HERE = ("report.html", *(f"{name}_{picture}.png" for name in POSORS for picture in INSTEAD), *POSORS)
WIDTH = 150


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="calibrate_demo", description="Simulated calibration campaigns, judged by the truth.")
    parser.add_argument("--posor", choices=[*get_args(PosorName), "both"], default="both")
    parser.add_argument(
        "--campaigns",
        type=int,
        default=CAMPAIGNS,
        metavar="N",
        help=f"further campaigns of each POSOR, in memory, for the coverage; 0: none (default: {CAMPAIGNS})",
    )
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the POSORs that are drawn (default: {SEED})")
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("build/calibration"),
        metavar="FOLDER",
        help="report, bags and files; the figures go to FOLDER.json (default: build/calibration)",
    )
    options = parser.parse_args(arguments)
    if options.campaigns < 0 or 0 < options.campaigns < LEAST:
        expected = f"0, or at least {LEAST}"
        raise ParameterError(f"--campaigns {options.campaigns}", where="calibrate_demo", expected=expected)
    if options.seed < 0:
        raise ParameterError(f"--seed {options.seed}", where="calibrate_demo", expected="0 or more")
    return options


def run(options: argparse.Namespace, stages: Stages) -> list[Told]:
    """Run the campaigns of all POSORs asked for.

    Raises:
        PosorError: A procedure refuses its bag, or a file cannot be written.

    """
    told = []
    folder = prepare(options.output, MADE_HERE, "calibrate_demo")
    for name in POSORS if options.posor == "both" else (options.posor,):
        count = len(steps_of(name))
        plant = Plant.drawn(name, options.seed)
        (folder / name).mkdir()
        with stages.stage(f"{name}: recording bags", count) as on_made:
            bags = make_bags(plant, folder / name / "bags", on_made)
        with stages.stage(f"{name}: calibrating", count) as on_step:
            bagged = calibrate_bags(plant, bags, folder / name, on_step)
        coverage = None
        if options.campaigns:
            seeds = range(options.seed + 1, options.seed + 1 + options.campaigns)
            with stages.stage(f"{name}: more campaigns", options.campaigns) as on_done:
                coverage = coverage_of(name, many_campaigns(name, seeds, on_done=on_done))
        told.append(Told.of(plant, bagged, coverage))
    return told


def write(options: argparse.Namespace, told: Sequence[Told]) -> None:
    """Write the report and the figures.

    Raises:
        ParameterError: They cannot be written.

    """
    pictures = [draw(one) for one in told]
    command = f"--posor {options.posor} --campaigns {options.campaigns} --seed {options.seed}"
    provenance = {"command": f"./run posor_bringup calibrate_demo {command}"} | {
        f"{one.plant.name}, result": f"{one.bagged[-1].step.name}.yaml, content hash {one.calibration.content_hash}"
        for one in told
    }
    try:
        for one, shown in zip(told, pictures, strict=True):
            for what, picture in shown.items():
                (options.output / f"{one.plant.name}_{what}.png").write_bytes(picture)
        (options.output / "report.html").write_text(page(told, pictures, provenance), encoding="utf-8")
        figures = options.output.with_name(f"{options.output.name}.json")
        figures.write_text(json.dumps(as_json(told), indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise ParameterError(f"cannot be written: {error.strerror}", where=str(options.output)) from error


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    try:
        with _interruptible() as check:
            return _demo(parse(arguments), check)
    except KeyboardInterrupt:
        error: PosorError = InterruptedRunError("interrupted", where="calibrate_demo")
    except PosorError as complaint:
        error = complaint
    print(error, file=sys.stderr)
    return error.exit_code


@contextmanager
def _interruptible() -> Iterator[Callable[[], None]]:
    """Let SIGINT and SIGTERM end the run, and the workers with it.

    What is yielded raises KeyboardInterrupt where one has come: not every library passes on what a signal raises in it.
    """
    came = False

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True
        raise KeyboardInterrupt

    def check() -> None:
        if came:
            raise KeyboardInterrupt

    former = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def _demo(options: argparse.Namespace, check: Callable[[], None]) -> int:
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=WIDTH)
    with Stages(console, check) as stages:
        told = run(options, stages)
    write(options, told)
    every = Findings(tuple(finding for one in told for finding in one.findings.findings))
    print_findings(every, console, "Calibration campaigns: what was found", HEADINGS)
    console.print(f"report: {options.output / 'report.html'}", soft_wrap=True, markup=False)
    sound = holds(told)
    console.print("Everything holds." if sound else "Not everything holds.", style="green" if sound else "bold red")
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
