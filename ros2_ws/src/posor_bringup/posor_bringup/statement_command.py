# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``statement``: the uncertainty of an arm's endpoint for a customer, as one page, PDF and JSON."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from posor.arm_names import describe_argument
from posor.certificates.dcc_document import write_dcc
from posor.certificates.dcc_options import add_dcc_options, read_dcc_options
from posor.chain.arm_file import load_arm_file
from posor.output_files import make_folder
from posor.reporting.command_line_parser import CommandLineParser, number_from, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import report_console
from posor.tables.number_text import parse_number
from posor_design.arm_uncertainty import ArmUncertainty
from posor_design.statement import make_statement
from posor_design.statement_certificate import certificate_of
from posor_design.statement_poses import bag_poses, given_pose, grid_poses, path_poses
from posor_design.statement_records import Records
from posor_design.statement_report import print_statement, write_statement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_file import ArmFile
    from posor_design.statement import Statement
    from posor_design.statement_poses import StatementPoses

WIDTH = 160
MOST_DEVIATION_K = 300.0  # of the beams from the temperature of the URDF


def _angles(text: str) -> list[float]:
    try:
        angles = [parse_number(part) for part in text.split(",")]
    except ValueError:
        angles = [math.nan]
    if not all(map(math.isfinite, angles)):
        raise argparse.ArgumentTypeError(f"'{text}' is not a list of angles a,b,... in rad")
    return angles


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid, or there is no pose."""
    parser = CommandLineParser(
        prog="posor statement", description="State the uncertainty of an arm's endpoint: page, PDF and JSON."
    )
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument(
        "--angles",
        type=_angles,
        metavar="a,b,...",
        help="of the joints from base to endpoint in rad, written --angles=...",
    )
    parser.add_argument("--path", type=Path, metavar="FILE.csv", help="poses: a column of angles in rad for each joint")
    text = "poses of the workspace: N angles of each joint"
    parser.add_argument("--grid", type=whole_number_from(1), metavar="N", help=text)
    text = "recorded scans: their poses; with --angles, the scatter of the scans of the arm at rest there"
    parser.add_argument("--bag", type=Path, help=text)
    text = "the result is the mean of N scans (default: 1)"
    parser.add_argument("--average", type=whole_number_from(1), default=1, metavar="N", help=text)
    text = "the beams deviate by at most this from the temperature of the URDF (default: as the beams file states)"
    parser.add_argument("--temperature-deviation", type=number_from(0.0, MOST_DEVIATION_K, "K"), metavar="K", help=text)
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/statement/<name of the arm>")
    add_dcc_options(parser)
    options = parser.parse_args(arguments)
    given = [name for name in ("angles", "path", "grid", "bag") if getattr(options, name) is not None]
    if not given:
        parser.error("no pose is given: --angles, --path, --grid or --bag")
    if len(given) > 1 and given != ["angles", "bag"]:
        parser.error(f"--{given[0]} with --{given[1]}: only --angles and --bag go together")
    return options


def _poses(options: argparse.Namespace, model: ArmUncertainty, arm: ArmFile) -> StatementPoses:
    if options.bag is not None:
        return bag_poses(model, arm, options.bag, options.angles, options.average)
    if options.path is not None:
        return path_poses(model, options.path)
    return given_pose(model, options.angles) if options.grid is None else grid_poses(model, options.grid)


def compute_statement(options: argparse.Namespace) -> Statement:
    """Return the statement for options as ``parse_options`` returns them.

    Raises PosorError: a file of the arm, the bag or the path is invalid, or a POSOR has no valid pose.
    """
    arm = load_arm_file(options.arm)
    model = ArmUncertainty(arm, deviation=options.temperature_deviation)
    poses = _poses(options, model, arm)
    return make_statement(arm, model, poses, Records(arm, options.bag, options.path), options.average)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the statement has been written."""
    options = parse_options(arguments)
    stated = read_dcc_options(options, "statement")
    statement = compute_statement(options)
    folder = options.output or Path("build/statement") / statement.arm.name
    make_folder(folder)
    write_statement(statement, folder)
    if stated is not None:
        write_dcc(options.dcc, certificate_of(statement), stated)
    console = report_console(WIDTH)
    print_statement(statement, console)
    console.print(f"page, PDF and JSON: {folder}", soft_wrap=True, markup=False)
    if stated is not None:
        console.print(f"certificate: {options.dcc}", soft_wrap=True, markup=False)
    return 0
