# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``budget``: error budget of a calibration file as tables, CSV, JSON and a page with charts."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from posor.arm_names import describe_argument
from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor
from posor.output_files import make_folder, write_files
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.json_text import json_text
from posor.reporting.program_errors import reports_errors
from posor.reporting.progress import progress_display
from posor.reporting.report_table import report_console
from posor.tables.number_text import parse_number
from posor.uncertainty.budget_poses import middle_pose, pose_from_native, scan_at
from posor.uncertainty.budget_quantities import NATIVE, PlatePoint
from posor.uncertainty.first_order import error_budget
from posor.uncertainty.protection_level import arm_reliability
from posor.uncertainty.reliability import joint_reliability

from posor_design.budget_report import BudgetReport, render_budget_page
from posor_design.monte_carlo import BATCH, monte_carlo, validate
from posor_design.statement_poses import check_angles

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.uncertainty.protection_level import ArmReliability
    from rich.console import Console

SEED = 1985
DESCRIPTION = (
    "Error budget of a POSOR from its calibration file. 'posor statement' states the uncertainty of an arm's endpoint."
)
OUTPUT_FILES = ("budget.csv", "budget.json", "budget.html")


def _numbers(names: Sequence[str]) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of as many numbers as names, separated by commas."""

    def parse_numbers(text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(parse_number(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(names) or not all(map(math.isfinite, numbers)):
            raise argparse.ArgumentTypeError(f"'{text}' is not {len(names)} numbers {','.join(names)}")
        return numbers

    return parse_numbers


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown, or its value is invalid."""
    parser = CommandLineParser(prog="posor budget", description=DESCRIPTION)
    parser.add_argument("calibration", type=Path, nargs="?", metavar="CALIBRATION.yaml")
    parser.add_argument("--session", default="", help="session of the calibration file to apply")
    names = [name for name, _ in NATIVE]
    parser.add_argument(
        "--pose",
        type=_numbers(names),
        metavar=",".join(names),
        help="in m and rad, written --pose=...; default: all sensors in the middle of their ranges",
    )
    parser.add_argument(
        "--point",
        type=_numbers(("x", "y")),
        action="append",
        default=[],
        metavar="x,y",
        help="point of the receiving plate [m] whose gap is an output too, written --point=...; may be repeated",
    )
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/budget/<name of the calibration>")
    draws = whole_number_from(2 * BATCH)
    parser.add_argument("--draws", type=draws, default=10 * BATCH, help="largest number of Monte Carlo draws")
    parser.add_argument("--seed", type=whole_number_from(0), default=SEED, help=f"seed of the draws (default: {SEED})")
    text = f"arm whose endpoint gets a protection level: {describe_argument()}"
    parser.add_argument("--arm", metavar="ARM", help=text)
    parser.add_argument(
        "--angles", type=_angles, metavar="a,b,...", help="of the arm's joints in rad, written --angles=...; default: 0"
    )
    options = parser.parse_args(arguments)
    if options.calibration is None:
        parser.error("no calibration file is given; the endpoint of an arm has 'posor statement ARM --angles=...'")
    if options.angles is not None and options.arm is None:
        parser.error("--angles without --arm")
    options.output = options.output or Path("build/budget") / options.calibration.stem
    return options


def _angles(text: str) -> tuple[float, ...]:
    return _numbers([f"angle {number + 1}" for number in range(text.count(",") + 1)])(text)


def _arm_reliability(name: str, given: Sequence[float] | None) -> ArmReliability:
    """Return the reliability of an arm at the given angles of its joints [rad]; None: all zero."""
    arm = load_arm_file(name)
    chain = arm.chain()
    names = [joint.name for joint in chain.joints]
    angles = [0.0] * len(names) if given is None else given
    check_angles(angles, names, "budget, --angles")
    calibrations = {name: arm.calibration(name) for name in names}
    return arm_reliability(chain, calibrations, dict(zip(names, angles, strict=True)))


def compute_budget(options: argparse.Namespace, progress: Callable[[int], None] | None = None) -> BudgetReport:
    """Compute the budget for these options; create the folder of the results before the draws, which take long.

    ``options``: as ``parse_options`` returns them. ``progress``: called with the number of draws made so far. Raises
    PosorError: the calibration is invalid, or cannot be used at this pose, or the folder cannot be created.
    """
    calibration = load_calibration(options.calibration).for_session(options.session)
    posor = Posor(calibration)
    pose = middle_pose(posor) if options.pose is None else pose_from_native(options.pose)
    scan = scan_at(posor, pose)
    points = [PlatePoint(*point) for point in options.point]
    budget = error_budget(posor, scan, pose, points)
    reliability = joint_reliability(posor, scan, pose)
    arm = None if options.arm is None else _arm_reliability(options.arm, options.angles)
    make_folder(options.output)
    drawn = monte_carlo(posor, scan, pose, points, seed=options.seed, max_draws=options.draws, progress=progress)
    return BudgetReport(
        calibration=calibration.name,
        content_hash=calibration.content_hash,
        session=options.session,
        budget=budget,
        drawn=drawn,
        validations=validate(budget, drawn),
        seed=options.seed,
        reliability=reliability,
        arm=arm,
    )


def write_budget(report: BudgetReport, folder: Path) -> None:
    """Write table, figures and page into an existing folder. Raises OutputError: one cannot be written."""
    texts = report.as_csv(), json_text(report.as_json(), indent=2), render_budget_page(report)
    write_files({folder / name: text for name, text in zip(OUTPUT_FILES, texts, strict=True)})


def print_budget(report: BudgetReport, console: Console) -> None:
    """Print contributions, totals, validation and reliability as tables."""
    session = f", session {report.session}" if report.session else ""
    console.print(f"Error budget of '{report.calibration}'{session}")
    console.print(f"at {report.pose_text}; standard uncertainties, k = 1")
    tables = [report.contributions(), report.validation(), *report.reliability_tables()]
    for table in tables:
        table.print(console)
    for note in (*(table.note for table in tables), report.verdict, report.correlation_note, report.exact_note):
        if note:
            console.print(note)
    if report.drawn.lost:
        console.print(f"{report.drawn.lost} of {report.drawn.trials + report.drawn.lost} draws gave no pose.")


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the budget has been computed."""
    options = parse_options(arguments)
    with progress_display() as progress:
        report = compute_budget(options, progress.add("draws", options.draws).set)
    write_budget(report, options.output)
    console = report_console(160)
    print_budget(report, console)
    console.print(f"page and files: {options.output}", soft_wrap=True, markup=False)
    return 0
