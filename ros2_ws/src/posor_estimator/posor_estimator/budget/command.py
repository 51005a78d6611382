"""budget: the error budget of any calibration file, as a table, CSV, JSON and a page with charts."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import Progress

from posor_estimator.budget.files import write_csv, write_json
from posor_estimator.budget.page import page
from posor_estimator.budget.tables import print_budget
from posor_estimator.budget.told import ToldBudget
from posor_estimator.core.budget.first_order import error_budget
from posor_estimator.core.budget.monte_carlo import BATCH, monte_carlo
from posor_estimator.core.budget.outputs import NATIVE, PlatePoint
from posor_estimator.core.budget.poses import middle_pose, pose_of_native, scan_at
from posor_estimator.core.budget.validation import validate
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.posor import Posor
from posor_estimator.errors import ParameterError, PosorError
from posor_estimator.reporting.command_line import Parser

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

SEED = 1985
MADE_HERE = ("budget.csv", "budget.json", "budget.html")


def _numbers(names: Sequence[str]) -> Callable[[str], tuple[float, ...]]:
    """Return a reader of that many numbers, parted by commas."""

    def read(text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(names) or not all(map(math.isfinite, numbers)):
            raise argparse.ArgumentTypeError(f"'{text}' is not {len(names)} numbers {','.join(names)}")
        return numbers

    return read


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is no seed, a whole number of at least 0")
    return int(text)


def _draws(text: str) -> int:
    if not text.isdecimal() or int(text) < 2 * BATCH:
        raise argparse.ArgumentTypeError(f"'{text}' is no number of draws, at least {2 * BATCH}")
    return int(text)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="budget", description="Error budget of a POSOR from its calibration file.")
    parser.add_argument("calibration", type=Path, metavar="CALIBRATION.yaml")
    parser.add_argument("--session", default="", help="session of the calibration file to apply")
    names = [name for name, _ in NATIVE]
    parser.add_argument(
        "--pose",
        type=_numbers(names),
        metavar=",".join(names),
        help="in m and rad, written --pose=...; default: where the sensors are in the middle of their ranges",
    )
    parser.add_argument(
        "--point",
        type=_numbers(("x", "y")),
        action="append",
        default=[],
        metavar="x,y",
        help="of the receiving plate [m], whose gap is judged too, written --point=...; may be repeated",
    )
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/budget/<name of the calibration>")
    parser.add_argument("--draws", type=_draws, default=10 * BATCH, help="most draws of the Monte Carlo run")
    parser.add_argument("--seed", type=_seed, default=SEED, help=f"of the draws (default: {SEED})")
    return parser.parse_args(arguments)


def told_budget(options: argparse.Namespace, progress: Progress) -> ToldBudget:
    """Run what the options ask for.

    Raises:
        PosorError: The calibration cannot be used, or not at this pose.

    """
    calibration = load_calibration(options.calibration).for_session(options.session)
    posor = Posor(calibration)
    pose = middle_pose(posor) if options.pose is None else pose_of_native(options.pose)
    scan = scan_at(posor, pose)
    points = [PlatePoint(*point) for point in options.point]
    budget = error_budget(posor, scan, pose, points)
    task = progress.add_task("draws", total=options.draws)
    drawn = monte_carlo(
        posor,
        scan,
        pose,
        points,
        seed=options.seed,
        most=options.draws,
        progress=lambda done: progress.update(task, completed=done),
    )
    return ToldBudget(
        calibration=calibration.name,
        content_hash=calibration.content_hash,
        session=options.session,
        budget=budget,
        drawn=drawn,
        validations=validate(budget, drawn),
        seed=options.seed,
    )


def _folder(options: argparse.Namespace) -> Path:
    """Make the folder of the results, now that there are some."""
    folder: Path = options.output or Path("build/budget") / options.calibration.stem
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(
            f"cannot be made: {error.strerror}", where=f"budget, --output, {folder}", expected="a folder to write to"
        ) from error
    return folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 when the budget could be made."""
    try:
        options = parse(arguments)
        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            told = told_budget(options, progress)
        folder = _folder(options)
        write_csv(folder / MADE_HERE[0], told)
        write_json(folder / MADE_HERE[1], told)
        (folder / MADE_HERE[2]).write_text(page(told), encoding="utf-8")
    except PosorError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=160)
    print_budget(told, console)
    console.print(f"page and files: {folder}", soft_wrap=True, markup=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
