# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""arm: makes the files of a new arm, and checks those of an arm."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from posor.arm_names import describe_argument
from posor.chain.commissioning_record import load_record
from posor.errors import ParameterError, PosorError
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.ros_names import ROS_NAME_RULE, is_ros_name
from posor.tables.number_text import parse_number
from posor.uncertainty.protection_level import arm_reliability
from posor_calibration.commissioning.file_checks import arm_identity
from posor_drivers.instruments.calibrated_readings import readings_of
from posor_drivers.instruments.instruments_file import load_instruments

from posor_bringup.arm_programs import DRIVER_NODE
from posor_bringup.arms import check_arm
from posor_bringup.bringup_options import add_arm_parameters
from posor_bringup.new_arm import AXES, COMMON_AXES, LONGEST, SENSORS, SHORTEST, arm_texts, new_joints, write_arm

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Sequence

    from posor_bringup.arms import CheckedArm
    from posor_bringup.new_arm import Axis, Sensors

T = TypeVar("T")
MOST_JOINTS = 20


def _parse_options(arguments: Sequence[str] | None) -> Namespace:
    parser = CommandLineParser(prog="posor arm", description="Make the files of a new arm, and check those of an arm.")
    actions = parser.add_subparsers(dest="action", required=True, parser_class=CommandLineParser)
    summary = "write the files of a simulated arm, to be completed by measured values"
    new = actions.add_parser("new", help=summary, description=summary)
    new.add_argument("name", metavar="NAME", help="name of the arm, also its ROS namespace")
    joints = whole_number_from(1, MOST_JOINTS)
    new.add_argument("--joints", type=joints, required=True, metavar="N", help=f"number, 1 to {MOST_JOINTS}")
    new.add_argument("--folder", type=Path, metavar="FOLDER", help="folder of the files (default: ./NAME)")
    text = f"one or N, separated by commas, at the angle zero (default: {','.join(COMMON_AXES)}, the first N)"
    new.add_argument("--axes", metavar="AXES", help=f"axes of the joints, {', '.join(AXES)} of the base; {text}")
    text = "lengths of the beams after the joints [m], one or N (default: 0.3)"
    new.add_argument("--lengths", default="0.3", metavar="LENGTHS", help=text)
    text = f"sensors of the joints, {', '.join(SENSORS)}; one or N (default: {SENSORS[0]})"
    new.add_argument("--sensors", default=SENSORS[0], metavar="SENSORS", help=text)
    new.add_argument("--names", metavar="NAMES", help="names of the joints (default: joint1, joint2, ...)")
    summary = "check all files and parameters of an arm; print everything that is wrong, or a summary"
    check = actions.add_parser("check", help=summary, description=summary)
    check.add_argument("arm", metavar="ARM", help=describe_argument())
    add_arm_parameters(check)
    return parser.parse_args(arguments)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if the files were written, or if all is right."""
    options = _parse_options(arguments)
    return _make(options) if options.action == "new" else _check(options)


def _per_joint(option: str, text: str, count: int, parse: Callable[[str], T | None], expected: str) -> list[T]:
    """Return an entry for each joint; one entry is for all."""
    entries = [entry.strip() for entry in text.split(",")]
    values = [value for value in map(parse, entries) if value is not None]
    if len(values) < len(entries) or len(entries) not in {1, count}:
        raise ParameterError(f"'{text}'", where=f"arm new, {option}", expected=f"1 or {count}: {expected}")
    return values * (count // len(values))


def _one_of(known: Sequence[T], text: str) -> T | None:
    return next((each for each in known if each == text), None)


def _make(options: Namespace) -> int:
    where, count = "arm new", options.joints
    if not is_ros_name(options.name):
        raise ParameterError(f"name '{options.name}'", where=where, expected=ROS_NAME_RULE)
    default = ",".join((COMMON_AXES * count)[:count])
    axes: list[Axis] = _per_joint("--axes", options.axes or default, count, partial(_one_of, AXES), ", ".join(AXES))
    expected = f"lengths of {SHORTEST:g} to {LONGEST:g} m"
    lengths = _per_joint("--lengths", options.lengths, count, _length, expected)
    sensors: list[Sensors] = _per_joint(
        "--sensors", options.sensors, count, partial(_one_of, SENSORS), ", ".join(SENSORS)
    )
    names = [f"joint{n + 1}" for n in range(count)] if options.names is None else options.names.split(",")
    if len(set(names)) != count or not all(map(is_ros_name, names)):
        expected = f"{count} different names, each {ROS_NAME_RULE}"
        raise ParameterError(f"'{options.names}'", where=f"{where}, --names", expected=expected)
    folder = options.folder or Path(options.name)
    write_arm(folder, arm_texts(options.name, new_joints(names, axes, lengths, sensors), str(folder)))
    print(f"{folder}: files of arm {options.name} with {count} joints; {folder / 'arm.yaml'} says what to replace")
    print(f"check: posor arm check {folder}; start: posor bringup {folder}; watch: posor view {folder}")
    return 0


def _length(text: str) -> float | None:
    try:
        length = parse_number(text)
    except ValueError:
        return None
    return length if SHORTEST <= length <= LONGEST else None


def _check(options: Namespace) -> int:
    checked = check_arm(
        options.arm,
        drivers=not options.no_driver,
        driver_parameters=dict(options.parameters),
        parameter_files=options.params_file,
    )
    for line in _summary(checked):
        print(line)
    return 0


def _summary(checked: CheckedArm) -> Iterator[str]:
    """Yield lines on an arm that is right."""
    arm, chain, calibrations = checked.arm, checked.chain, checked.calibrations
    yield f"{arm.name}: all files and the parameters of {len(checked.programs)} nodes are right ({arm.path})"
    for joint, calibration in calibrations.items():
        readings = Counter(readings_of(calibration).values())
        numbers = ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in readings.items())
        sensors = ", ".join(str(getattr(sensor, "type", "")) for sensor in calibration.sensors)
        yield f"joint {joint}: {sensors} ({numbers}); calibration {calibration.name}"
    angles = dict.fromkeys(calibrations, 0.0)
    reach = sum(float(np.linalg.norm(link.T_nominal.translation)) for link in chain.links)
    x, y, z = chain.nominal_endpoint(angles).translation.round(4) + 0.0  # -0.0 is 0.0
    place = f"{x:.4f}, {y:.4f}, {z:.4f} m in {chain.base_frame}"
    yield f"nominal reach: {reach:.4f} m; endpoint with all angles zero: {place}"
    yield from _drivers(checked)
    yield _gravity(checked)
    yield _levels(checked, angles)
    if arm.commissioning is None or not arm.commissioning.exists():
        yield "commissioning: none; 'posor commission' makes the record"
        return
    record = load_record(arm.commissioning)
    found = arm_identity(arm, calibrations).differences(record.parts())
    state = f"not as commissioned: {'; '.join(found.values())}" if found else "as commissioned"
    yield f"commissioning: {record.date}, {state}"


def _drivers(checked: CheckedArm) -> Iterator[str]:
    """Yield a line on the source of the drivers, if there are any."""
    drivers = [program.parameters for program in checked.programs if program.executable == DRIVER_NODE]
    for source in dict.fromkeys(parameters["source"] for parameters in drivers):
        rate = "at the rate of its recording or device"
        if source == "simulated":
            rate = f"{checked.scans_per_second} scans per second"
        if source == "instruments":
            file = Path(str(drivers[0]["instruments.file"]))
            rate = f"{load_instruments(file).rate.number:g} scans per second"
        yield f"driver: source {source}, {rate}"


def _gravity(checked: CheckedArm) -> str:
    """Return a line on the direction of gravity, by which beams sag."""
    components = checked.chain.gravity
    axis = int(np.argmax(np.abs(components)))
    sign = "+" if components[axis] > 0.0 else "-"
    how = {("-", 2): "the arm stands", ("+", 2): "the arm hangs"}.get((sign, axis), "the base is on its side")
    return f"gravity: along {sign}{'XYZ'[axis]} of {checked.chain.base_frame}, {how}"


def _levels(checked: CheckedArm, angles: dict[str, float]) -> str:
    """Return a line on the protection levels of the endpoint."""
    what = "protection level of the endpoint, all angles zero"
    try:
        found = arm_reliability(checked.chain, checked.calibrations, angles)
    except PosorError as error:
        return f"{what}: unknown, {error}"
    level = found.protection_level
    if np.isnan(level).any():
        return f"{what}: unknown, no joint has a pose with the calibrations as they are"
    if np.isfinite(level).all():
        return f"{what}: finite, at most {1e6 * max(level[:3]):.3g} um and {1e6 * max(level[3:]):.3g} urad"
    axes = zip(("x", "y", "z", "alpha", "beta", "gamma"), level, found.set_by, strict=True)
    causes = dict.fromkeys(f"{cause} of {joint}" for _, size, (joint, cause) in axes if not np.isfinite(size))
    return f"{what}: not finite, because no reading shows {', '.join(causes)}"
