# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""``posor design arm``: from a required uncertainty of an endpoint to those of its POSORs and measuring beams."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import ARM_FILE, describe_argument
from posor.chain.arm_file import load_arm_file
from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.report_table import report_console
from posor.uncertainty.common_errors import CommonErrors

from posor_design.arm_allotment import allot
from posor_design.arm_design_page import allotment_tables, render_arm_page
from posor_design.arm_output import BEAMS, allotment_json, allotted_beams, arm_files, joint_requirements
from posor_design.endpoint_budget import configurations
from posor_design.nearest_requirement import search_layouts
from posor_design.posor_output import add_output_options, output_folder, requirement_text, write_design
from posor_design.quantity_text import parse_quantity, split_list

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

WHERE = "design arm"
JSON, PAGE = "allotment.json", "allotment.html"


def _parser() -> CommandLineParser:
    parser = CommandLineParser(
        prog=f"posor {WHERE}",
        description="Allot the required uncertainty of an arm's endpoint to its POSORs and measuring beams.",
        help_call=f"posor {WHERE} --help",
        allow_abbrev=False,
    )
    text = f"geometry, and present POSORs and beams: {describe_argument()}"
    parser.add_argument("arm", metavar="ARM", help=text)
    for option, unit, metavar, text in (
        ("--displacement", "m", "QUANTITY", "largest uncertainty along each axis of the base"),
        ("--orientation", "rad", "QUANTITY", "largest uncertainty about each axis of the base"),
        ("--coverage-factor", "1", "NUMBER", "default: 1, standard uncertainties"),
        ("--length-scale", "1", "NUMBER", "relative uncertainty of one length reference for all parts; default: exact"),
        ("--temperature", "K", "QUANTITY", "uncertainty of one calibration temperature for all parts; default: exact"),
    ):
        parser.add_argument(
            option,
            type=partial(_positive, si=unit, where=f"{WHERE}, {option}"),
            required=unit in {"m", "rad"},
            default=1.0 if option == "--coverage-factor" else 0.0,
            metavar=metavar,
            help=text,
        )
    parser.add_argument(
        "--posture",
        action="append",
        default=[],
        metavar="ANGLES",
        help="angles of all joints, such as --posture='0, 30, 90 deg'; may be repeated; default: extended, and with "
        "the last joint at 90 deg",
    )
    parser.add_argument("--layouts", action="store_true", help="also design the POSORs, and write the whole arm")
    add_output_options(parser, "<name of the arm>")
    return parser


def _positive(text: str, si: str, where: str) -> float:
    value = parse_quantity(text, si, where, unit_required=True)
    if not value > 0.0:
        raise ParameterError(text, where=where, expected="more than 0")
    return value


def postures_of(texts: Sequence[str], joints: Sequence[str]) -> list[Mapping[str, float]]:
    """Return the angles of the joints [rad] of each posture.

    Raises ParameterError: a text is not a list of angles, one for each joint.
    """
    where = f"{WHERE}, --posture"
    postures: list[Mapping[str, float]] = []
    for text in texts:
        entries = split_list(text)
        if len(entries) != len(joints):
            raise ParameterError(f"{len(entries)} angles", where=where, expected=f"{len(joints)}: {', '.join(joints)}")
        angles = [parse_quantity(each, "rad", where, unit_required=True) for each in entries]
        postures.append(dict(zip(joints, angles, strict=True)))
    return postures or list(configurations(joints).values())


def main(arguments: Sequence[str]) -> int:
    """Run the program; exit code 0: the requirement is allotted, and with ``--layouts`` every POSOR is designed."""
    options = _parser().parse_args(list(arguments))
    arm = load_arm_file(options.arm)
    if options.layouts and arm.scenario is None:
        what = f"arm '{arm.name}' has no scenario"
        raise ParameterError(what, where=f"{WHERE}, --layouts", expected="an arm that can be simulated")
    folder = output_folder(options.output, arm.name, JSON, force=options.force)
    required = np.array([options.displacement] * 3 + [options.orientation] * 3) / options.coverage_factor
    postures = postures_of(options.posture, [joint.name for joint in arm.chain().joints])
    allotment = allot(arm, required, postures, CommonErrors(options.length_scale, options.temperature))
    requirements = joint_requirements(arm, allotment)
    found = search_layouts(requirements).items() if options.layouts else ()
    layouts = {name: chosen for name, (_, chosen) in found}
    beams = allotted_beams(arm, allotment)
    files = {
        JSON: json.dumps(allotment_json(allotment), indent=2) + "\n",
        PAGE: render_arm_page(arm.name, allotment, layouts),
        **{f"{name}/requirement.yaml": requirement_text(each) for name, each in requirements.items()},
        **({} if beams is None else {BEAMS: beams}),
        **(arm_files(arm, allotment, requirements, layouts) if layouts else {}),
    }
    write_design(folder, files, force=options.force)
    console = report_console(160)
    for table in allotment_tables(allotment, layouts).values():
        table.print(console)
    print(f"page: {folder / PAGE}; a requirement of each POSOR: {folder}/<joint>/requirement.yaml")
    if layouts:
        print(f"to run it: posor bringup {folder / ARM_FILE}")
    return 0
