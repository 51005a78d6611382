# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``encoders``: encoder minus POSOR of each joint of a recorded arm, by angle and direction of motion."""

from __future__ import annotations

import csv
import math
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import describe_argument
from posor.bags.offline_pipeline import load_arm
from posor.bags.recorded_encoders import read_encoders
from posor.bags.result_folder import name_of_bag
from posor.chain.endpoint_predictor import describe_disagreement, describe_jump, is_same_motion
from posor.correction.encoder_errors import SETTLED_TURN, describe_lateness, encoder_errors
from posor.errors import OutputError, ParameterError
from posor.numerics.stamps import NS
from posor.numerics.vector import wrapped_angles
from posor.output_files import make_folder, write_files
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence

    from posor.chain.kinematic_chain import Chain
    from posor.correction.encoder_errors import EncoderErrors
    from posor.numerics.array_types import FloatArray

PARTS = 64  # of a recording, between which the motions of encoder and POSOR are compared
LEAST_ERROR = 1e-3  # largest error of an encoder's motion that is not taken for another encoder, sign or scale [rad]
LARGEST_LATENESS_S = 0.01  # whose effect the rate explains to some µrad
BACKLASH_NOISE = 1e-4  # largest amount of a negative backlash that is no late reading [rad]
HEADER = ("joint", "direction", "angle_rad", "encoder_minus_posor_rad", "standard_deviation_rad", "readings")


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid."""
    parser = CommandLineParser(
        prog="posor encoders", description="Encoder minus POSOR of each joint: backlash, windup, eccentricity."
    )
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument(
        "--bag", type=Path, required=True, help="raw scans of the arm, and the readings of its encoders"
    )
    parser.add_argument("--topic", required=True, help="topic of the readings (sensor_msgs/JointState)")
    text = "names of the joints in the readings, in the order of the chain (default: those of the URDF)"
    parser.add_argument("--names", metavar="A,B,...", default="", help=text)
    text = "bins of each direction over the angles of a joint (default: %(default)s)"
    parser.add_argument("--bins", type=whole_number_from(1), default=36, metavar="N", help=text)
    parser.add_argument("--output", type=Path, metavar="FILE.csv", help="default: build/encoders/<name of the bag>.csv")
    options = parser.parse_args(arguments)
    options.output = options.output or Path("build/encoders") / f"{name_of_bag(options.bag)}.csv"
    if options.output.is_file() and not _is_table(options.output):
        raise OutputError("is no table of this program", where=str(options.output), expected="another name")
    return options


def _is_table(path: Path) -> bool:
    """Return whether a file may be replaced: it begins with the header of a table, or is empty."""
    header = ",".join(HEADER).encode()
    try:
        with path.open("rb") as file:
            return file.read(len(header)) in (b"", header)
    except OSError as error:
        raise OutputError(f"cannot be read, {error.strerror}", where=str(path)) from error


def find_errors(options: argparse.Namespace) -> dict[str, EncoderErrors]:
    """Return the errors of each encoder, by joint. Raises PosorError: an input cannot be used."""
    arm = load_arm(options.arm)
    chain = arm.chain()
    joints = tuple(joint.name for joint in chain.joints)
    names = tuple(options.names.split(",")) if options.names else joints
    if len(names) != len(joints):
        what, expected = f"{len(names)} names", f"one for each of {', '.join(joints)}"
        raise ParameterError(what, where="posor encoders, --names", expected=expected)
    encoders = read_encoders(options.bag, options.topic, names, arm.namespace)
    end = arm.estimate(options.bag).endpoint_of_one_run(str(options.bag))
    where = f"{options.bag}, topic {options.topic}"
    times_s = (end.stamps_ns - end.stamps_ns[:1]) / NS
    gravity, found = _gravity_in_plates(chain, end.angles), {}
    for j, joint in enumerate(joints):
        readings, efforts = encoders.at(j, end.stamps_ns).T
        if wrong := _disagreement(readings, end.angles, j, joints):
            what, expected = f"the encoder of joint {joint} {wrong}", "its own readings, in rad"
            raise ParameterError(what, where=where, expected=expected)
        around = np.hstack(gravity[j : j + 3]) if gravity else None  # before and after the joint, after the next one
        found[joint] = encoder_errors(end.angles[:, j], readings, times_s, efforts, options.bins, around)
        lateness = describe_lateness(found[joint], LARGEST_LATENESS_S)
        if (backlash := found[joint].backlash) < -BACKLASH_NOISE and not lateness:
            lateness = f"the backlash would be {1e6 * backlash:.0f} µrad: its readings are late or held"
        if lateness:
            expected = "new readings in each message, with the stamps of the scans' clock"
            raise ParameterError(f"the encoder of joint {joint}: {lateness}", where=where, expected=expected)
    if not any(each.readings for each in found.values()):
        what, expected = "no joint moves while its encoder is read", "scans and readings of one motion and one clock"
        raise ParameterError(what, where=where, expected=expected)
    return found


def _disagreement(readings: FloatArray, angles: FloatArray, j: int, joints: Sequence[str]) -> str:
    """Return how the encoder of joint j moves beside the POSORs, angles (n, j), if not like its own; else empty."""
    known = np.flatnonzero(np.isfinite(readings) & np.isfinite(angles).all(axis=1))
    if not len(known):
        return ""
    some = known[np.linspace(0, len(known) - 1, min(PARTS, len(known))).round().astype(int)]
    moved, turned = np.diff(readings[some]), wrapped_angles(np.diff(angles[some], axis=0))
    span = max(np.ptp(readings[some]), np.ptp(angles[some], axis=0).max())
    if span < SETTLED_TURN or np.abs(moved - turned[:, j]).max(initial=0.0) < LEAST_ERROR:
        return ""
    if (jump := describe_jump(moved, turned[:, j])) or is_same_motion(moved, turned[:, j]):
        return jump
    return describe_disagreement(moved, turned[:, j], {joints[k]: turned[:, k] for k in range(len(joints)) if k != j})


def _gravity_in_plates(chain: Chain, angles: FloatArray) -> list[FloatArray]:
    """Return the direction of gravity in the base and in each target plate, (n, 3); empty: joints not in one row."""
    amount = float(np.linalg.norm(chain.gravity))
    if chain.joints != chain.path_joints or not amount:
        return []
    found = [np.tile(chain.gravity / amount, (len(angles), 1))]
    for link, joint, angle in zip(chain.links, chain.joints, angles.T, strict=False):  # the last link ends the arm
        x, y, z = (found[-1] @ link.T_nominal.rotation @ joint.T_parent_joint.rotation).T
        cosine, sine = np.cos(angle), np.sin(angle)
        found.append(np.column_stack([cosine * x + sine * y, cosine * y - sine * x, z]))
    return found


def write_table(path: Path, found: Mapping[str, EncoderErrors]) -> None:
    """Write all bins. Raises OutputError: the file cannot be written."""
    text = StringIO()
    writer = csv.writer(text)
    writer.writerow(HEADER)
    for joint, each in found.items():
        writer.writerows((joint, *row) for row in each.table)
    make_folder(path.parent)
    write_files({path: text.getvalue()})


def _cell(value: float, factor: float = 1e6) -> str:
    return f"{factor * value:.2f}" if math.isfinite(value) else "-"


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the table has been written."""
    options = parse_options(arguments)
    found = find_errors(options)
    write_table(options.output, found)
    header = (
        *("joint", "readings", "range [rad]", "offset [µrad]", "backlash [µrad]", "late [µs]", "its u [µs]"),
        *("slope [µrad/rad]", "once per turn [µrad]", "windup [µrad/(N m)]", "gravity, rms [µrad]", "rest, rms [µrad]"),
    )
    rows = [
        [joint, str(each.readings), _cell(each.range_rad, 1.0), *map(_cell, each[2:-1])]
        for joint, each in found.items()
    ]
    console = report_console(160)
    ReportTable("Encoder minus POSOR", header, rows).print(console)
    if still := [joint for joint, each in found.items() if not each.readings]:
        console.print(f"No motion: {', '.join(still)}.", markup=False)
    console.print(f"by angle and direction: {options.output}", soft_wrap=True, markup=False)
    return 0
