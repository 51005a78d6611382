# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``correct``: a recorded robot program, corrected by the endpoints measured while the robot ran it."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from posor.arm_names import describe_argument
from posor.bags.offline_pipeline import load_arm
from posor.bags.recorded_encoders import read_encoders
from posor.bags.result_folder import check_outside_of_bags
from posor.correction.encoder_errors import describe_lateness, encoder_errors
from posor.correction.joint_correction import CorrectionLimits
from posor.correction.joint_path import CSV_SUFFIX, YAML_SUFFIXES, read_path
from posor.correction.nominal_robot import LeastSquares, NominalRobot
from posor.correction.program_correction import MeasuredRun, begin_of_program, correct_path
from posor.errors import BagError, ParameterError
from posor.numerics.stamps import NS
from posor.output_files import write_files
from posor.parameter_model import parameter_specs
from posor.reporting.command_line_parser import CommandLineParser, number_from
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.bags.offline_pipeline import Arm
    from posor.correction.joint_path import JointPath
    from posor.numerics.array_types import FloatArray
    from posor.parameter_model import ParameterGroup, ParameterSpec

LARGEST_LATENESS_S = 5e-4  # of encoders; the windup of a drive grows with the rate, too
PROGRAM_LIMITS = CorrectionLimits(max_rate=0.1)
"""A program may cross the backlash of a gear faster than an outer loop, whose noise its limit of the rate bounds."""
FROM_PARAMETERS = {"max_offset": "RAD", "max_rate": "RAD/S", "rotation_length": "M", "least_lever": "M"}
"""Options that are parameters of correction_node, and their units."""


