# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""commission: checks plugs, motions and files of an arm, and writes its commissioning record if it passes.

A running arm is recorded while the program guides through the steps; with ``--bag`` an earlier recording is checked.
"""

from __future__ import annotations

import datetime as dt
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from posor.arm_names import describe_argument
from posor.bags.provenance import provenance_of
from posor.bags.reprocess_task import Settings
from posor.bags.result_folder import prepare_outputs
from posor.calibration.save import save_calibration
from posor.chain.commissioning_record import load_record
from posor.errors import ParameterError
from posor.output_files import write_files
from posor.reporting.command_line_parser import CommandLineParser, number_above, number_from, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.ros_names import COMMISSIONING_TOPIC, RAW_TOPIC
from posor_calibration.commissioning.commissioning_recording import CommissioningTopics, load_commissioning
from posor_calibration.commissioning.commissioning_report import check_commissioning, checked_joints
from posor_calibration.commissioning.plan import CommissioningSettings, steps_of
from posor_ros.node_program import non_ros_arguments, ros_context

from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import add_namespace
from posor_bringup.commissioning_guide import Guide, StepTimes, recording
from posor_bringup.view_messages import ArmTopics

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Collection, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.chain.commissioning_record import CommissioningRecord
    from posor_calibration.commissioning.commissioning_report import CommissioningReport

OUTPUT = Path("build/commissioning")
RECORD = "commissioning.json"
PAGE, NUMBERS, BAG = "report.html", "report.json", "bag"
POSTURES = 8
NOT_PASSED = 3
"""Exit code of an arm that fails a check."""


class SettingOption(NamedTuple):
    """An option for a field of ``CommissioningSettings``."""

    name: str  # of the field
    unit: str
    text: str
    factor: float = 1.0  # from the unit of the option to that of the field


SETTINGS = (
    SettingOption("lift", "mm", "amount by which probes are lifted, a gauge", 1e-3),
    SettingOption("lift_sigma", "um", "standard uncertainty of one lift", 1e-6),
    SettingOption("sweep", "deg", "range of the motion of each joint", math.pi / 180.0),
    SettingOption("position", "um", "standard deviation of a joint from its place in the URDF", 1e-6),
    SettingOption("tilt", "urad", "of its axis from that in the URDF", 1e-6),
    SettingOption("runout", "um", "of the change of the place in a sweep", 1e-6),
    SettingOption("wobble", "urad", "of the change of the tilt in a sweep", 1e-6),
    SettingOption("encoder", "urad", "of the encoder from the joint, backlash included", 1e-6),
    SettingOption("encoder_zero", "mrad", "largest difference of the zeros of encoder and joint", 1e-3),
    SettingOption("reference", "um", "standard uncertainty of the reference of the endpoint", 1e-6),
)


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    parser = CommandLineParser(prog="posor commission", description="Check plugs, motions and files of an arm.")
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    text = "check this recording of the steps; default: record the running arm, guided step by step"
    parser.add_argument("--bag", type=Path, metavar="PATH", help=text)
    add_namespace(parser)
    text = f"folder of page, JSON and recording (default: {OUTPUT})"
    parser.add_argument("--output", type=Path, default=OUTPUT, metavar="FOLDER", help=text)
    text = "only this joint, may be repeated; then no record is written"
    parser.add_argument("--joint", action="append", default=[], metavar="NAME", help=text)
    parser.add_argument("--serial", default="", metavar="TEXT", help="serial number on the plate of the arm")
    text = "topic of a reference of the endpoint (geometry_msgs/PointStamped), in the base frame or another frame"
    parser.add_argument("--reference-topic", default="", metavar="TOPIC", help=text)
    text = f"postures that the reference measures (default: {POSTURES}, without a reference 0)"
    parser.add_argument("--postures", type=whole_number_from(0), metavar="N", help=text)
    text = "a robot program does each step within S seconds of its announcement; default: press Enter"
    parser.add_argument("--automatic", type=number_from(0.0, unit="s"), default=0.0, metavar="S", help=text)
    text = "time of a sweep with --automatic (default: 12)"
    parser.add_argument("--sweep-time", type=number_from(0.0, unit="s"), default=12.0, metavar="S", help=text)
    text = "time of every other step (default: 2)"
    parser.add_argument("--rest-time", type=number_from(0.0, unit="s"), default=2.0, metavar="S", help=text)
    parser.add_argument("--force", action="store_true", help="replace the record of the arm; the old one is kept")
    defaults = CommissioningSettings()
    for option in SETTINGS:
        text = f"{option.text} [{option.unit}] (default: {getattr(defaults, option.name) / option.factor:g})"
        flag = f"--{option.name.replace('_', '-')}"
        size = number_above(0.0, unit=option.unit)
        parser.add_argument(flag, dest=option.name, type=size, metavar=option.unit.upper(), help=text)
    return parser.parse_args(list(arguments))


def read_settings(options: Namespace) -> CommissioningSettings:
    """Return the settings of a parsed command line. Raises ParameterError: a number is invalid."""
    given = {each: getattr(options, each.name) for each in SETTINGS if getattr(options, each.name) is not None}
    default = POSTURES if options.reference_topic else 0
    postures = default if options.postures is None else options.postures
    if postures and not options.reference_topic:
        raise ParameterError(f"--postures {postures}", where="commission", expected="--reference-topic too")
    values = {option.name: value * option.factor for option, value in given.items()}
    return replace(CommissioningSettings(), **values, postures=postures, serial=options.serial)


def topics_of(arm: ArmFile, reference: str) -> CommissioningTopics:
    """Return the topics of an arm; ``reference``: relative to the namespace of the arm; empty: none."""
    prefix = arm.namespace
    raw = {joint: f"{prefix}/{joint}/{RAW_TOPIC}" for joint in arm.calibrations}
    absolute = reference if not reference or reference.startswith("/") else f"{prefix}/{reference}"
    return CommissioningTopics(raw, ArmTopics(arm).encoders, f"{prefix}/{COMMISSIONING_TOPIC}", absolute)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if no check failed."""
    argv = list(sys.argv if arguments is None else arguments)
    options = parse_options(non_ros_arguments(argv))
    settings = read_settings(options)
    arm = load_checked_arm(options.arm, options.namespace)
    calibrations = checked_joints(arm, options.joint)
    record_path = arm.commissioning or arm.path.resolve().parent / RECORD
    before = load_record(record_path) if record_path.exists() else None
    prepare_outputs(options.output, (PAGE, NUMBERS, *(() if options.bag else (BAG,))))
    bag = options.bag or _record_arm(argv, options, arm, settings)
    date = dt.datetime.now(tz=dt.UTC).isoformat(timespec="seconds")
    data = load_commissioning(bag, topics_of(arm, options.reference_topic))
    report = check_commissioning(arm, arm.chain(), calibrations, data, settings, date=date, before=before)
    write_files({options.output / PAGE: report.to_page(), options.output / NUMBERS: report.to_json()})
    _print_report(report, options.output)
    if report.failed:
        return NOT_PASSED
    _keep_record(report, record_path, before, arm, force=options.force)
    return 0


