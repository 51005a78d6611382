"""``posor design arm``: from a required uncertainty of an endpoint to those of its POSORs and measuring beams."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.chain.arm_file import load_arm
from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.report_console import report_console
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from posor_design.arm_allotment import allot
from posor_design.arm_design_page import (
    ENDPOINT_HEADER,
    LAYOUT_HEADER,
    PARTS_HEADER,
    endpoint_rows,
    layout_rows,
    part_rows,
    render_arm_page,
)
from posor_design.arm_output import (
    ARM_FILE,
    BEAMS,
    allotment_json,
    allotted_beams,
    arm_files,
    joint_requirements,
)
from posor_design.endpoint_budget import configurations
from posor_design.layout_search import LayoutSearch
from posor_design.nearest_requirement import refuse
from posor_design.posor_output import output_folder, requirement_text, write_files
from posor_design.quantity_text import parse_quantity_with_unit, split_unit

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from posor_design.layout_evaluation import Candidate
    from posor_design.requirement import Requirement

WHERE = "design arm"
JSON, PAGE = "allotment.json", "allotment.html"


def _parser() -> CommandLineParser:
    parser = CommandLineParser(
        prog=f"posor {WHERE}",
        description="Allot the required uncertainty of an arm's endpoint to its POSORs and measuring beams.",
        help_call=f"posor {WHERE} --help",
        allow_abbrev=False,
    )
    parser.add_argument("arm", type=Path, metavar="ARM.yaml", help="geometry, and present POSORs and beams")
    parser.add_argument(
        "--displacement", required=True, metavar="QUANTITY", help="largest uncertainty along each axis of the base"
    )
    parser.add_argument(
        "--orientation", required=True, metavar="QUANTITY", help="largest uncertainty about each axis of the base"
    )
    parser.add_argument("--coverage-factor", default="1", metavar="NUMBER", help="default: 1, standard uncertainties")
    parser.add_argument(
        "--posture",
        action="append",
        default=[],
        metavar="ANGLES",
        help="angles of all joints, such as --posture='0, 30, 90 deg'; may be repeated; default: extended, and with "
        "the last joint at 90 deg",
    )
    parser.add_argument("--layouts", action="store_true", help="also design the POSORs, and write the whole arm")
    parser.add_argument("--output", metavar="FOLDER", help="default: build/design/<name of the arm>")
    parser.add_argument("--force", action="store_true", help="replace files of an earlier design")
    return parser


def required_endpoint(options: argparse.Namespace) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the largest standard uncertainty along and about the axes, (6,) [m, rad].

    Raises:
        ParameterError: A quantity is invalid or not positive.

    """
    values = {}
    for name, unit in (("displacement", "m"), ("orientation", "rad"), ("coverage_factor", "1")):
        where = f"{WHERE}, --{name.replace('_', '-')}"
        values[name] = parse_quantity_with_unit(getattr(options, name), unit, where)
        if not values[name] > 0.0:
            raise ParameterError(getattr(options, name), where=where, expected="more than 0")
    factor = values["coverage_factor"]
    return np.array([values["displacement"] / factor] * 3 + [values["orientation"] / factor] * 3)


def postures_of(texts: Sequence[str], joints: Sequence[str]) -> list[Mapping[str, float]]:
    """Return the angles of the joints [rad] of each posture.

    Raises:
        ParameterError: A text is not a list of angles, one for each joint.

    """
    if not texts:
        return list(configurations(joints).values())
    where = f"{WHERE}, --posture"
    postures: list[Mapping[str, float]] = []
    for text in texts:
        entries = [entry.strip() for entry in text.split(",")]
        if len(entries) != len(joints):
            raise ParameterError(f"{len(entries)} angles", where=where, expected=f"{len(joints)}: {', '.join(joints)}")
        unit = split_unit(entries[-1])
        with_units = (each if split_unit(each) else f"{each} {unit}".strip() for each in entries)
        angles = [parse_quantity_with_unit(each, "rad", where) for each in with_units]
        postures.append(dict(zip(joints, angles, strict=True)))
    return postures


def design_arm_main(arguments: Sequence[str]) -> int:
    """Run the program; exit code 0: the requirement is allotted, and with ``--layouts`` every POSOR is designed."""
    options = _parser().parse_args(list(arguments))
    required = required_endpoint(options)
    if not options.arm.is_file():
        expected = "the path of an arm file (arm.yaml); 'posor bringup --help' lists the installed arms"
        raise ParameterError("no such file", where=f"{WHERE}, {options.arm}", expected=expected)
    arm = load_arm(options.arm)
    if options.layouts and arm.scenario is None:
        what = f"arm '{arm.name}' has no scenario"
        raise ParameterError(what, where=f"{WHERE}, --layouts", expected="an arm that can be simulated")
    folder = output_folder(options.output, arm.name, JSON, force=options.force)
    joints = [joint.name for joint in arm.chain().joints]
    allotment = allot(arm, required, postures_of(options.posture, joints))
    requirements = joint_requirements(arm, allotment)
    layouts = _layouts(requirements) if options.layouts else {}
    beams = allotted_beams(arm, allotment)
    files = {
        JSON: json.dumps(allotment_json(allotment), indent=2) + "\n",
        PAGE: render_arm_page(arm.name, allotment, layouts),
        **{f"{name}/requirement.yaml": requirement_text(each) for name, each in requirements.items()},
        **({} if beams is None else {BEAMS: beams}),
        **(arm_files(arm, allotment, requirements, layouts) if layouts else {}),
    }
    write_files(folder, files, force=options.force)
    console = report_console(160)
    tables = [
        ("Required standard uncertainties of joints and beams", PARTS_HEADER, part_rows(allotment)),
        ("Standard uncertainty of the endpoint, axes of the base", ENDPOINT_HEADER, endpoint_rows(allotment)),
        *([("Designed POSORs (simulated)", LAYOUT_HEADER, layout_rows(layouts))] if layouts else []),
    ]
    for title, header, rows in tables:
        table = Table(*header, title=title, title_justify="left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    print(f"page: {folder / PAGE}; a requirement of each POSOR: {folder}/<joint>/requirement.yaml")
    if layouts:
        print(f"to run it: posor bringup {folder / ARM_FILE}")
    return 0


def _layouts(requirements: Mapping[str, Requirement]) -> dict[str, Candidate]:
    """Return the chosen layout of each joint.

    Raises:
        DesignError: A requirement cannot be met.

    """
    errors, chosen = Console(stderr=True), {}
    with Progress(console=errors, transient=True, disable=not errors.is_terminal) as progress:
        for name, requirement in requirements.items():
            task = progress.add_task(name, total=1.0)
            search = LayoutSearch(requirement, lambda share, task=task: progress.update(task, completed=share))  # type: ignore[misc]
            result = search.run()
            if result.chosen is None:
                refuse(result)
            chosen[name] = result.chosen
    return chosen