def _setting(model: type[ParameterGroup], spec: ParameterSpec) -> Callable[[str], float]:
    """Return the parser of an option with the limits of a parameter of correction_node."""

    def parse(text: str) -> float:
        try:
            return float(getattr(model.model_validate({spec.name: float(text)}), spec.name))
        except ValueError:  # of pydantic, too
            raise argparse.ArgumentTypeError(f"'{text}' is wrong; expected {spec.constraint}") from None

    return parse


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid."""
    parser = CommandLineParser(
        prog="posor correct", description="Correct a recorded robot program by endpoints measured while it ran."
    )
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    parser.add_argument("program", type=Path, metavar="PROGRAM", help="joint angles over time, CSV or YAML")
    parser.add_argument("--bag", type=Path, required=True, metavar="BAG", help="raw scans of the arm during the run")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="corrected program, CSV or YAML")
    text = "the program that ran in the bag, such as an earlier correction (default: PROGRAM)"
    parser.add_argument("--ran", type=Path, metavar="FILE", help=text)
    text = "topic of the robot's joint angles in the bag (sensor_msgs/JointState); default: the program that ran"
    parser.add_argument("--encoders", metavar="TOPIC", help=text)
    text = "time between the rows of the result [s] (default: the rows of PROGRAM)"
    parser.add_argument("--period", type=number_from(1e-4, unit="s"), metavar="S", help=text)
    text = "standard deviation of the smoothing [s]; 0: none (default: %(default)g)"
    parser.add_argument("--smoothing", type=number_from(0.0, 1.0, unit="s"), default=0.01, metavar="S", help=text)
    for model, settings in ((CorrectionLimits, PROGRAM_LIMITS), (LeastSquares, LeastSquares())):
        for spec in parameter_specs(model):
            if spec.name in FROM_PARAMETERS:
                option, default = f"--{spec.name.replace('_', '-')}", getattr(settings, spec.name)
                text = f"{spec.field.description} (default: {default:g})"
                parser.add_argument(
                    option, type=_setting(model, spec), default=default, metavar=FROM_PARAMETERS[spec.name], help=text
                )
    parser.add_argument("--force", action="store_true", help="replace an existing file")
    return parser.parse_args(arguments)


def measured_run(
    options: argparse.Namespace, arm: Arm, robot: NominalRobot, ran: JointPath
) -> tuple[MeasuredRun, int, int]:
    """Return the usable endpoints of the bag on the clock of the program, and how many there are and are not used."""
    where = str(options.bag)
    estimates = arm.estimate(options.bag)
    end = estimates.endpoint_of_one_run(where)
    usable = np.isfinite(end.poses).all(axis=1) & ~end.degraded
    columns = [estimates.chain.index(name) for name in robot.joints]
    stamps_ns, poses, angles = end.stamps_ns[usable], end.poses[usable], end.angles[usable][:, columns]
    if options.encoders:
        readings = read_encoders(options.bag, options.encoders, robot.joints, arm.namespace)
        seen = angles
        angles = np.column_stack([readings.at(joint, stamps_ns)[:, 0] for joint in range(len(robot.joints))])
        _check_lateness(robot, readings.source, (stamps_ns - stamps_ns[0]) / NS, seen, angles)
        known = np.isfinite(angles).all(axis=1)
        stamps_ns, poses, angles = stamps_ns[known], poses[known], angles[known]
    if len(stamps_ns) < 2:  # noqa: PLR2004  a time between two
        degraded = np.count_nonzero(end.degraded)
        what = f"{len(stamps_ns)} of {len(end)} endpoints can be used, {degraded} are DEGRADED"
        raise BagError(what, where=where, expected="raw scans of sound poses while the robot ran it")
    times_s = (stamps_ns - stamps_ns[0]) / NS
    times_s = times_s - begin_of_program(ran, times_s, angles)
    if not options.encoders:  # where the robot was before and after is not known
        during = (times_s >= ran.times_s[0]) & (times_s <= ran.times_s[-1])
        times_s, poses = times_s[during], poses[during]
        angles = ran.sampler()(times_s)
    return MeasuredRun(times_s, angles, poses, where), len(end), len(stamps_ns)


def _check_lateness(
    robot: NominalRobot, source: str, times_s: FloatArray, angles: FloatArray, readings: FloatArray
) -> None:
    """Refuse encoders whose stamps are wrong by what their POSORs show; angles and readings in rad, (n, j)."""
    unknown = []
    for name, seen, read in zip(robot.joints, angles.T, readings.T, strict=True):
        errors = encoder_errors(seen, read, times_s)
        if math.isnan(errors.lateness):
            unknown.append(name)
        if lateness := describe_lateness(errors, LARGEST_LATENESS_S):
            what, expected = f"the encoder of joint {name}: {lateness}", "the stamps of the scans' clock"
            raise BagError(what, where=source, expected=f"{expected}, or no --encoders")
    if unknown:
        print(f"not known how late the encoder is, because its joint hardly changes its speed: {', '.join(unknown)}")


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    options = parse_options(arguments)
    suffix = options.output.suffix.lower()
    if suffix not in (*YAML_SUFFIXES, CSV_SUFFIX):
        what, expected = f"ends in '{options.output.suffix}'", " or ".join((CSV_SUFFIX, *YAML_SUFFIXES))
        raise ParameterError(what, where=f"--output {options.output}", expected=expected)
    as_yaml = suffix in YAML_SUFFIXES
    arm = load_arm(options.arm)
    for path in (options.program, options.ran, arm.path):
        if path is not None and path.resolve() == options.output.resolve():
            raise ParameterError("is read", where=f"--output {options.output}", expected="another file")
    check_outside_of_bags(options.output, [options.bag])
    if options.output.exists() and not options.force:
        raise ParameterError("exists", where=f"--output {options.output}", expected="a new file, or --force")
    limits = PROGRAM_LIMITS.model_copy(update={name: getattr(options, name) for name in ("max_offset", "max_rate")})
    weights = LeastSquares(rotation_length=options.rotation_length, least_lever=options.least_lever)
    robot = NominalRobot(arm.chain(), weights)
    planned = read_path(options.program).of_joints(robot.joints)
    ran = planned if options.ran is None else read_path(options.ran).of_joints(robot.joints)
    path = planned if options.period is None else planned.at_period(options.period)
    leaves = float(np.max(np.abs(path.sampler()(planned.times_s) - planned.angles)))
    if leaves > limits.max_offset:
        what = f"{options.period:g} s: straight lines between the rows leave the program by {leaves:.3g} rad"
        raise ParameterError(what, where="option --period", expected=f"at most {limits.max_offset:g} rad, --max-offset")
    if path.velocities is not None and not as_yaml:
        what, expected = f"has velocities, which {options.output} cannot hold", "an --output in YAML, or --period"
        raise ParameterError(what, where=str(options.program), expected=expected)
    run, scans, used = measured_run(options, arm, robot, ran)
    corrected = correct_path(path, run, robot, limits, options.smoothing, planned.duration_s)
    write_files({options.output: corrected.text(as_yaml=as_yaml)})
    offsets = np.abs(corrected.angles - path.angles).max(axis=0)
    print(f"{used} of {scans} endpoints used; the first one {run.times_s[0]:.4f} s after the program began")
    for name, largest in zip(robot.joints, offsets, strict=True):
        print(f"  {name}: offsets up to {1e6 * largest:.0f} µrad")
    print(f"corrected program written to {options.output}")
    return 0
