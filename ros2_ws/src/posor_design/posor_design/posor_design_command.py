"""``posor design posor``: from a requirement to a POSOR whose files ``posor bringup`` runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.calibration.file_model import first_problem
from posor.errors import ParameterError, similar_name
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.report_console import report_console
from posor.uncertainty.budget_quantities import NATIVE
from pydantic import ValidationError
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from posor_design.budget_command import OUTPUT_FILES, compute_budget, write_budget
from posor_design.budget_command import parse_options as parse_budget_options
from posor_design.layout_search import PREFERENCES, LayoutSearch
from posor_design.nearest_requirement import refuse
from posor_design.posor_design_page import (
    TRADE_OFF_HEADER,
    UNCERTAINTY_HEADER,
    layout_terms,
    trade_off_rows,
    uncertainty_rows,
    verdict,
)
from posor_design.posor_output import ARM_FILE, CALIBRATION, output_files, output_folder, write_files
from posor_design.quantity_text import parse_quantity_with_unit
from posor_design.requirement import FREEDOMS, VERSION, Requirement, load_requirement

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from posor_design.layout_evaluation import Candidate
    from posor_design.layout_search import SearchResult

WHERE = "design posor"
BUDGET_DRAWS = 20_000
OPTIONS: dict[str, tuple[str, str, str]] = {
    "--outside-diameter": ("m", "", "largest outside diameter"),
    "--inside-diameter": ("m", "0 m", "free inside diameter"),
    "--translations": ("m", "", "largest uncertainty of x, y and gap"),
    "--angles": ("rad", "", "largest uncertainty of alpha, beta and theta"),
    "--coverage-factor": ("1", "1", "of the uncertainties; 1: standard uncertainties"),
    "--range-gap": ("m", "0.1 mm", "motion of the gap to either side"),
    "--range-tilt": ("rad", "1 mrad", "motion of alpha and of beta to either side"),
    "--range-runout": ("m", "0.1 mm", "motion of x and of y to either side"),
    "--rotation": ("rad", "180 deg", "motion of theta to either side; 180 deg: full turn"),
    "--scan-rate": ("Hz", "1 kHz", "scans a second"),
    "--speed": ("rad/s", "1 rad/s", "largest velocity of theta"),
    "--fault": ("m", "", "largest bias of a reading that one scan may miss; default: any"),
}
"""Options of the requirement: SI unit, default, and meaning; without default and text: required or None."""
REQUIRED = ("--outside-diameter", "--translations", "--angles")


def _parser() -> CommandLineParser:
    parser = CommandLineParser(
        prog=f"posor {WHERE}",
        description="Find the layout of a POSOR that meets a requirement, and write the files that bringup runs.",
        help_call=f"posor {WHERE} --help",
        allow_abbrev=False,
    )
    parser.add_argument("requirement", nargs="?", type=Path, metavar="REQUIREMENT.yaml", help="instead of the options")
    for option, (_, default, meaning) in OPTIONS.items():
        text = f"{meaning}{f'; default: {default}' if default else ''}"
        parser.add_argument(option, metavar="QUANTITY", help=text.replace("%", "%%"))
    parser.add_argument(
        "--uncertainty",
        action="append",
        default=[],
        metavar="FREEDOM=QUANTITY",
        help=f"of one freedom ({', '.join(FREEDOMS)}); may be repeated",
    )
    parser.add_argument("--name", help="of the arm with the POSOR; default: posor")
    parser.add_argument(
        "--prefer", choices=PREFERENCES, default=PREFERENCES[0], help="of the chosen layout; default: electronics"
    )
    parser.add_argument("--output", metavar="FOLDER", help="default: build/design/<name>")
    parser.add_argument("--force", action="store_true", help="replace files of an earlier design")
    return parser


def requirement_of(options: argparse.Namespace) -> Requirement:
    """Return the requirement of a file, or of the options.

    Raises:
        ParameterError: An option is missing or invalid, or there are a file and options.
        CalibrationError: The file is invalid.

    """
    given = {name for name in OPTIONS if getattr(options, _key(name)) is not None}
    if options.requirement is not None:
        if given or options.uncertainty or options.name:
            other = min(given) if given else "--uncertainty" if options.uncertainty else "--name"
            raise ParameterError(f"{other} beside a file", where=WHERE, expected="a requirement file, or options")
        return load_requirement(options.requirement)
    missing = [name for name in REQUIRED if name not in given]
    if missing:
        raise ParameterError(
            f"{missing[0]} is missing", where=WHERE, expected=f"a requirement file, or {', '.join(REQUIRED)}"
        )
    return _requirement_of_options(options)


def _requirement_of_options(options: argparse.Namespace) -> Requirement:
    values: dict[str, float | None] = {}
    for name, (unit, default, _) in OPTIONS.items():
        text = getattr(options, _key(name)) or default
        values[name] = parse_quantity_with_unit(text, unit, f"{WHERE}, {name}") if text else None
    limits = {name: values["--translations" if unit == "m" else "--angles"] for name, unit in NATIVE}
    units = dict(NATIVE)
    for text in options.uncertainty:
        freedom, equals, quantity = text.partition("=")
        if freedom not in limits:
            expected = similar_name(freedom, FREEDOMS, f"one of {', '.join(FREEDOMS)}, then = and a quantity")
            raise ParameterError(f"'{text}'", where=f"{WHERE}, --uncertainty", expected=expected)
        if not equals:
            expected = f"{freedom}=QUANTITY, such as '{freedom}=2 u{units[freedom]}'"
            raise ParameterError(f"'{text}'", where=f"{WHERE}, --uncertainty", expected=expected)
        limits[freedom] = parse_quantity_with_unit(quantity, units[freedom], f"{WHERE}, --uncertainty {freedom}")

    def entry(name: str) -> dict[str, Any]:
        return {"value": values[name], "unit": OPTIONS[name][0]}

    content = {
        "format": "posor_requirement",
        "version": VERSION,
        "name": options.name or "posor",
        "uncertainty": {
            "coverage_factor": values["--coverage-factor"],
            **{name: {"value": limits[name], "unit": units[name]} for name in FREEDOMS},
        },
        "range": {
            "gap": entry("--range-gap"),
            "tilt": entry("--range-tilt"),
            "runout": entry("--range-runout"),
            "rotation": entry("--rotation"),
        },
        "outside_diameter": entry("--outside-diameter"),
        "inside_diameter": entry("--inside-diameter"),
        "scan_rate": entry("--scan-rate"),
        "speed": entry("--speed"),
        "minimum_detectable_fault": None if values["--fault"] is None else entry("--fault"),
    }
    try:
        return Requirement.model_validate(content)
    except ValidationError as error:
        problem = first_problem(error)
        keys = ".".join(str(key) for key in problem.location if key != "value")
        raise ParameterError(problem.what, where=f"{WHERE}, {keys}", expected=problem.expected) from None


def _key(option: str) -> str:
    return option.removeprefix("--").replace("-", "_")


def design_posor_main(arguments: Sequence[str]) -> int:
    """Run the program; exit code 0: a layout meets the requirement and its files are written."""
    options = _parser().parse_args(list(arguments))
    requirement = requirement_of(options)
    folder = output_folder(options.output, requirement.name, ARM_FILE, force=options.force)
    errors = Console(stderr=True)
    with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
        task = progress.add_task("layouts", total=1.0)
        result = LayoutSearch(requirement, lambda share: progress.update(task, completed=share)).run(options.prefer)
        if result.chosen is None:
            refuse(result, lambda share: progress.update(task, completed=share))
        write_files(folder, output_files(result, result.chosen), force=options.force)
        _write_budget(folder, result.chosen)
    print_result(result, result.chosen, report_console(160))
    print(f"page: {folder / 'design.html'}; error budget: {folder / 'budget' / OUTPUT_FILES[2]}")
    print(f"to run it: posor bringup {folder / ARM_FILE}")
    return 0


def _write_budget(folder: Path, chosen: Candidate) -> None:
    """Write the error budget of the written calibration in the middle of its range."""
    pose = f"--pose=0,0,{chosen.layout.gap!r},0,0,0"
    output = ["--output", str(folder / "budget"), "--draws", str(BUDGET_DRAWS)]
    options = parse_budget_options([str(folder / CALIBRATION), pose, *output])
    with Progress(disable=True) as progress:
        write_budget(compute_budget(options, progress), options.output)


def print_result(result: SearchResult, chosen: Candidate, console: Console) -> None:
    """Print the chosen layout and the trade-off."""
    requirement = result.requirement
    console.print(f"POSOR for the requirement '{requirement.name}' (simulated)")
    console.print(verdict(result), soft_wrap=True)
    for term, text in layout_terms(requirement, chosen).items():
        console.print(f"  {term}: {text}", soft_wrap=True)
    factor = requirement.uncertainty.coverage_factor
    for title, header, rows in (
        (
            f"Uncertainty in the whole range, coverage factor {factor:g}",
            UNCERTAINTY_HEADER,
            uncertainty_rows(requirement, chosen),
        ),
        ("Trade-off", TRADE_OFF_HEADER, trade_off_rows(requirement, result.trade_off)),
    ):
        table = Table(*header, title=title, title_justify="left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
