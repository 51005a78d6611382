# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``calibrate-arm``: POSORs, beams, base and tool of an arm at once, from references of its endpoint."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.arm_names import describe_argument
from posor.bags.calibration_recording import bag_sha256
from posor.bags.offline_pipeline import load_arm
from posor.certificates.dcc_document import write_dcc
from posor.certificates.dcc_options import add_dcc_options, read_dcc_options
from posor.chain.beams_file import load_beams
from posor.chain.identity import file_sha256
from posor.errors import BagError, ParameterError
from posor.reporting.command_line_parser import CommandLineParser, number_from, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console
from posor.tables.table_readings import load_readings
from posor_calibration.arm.arm_files import JSON_FILE, Provenance, calibration_json, check_output, make_files, save_arm
from posor_calibration.arm.arm_fit import ArmProblem, Tool, calibrate_arm
from posor_calibration.arm.arm_model import ArmModel
from posor_calibration.arm.arm_poses import poses_at, recorded_poses, select_poses
from posor_calibration.arm.endpoint_references import (
    EndpointReferences,
    Reading,
    Uncertainty,
    check_references,
    references_of,
)
from posor_calibration.calibration_certificate import certificate_of_arm
from posor_calibration.data_checks import POSE_AXES
from posor_design.arm_uncertainty import ArmUncertainty
from posor_design.statement_poses import path_poses

