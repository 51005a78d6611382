# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""``posor design posor``: from a requirement to a POSOR whose files ``posor bringup`` runs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from posor.arm_names import ARM_FILE
from posor.calibration.file_model import first_problem
from posor.errors import ParameterError, similar_name
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.report_table import report_console
from posor.uncertainty.budget_quantities import NATIVE
from pydantic import ValidationError

from posor_design.budget_command import OUTPUT_FILES, compute_budget, write_budget
from posor_design.budget_command import parse_options as parse_budget_options
from posor_design.layout_search import PREFERENCES
from posor_design.nearest_requirement import search_layouts
from posor_design.posor_design_page import layout_tables, layout_terms, verdict
from posor_design.posor_output import CALIBRATION, add_output_options, output_files, output_folder, write_design
from posor_design.quantity_text import parse_quantity
from posor_design.requirement import FREEDOMS, OPTIONS, Requirement, load_requirement, requirement_content

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

WHERE = "design posor"
BUDGET_DRAWS = 20_000
REQUIRED = ("--outside-diameter", "--translations", "--angles")


def _parser() -> CommandLineParser:
    parser = CommandLineParser(
        prog=f"posor {WHERE}",
        description="Find the layout of a POSOR that meets a requirement, and write the files that bringup runs.",
        help_call=f"posor {WHERE} --help",
        allow_abbrev=False,
    )
    parser.add_argument("requirement", nargs="?", type=Path, metavar="REQUIREMENT.yaml", help="instead of the options")
    for name, option in OPTIONS.items():
        parser.add_argument(
            name,
            metavar="QUANTITY",
            type=partial(parse_quantity, si=option.unit, where=f"{WHERE}, {name}", unit_required=True),
            help=f"{option.meaning}{f'; default: {option.default}' if option.default else ''}",
        )
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
    add_output_options(parser, "<name>")
    return parser


def requirement_of(options: argparse.Namespace) -> Requirement:
    """Return the requirement of a file, or of the options.

    Raises ParameterError: an option is missing or invalid, or there are a file and options. Raises CalibrationError:
    the file is invalid.
    """
    values = {name: getattr(options, name.removeprefix("--").replace("-", "_")) for name in OPTIONS}
    given = {name for name, value in values.items() if value is not None}
    if options.requirement is not None:
        if given or options.uncertainty or options.name:
            other = min(given) if given else "--uncertainty" if options.uncertainty else "--name"
            raise ParameterError(f"{other} beside a file", where=WHERE, expected="a requirement file, or options")
        return load_requirement(options.requirement)
    missing = [name for name in REQUIRED if name not in given]
    if missing:
        expected = f"a requirement file, or {', '.join(REQUIRED)}"
        raise ParameterError(f"{missing[0]} is missing", where=WHERE, expected=expected)
    try:
        return Requirement.model_validate(
            requirement_content(
                options.name or "posor",
                _limits(values["--translations"], values["--angles"], options.uncertainty),
                1.0 if values["--coverage-factor"] is None else values["--coverage-factor"],
                {OPTIONS[name].entry: values[name] for name in given if OPTIONS[name].entry},
            )
        )
    except ValidationError as error:
        problem = first_problem(error)
        keys = ".".join(str(key) for key in problem.location if key != "value")
        raise ParameterError(problem.what, where=f"{WHERE}, {keys}", expected=problem.expected) from None


def _limits(translations: float, angles: float, uncertainties: Sequence[str]) -> dict[str, float]:
    """Return the largest uncertainty of each freedom [m, rad]; ``uncertainties``: texts such as ``theta=2 urad``."""
    units = dict(NATIVE)
    limits = {name: translations if unit == "m" else angles for name, unit in NATIVE}
    where = f"{WHERE}, --uncertainty"
    for text in uncertainties:
        freedom, equals, quantity = text.partition("=")
        if freedom not in limits:
            expected = similar_name(freedom, FREEDOMS, f"one of {', '.join(FREEDOMS)}, then = and a quantity")
            raise ParameterError(f"'{text}'", where=where, expected=expected)
        if not equals:
            expected = f"{freedom}=QUANTITY, such as '{freedom}=2 u{units[freedom]}'"
            raise ParameterError(f"'{text}'", where=where, expected=expected)
        limits[freedom] = parse_quantity(quantity, units[freedom], f"{where} {freedom}", unit_required=True)
    return limits


def main(arguments: Sequence[str]) -> int:
    """Run the program; exit code 0: a layout meets the requirement and its files are written."""
    options = _parser().parse_args(list(arguments))
    requirement = requirement_of(options)
    folder = output_folder(options.output, requirement.name, ARM_FILE, force=options.force)
    ((result, chosen),) = search_layouts({"layouts": requirement}, options.prefer).values()
    write_design(folder, output_files(result, chosen), force=options.force)
    pose = f"--pose=0,0,{chosen.layout.gap!r},0,0,0"  # the middle of the range
    budget = ["--output", str(folder / "budget"), "--draws", str(BUDGET_DRAWS)]
    budget_options = parse_budget_options([str(folder / CALIBRATION), pose, *budget])
    write_budget(compute_budget(budget_options), budget_options.output)
    console = report_console(160)
    console.print(f"POSOR for the requirement '{requirement.name}' (simulated)")
    console.print(verdict(result), soft_wrap=True)
    for term, text in layout_terms(result, chosen).items():
        console.print(f"  {term}: {text}", soft_wrap=True)
    for table in layout_tables(result, chosen):
        table.print(console)
    print(f"page: {folder / 'design.html'}; error budget: {folder / 'budget' / OUTPUT_FILES[2]}")
    print(f"to run it: posor bringup {folder / ARM_FILE}")
    return 0