def _record_arm(argv: Sequence[str], options: Namespace, arm: ArmFile, settings: CommissioningSettings) -> Path:
    """Guide through the steps of a running arm; return the recording."""
    bag: Path = options.output / BAG
    topics = topics_of(arm, options.reference_topic)
    required = {*topics.raw.values(), topics.steps, *filter(None, (topics.reference,))}
    names: Collection[str] = required | {topic for topic, _ in topics.encoders.values()}
    provenance = provenance_of(Settings.of_arm(arm))
    times = StepTimes(options.rest_time, options.sweep_time, options.automatic)
    with ros_context(argv) as stop, recording(bag, names, topics.raw.values(), provenance) as recorder:
        guide = Guide(recorder, topics.steps, stop, times)
        guide.wait_for_topics(required)
        guide.run(steps_of(checked_joints(arm, options.joint), settings))
    return bag


def _print_report(report: CommissioningReport, output: Path) -> None:
    for check in report.checks:
        if check.verdict != "passed":
            print(f"{'FAILED' if check.verdict == 'failed' else 'open  '}  {check.check}: {check.found}")
    print(report.sentence)
    print(f"page {output / PAGE}, numbers {output / NUMBERS}")


def _keep_record(
    report: CommissioningReport, path: Path, before: CommissioningRecord | None, arm: ArmFile, *, force: bool
) -> None:
    """Write the record of an arm that passed, unless there is one that must not be replaced."""
    record = report.record()
    if record is None:
        return
    if before is not None and not force:
        print(f"the record of {before.date} stays, identity {before.identity}; --force replaces it")
        return
    text = json.dumps(record.model_dump(mode="json"), indent=1) + "\n"
    kept = save_calibration(path, text, force=force)
    print(f"record {path}, identity {record.identity}" + (f"; the old one is {kept}" if kept else ""))
    if arm.commissioning is None:
        print(f"chain_node compares the arm with it once {arm.path} has the key: commissioning: {path.name}")