from posor_bringup.reference_options import (
    PLACE_LIMITS,
    TOOL_UNCERTAINTY_LIMITS,
    UNCERTAINTY_LIMITS,
    check_names,
    named_numbers,
    numbers_of,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from posor.bags.offline_pipeline import Arm
    from posor.tables.table_readings import TableReadings
    from posor_calibration.arm.arm_files import CalibratedFiles
    from posor_calibration.arm.arm_fit import ArmCalibration
    from rich.console import Console

WIDTH = 160
WHERE = "calibrate-arm"
POINT, PLACE = 3, 6  # numbers of a reflector


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid, or options do not fit together."""
    description = "Calibrate POSORs, beams, base and tool of an arm at once, from references of its endpoint."
    parser = CommandLineParser(prog="posor calibrate-arm", description=description)
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument("--bag", type=Path, help="raw scans of the arm at rest, at the times of the table")
    parser.add_argument("--table", type=Path, metavar="FILE", help="readings of a laser tracker, ball bar or artefact")
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="map of the columns of the table")
    text = "standard uncertainty of a reference of the map [m], per metre of distance, of angles [rad]; may be repeated"
    parser.add_argument("--uncertainty", action="append", default=[], metavar="NAME=M[,PER_METRE[,RAD]]", help=text)
    text = "reflector or ball as drawn, in the endpoint [m], [rad]; default: at the endpoint; may be repeated"
    parser.add_argument("--tool", action="append", default=[], metavar="NAME=X,Y,Z[,ROLL,PITCH,YAW]", help=text)
    text = "standard uncertainty of the reflectors in the endpoint (default: %(default)s)"
    parser.add_argument("--tool-uncertainty", default="0.05,0.2", metavar="M,RAD", help=text)
    text = "scans this long before and after the time of a row are averaged [s] (default: %(default)g)"
    parser.add_argument("--window", type=number_from(0.0, unit="s"), default=0.1, metavar="S", help=text)
    text = "every Nth pose is not used, but compared with the result; 0: none (default: %(default)d)"
    parser.add_argument("--hold-out", type=whole_number_from(0), default=5, metavar="N", help=text)
    text = "print the N poses of --candidates that determine most, in place of a calibration"
    parser.add_argument("--select", type=whole_number_from(1), metavar="N", help=text)
    text = "of --select: a column of angles [rad] for each joint, named by it"
    parser.add_argument("--candidates", type=Path, metavar="FILE.csv", help=text)
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/calibrate_arm/<name of the arm>")
    parser.add_argument("--force", action="store_true", help="replace existing files; the old ones are kept")
    add_dcc_options(parser)
    options = parser.parse_args(arguments)
    needed = ("candidates",) if options.select is not None else ("bag", "table", "map")
    missing = [f"--{name}" for name in needed if getattr(options, name) is None]
    if missing:
        expected = "--bag, --table and --map, or --select with --candidates"
        raise ParameterError(f"{' and '.join(missing)} missing", where=WHERE, expected=expected)
    if options.select is not None and options.dcc is not None:
        raise ParameterError("--dcc with --select", where=WHERE, expected="--select alone: it calibrates nothing")
    if (options.candidates is None) != (options.select is None):
        raise ParameterError("--candidates without --select", where=WHERE, expected="both")
    if options.hold_out == 1:
        raise ParameterError("no pose would be used", where=f"{WHERE}, --hold-out", expected="0, or 2 or more")
    options.tool = named_numbers(f"{WHERE}, --tool", options.tool, (POINT, PLACE), PLACE_LIMITS)
    options.tool_uncertainty = numbers_of(
        f"{WHERE}, --tool-uncertainty", options.tool_uncertainty, (2,), TOOL_UNCERTAINTY_LIMITS
    )
    options.uncertainty = {
        name: Uncertainty(*numbers)
        for name, numbers in named_numbers(
            f"{WHERE}, --uncertainty", options.uncertainty, (1, 2, 3), UNCERTAINTY_LIMITS
        ).items()
    }
    return options


def _tools(options: argparse.Namespace, reflectors: Mapping[str, object]) -> dict[str, Tool]:
    """Return the tool of each reflector; one without ``--tool`` is at the endpoint."""
    given, (length, angle) = options.tool, options.tool_uncertainty
    check_names(f"{WHERE}, --tool", given, reflectors)
    places = {name: np.array([*given.get(name, ()), *[0.0] * PLACE][:PLACE]) for name in reflectors}
    return {
        name: Tool(pin.SE3(pin.rpy.rpyToMatrix(place[POINT:]), place[:POINT]), (length, angle))
        for name, place in places.items()
    }


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the files have been written, or the poses printed."""
    options = parse_options(arguments)
    arm = load_arm(options.arm)
    uncertainties = options.uncertainty
    console = report_console(WIDTH)
    if options.select is not None:
        _print_selection(arm, options, console)
        return 0
    stated = read_dcc_options(options, WHERE)
    folder = options.output or Path("build/calibrate_arm") / arm.name
    check_output(folder, arm, force=options.force)
    _check_unused(arm, options.bag)
    table = load_readings(options.table, options.map, needs_joints=False)
    references = references_of(table, uncertainties, str(options.table))
    check_names(f"{WHERE}, --uncertainty", uncertainties, references.reflectors)
    tools = _tools(options, references.reflectors)
    chain = arm.chain()
    estimates = arm.estimate(options.bag)
    poses = recorded_poses(estimates, chain, references.stamps_ns, references.rows, options.window, str(options.bag))
    model = ArmModel(chain, {joint.name: arm.calibration(joint.name) for joint in chain.path_joints}, poses)
    states = model.states(poses, model.effects_at(poses))
    endpoints = model.move(states, np.zeros(len(model.parameters)), pin.SE3.Identity()).endpoints
    places = {name: tool.T_endpoint_reflector for name, tool in tools.items()}
    check_references(references, endpoints, places, str(options.table))
    problem = ArmProblem(model, states, references, tools)
    every = range(len(poses.names))
    found = calibrate_arm(problem, every[options.hold_out - 1 :: options.hold_out] if options.hold_out else ())
    files_read = [path for path in (arm.path, arm.urdf, arm.beams, options.table, options.map) if path is not None]
    sources = {str(path): file_sha256(path) for path in (*files_read, *arm.calibrations.values())}
    sources[str(options.bag)] = bag_sha256(options.bag)
    origin = Provenance(dt.datetime.now(dt.UTC).isoformat(timespec="seconds"), sources)
    files = make_files(arm, problem, found, poses, origin)
    texts = {**files.texts, JSON_FILE: calibration_json(found, files, origin)}
    kept = save_arm(folder, texts, force=options.force)
    for line in _left_out(table):
        console.print(line, soft_wrap=True, markup=False)
    _print(found, files, console)
    for path in kept:
        console.print(f"kept: {path}", soft_wrap=True, markup=False)
    console.print(f"{', '.join(texts)}: {folder}", soft_wrap=True, markup=False)
    if stated is not None:
        write_dcc(options.dcc, certificate_of_arm(arm, found, origin), stated)
        console.print(f"certificate: {options.dcc}", soft_wrap=True, markup=False)
    return 0


def _check_unused(arm: Arm, bag: Path) -> None:
    """Refuse a bag by which the arm is already calibrated: its beams file, the prior knowledge, contains it."""
    notes = () if arm.beams is None else load_beams(arm.beams).provenance.notes
    if any(bag_sha256(bag) in note for note in notes):
        expected = "the arm file from before that calibration, or another recording: no reading counts twice"
        raise BagError(f"{arm.beams} is already calibrated by it", where=f"{WHERE}, {bag}", expected=expected)


def _left_out(table: TableReadings) -> list[str]:
    """Return sentences on what of a table is not used."""
    lines = [f"columns left out: {', '.join(table.unused)}"] if table.unused else []
    lines += [f"rows left out: {count} ({kind})" for kind, count in table.left_out.items()]
    if table.joints:
        lines.append(f"scans of {', '.join(table.joints)} in the table are not used: those of the bag are")
    return lines


def _print(found: ArmCalibration, files: CalibratedFiles, console: Console) -> None:
    rows = [
        [
            f"{when}, {group}",
            str(each.readings),
            f"{1e6 * each.position:.1f}",
            f"{1e6 * each.orientation:.1f}",
            f"{1e6 * each.largest:.1f}",
        ]
        for when, misfits in (("before", found.before), ("after", found.after))
        for group, each in misfits.items()
        if each.readings
    ]
    header = ("", "readings", "rms [µm]", "rms [µrad]", "largest [µm]")
    title = "Readings against the arm; before: base and tool alone fitted"
    ReportTable(title, header, [[cell.replace("nan", "") for cell in row] for row in rows]).print(console)
    lines = [f"left out, the others contradict: {', '.join(found.outliers)}"] if found.outliers else []
    lines.append(f"not determined, as before: {', '.join(_grouped(found.undetermined)) or 'no parameter'}")
    for name, how in (("the files", files.files), ("controller.urdf alone", files.controller)):
        text = f"{1e6 * how.position:.2f} µm and {1e6 * how.orientation:.2f} µrad rms from the fit, at most"
        lines.append(f"{name}: {text} {1e6 * how.largest:.2f} µm")
    for line in (*lines, *found.warnings):
        console.print(line, soft_wrap=True, markup=False)


def _grouped(names: Sequence[str]) -> list[str]:
    """Return the names of parameters with those of one part together; of all six of a part its name alone."""
    parts: dict[str, list[str]] = {}
    for name in names:
        axis = next((axis for axis in sorted(POSE_AXES, key=len, reverse=True) if name.endswith(f" {axis}")), "")
        parts.setdefault(name.removesuffix(f" {axis}") if axis else name, []).append(axis)
    whole = ([""], list(POSE_AXES))
    return [name if axes in whole else f"{name} ({', '.join(axes)})" for name, axes in parts.items()]


def _print_selection(arm: Arm, options: argparse.Namespace, console: Console) -> None:
    """Print the best candidates, as a table (CSV) of angles."""
    uncertainties = options.uncertainty
    if not uncertainties:
        raise ParameterError("--uncertainty missing", where=WHERE, expected="that of each reflector")
    tools = _tools(options, uncertainties)
    uncertain = ArmUncertainty(arm)
    angles = path_poses(uncertain, options.candidates).angles
    chain = uncertain.chain
    poses = poses_at(chain, uncertain.calibrations, angles)
    model = ArmModel(chain, uncertain.calibrations, poses)
    states = model.states(poses, model.effects_at(poses))
    readings = []
    for n, endpoint in enumerate(model.move(states, np.zeros(len(model.parameters)), pin.SE3.Identity()).endpoints):
        for name, own in uncertainties.items():
            place = endpoint * tools[name].T_endpoint_reflector
            length = own.constant + own.per_metre * float(np.linalg.norm(place.translation))
            values, sigmas = pin.SE3ToXYZQUAT(place), np.repeat([length, own.angle], POINT)
            size = (len(values), PLACE) if own.angle else (POINT, POINT)
            readings.append(
                Reading(
                    poses.names[n],
                    n,
                    name,
                    "pose" if own.angle else "point",
                    values[: size[0]],
                    None,
                    sigmas[: size[1]],
                )
            )
    references = EndpointReferences(np.arange(len(angles)), np.arange(len(angles)) + 1, tuple(readings), {})
    chosen = select_poses(ArmProblem(model, states, references, tools), options.select)
    console.print(",".join(model.joints), soft_wrap=True, markup=False, highlight=False)
    for pose in chosen:
        console.print(",".join(f"{angle:.6g}" for angle in angles[pose]), soft_wrap=True, markup=False, highlight=False)
