# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""import: a table of another program becomes a bag, by a map of its columns; or a map is proposed."""

from __future__ import annotations

import heapq
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor.arm_names import describe_argument
from posor.bags.bag_writer import file_name_of, replace_bag
from posor.bags.provenance import provenance_of
from posor.chain.arm_file import load_arm_file
from posor.chain.identity import file_sha256
from posor.errors import BagError, ParameterError
from posor.messages.message_definitions import MessageTypes
from posor.output_files import writing
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor.ros_names import RAW_TOPIC
from posor.tables.map_proposal import propose_map
from posor.tables.table_readings import load_readings
from posor_ros.qos import RELIABLE_QOS, SENSOR_QOS

from posor_drivers.sources.table_source import TableMessages

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Sequence

    from posor.tables.table_readings import TableReadings

    from posor_drivers.sources.source import SourceMessage


def _parse_options(arguments: Sequence[str] | None) -> Namespace:
    parser = CommandLineParser(
        prog="posor import", description="Make a bag of a table: CSV, Parquet, TDMS or MATLAB, by a map of its columns."
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="the table")
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="map of the columns")
    parser.add_argument("--output", type=Path, metavar="BAG", help="folder of the new bag; without it, only a check")
    parser.add_argument("--force", action="store_true", help="replace an existing bag")
    text = "print a map to be completed, from the header of the file and the calibrations"
    parser.add_argument("--propose", action="store_true", help=text)
    text = f"of --propose: arm that names the calibrations: {describe_argument()}"
    parser.add_argument("--arm", metavar="ARM", help=text)
    text = "of --propose: calibration file of a joint; may be repeated"
    parser.add_argument("--calibration", action="append", default=[], metavar="JOINT=FILE", help=text)
    return parser.parse_args(arguments)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if the whole table was read, or left out as the map says."""
    options = _parse_options(arguments)
    if options.propose:
        if options.map is not None or options.output is not None:
            raise ParameterError(
                "--propose with --map or --output", where="import", expected="a map on standard output"
            )
        name, calibrations = _calibrations(options)
        proposal = propose_map(options.file, name, calibrations)
        sys.stdout.write(proposal.text)
        sys.stderr.writelines(f"unsure: {guess}\n" for guess in proposal.unsure)
        return 0
    if options.map is None:
        raise ParameterError("--map is missing", where="import", expected="--map MAP.yaml, or --propose to make one")
    if options.arm is not None or options.calibration:
        raise ParameterError("--arm or --calibration with --map", where="import", expected="calibration: in the map")
    if options.output is not None:
        _check_output(options.output, force=options.force)
    readings = load_readings(options.file, options.map)
    _print_summary(readings)
    if options.output is not None:
        data = provenance_of(None) | {
            "posor.table": f"{options.file.name} sha256 {file_sha256(options.file)}",
            "posor.table_map": f"{options.map.name} sha256 {file_sha256(options.map)}",
            "posor.table_left_out": json.dumps({"rows": readings.left_out, "columns": readings.unused}),
        }
        count = write_bag(readings, options.output, data)
        print(f"wrote {options.output}: {count} messages")
    return 0


def _check_output(bag: Path, *, force: bool) -> None:
    """Raise BagError if the output exists, unless it is a bag of this program that is to be replaced."""
    if not bag.exists():
        return
    if not force:
        raise BagError("exists already", where=str(bag), expected="a new folder, or --force")
    own = {"metadata.yaml", file_name_of(bag)}
    if not bag.is_dir() or {path.name for path in bag.iterdir()} != own:
        raise BagError("is not a bag of this program alone", where=str(bag), expected="a new folder")


def write_bag(readings: TableReadings, bag: Path, custom_data: dict[str, str] | None = None) -> int:
    """Write the readings of all joints of a table to a bag, replacing an existing one; return the number of messages.

    Raises:
        OutputError: The storage fails.

    """
    types, streams = MessageTypes(), []
    with writing(bag), replace_bag(bag, custom_data) as writer:
        for joint, of_joint in readings.joints.items():
            messages = TableMessages(readings, joint, types)
            names = {topic.name: of_joint.topic if topic.name == RAW_TOPIC else topic.name for topic in messages.topics}
            for topic in messages.topics:
                qos = SENSOR_QOS if topic.name == RAW_TOPIC else RELIABLE_QOS
                writer.add_topic(names[topic.name], topic.type_name, types.definition(topic.type_name), [qos])
            streams.append(_renamed(messages.read(), names))
        for message in heapq.merge(*streams, key=lambda each: each.time_ns):
            writer.write(message.topic, message.time_ns, message.data)
        return sum(writer.counts.values())


def _renamed(messages: Iterator[SourceMessage], names: dict[str, str]) -> Iterator[SourceMessage]:
    for message in messages:
        yield message._replace(topic=names[message.topic])


def _print_summary(readings: TableReadings) -> None:
    for name, joint in readings.joints.items():
        print(f"{joint.topic}: {joint.scans!r}".replace("Scans", "scans", 1) + f" of joint {name}")
        for flag, count in joint.flagged.items():
            print(f"{joint.topic}: {flag} in {count} of {len(joint.scans)} scans")
    for reference in readings.references.values():
        print(f"{reference.topic}: {len(reference.values)} readings")
    if readings.unused:
        print(f"columns left out: {', '.join(readings.unused)}")
    for kind, count in readings.left_out.items():
        print(f"rows left out: {count} ({kind})")
    for note in readings.notes:
        print(f"note: {note}")


def _calibrations(options: Namespace) -> tuple[str, dict[str, Path]]:
    """Return the name of the arm, and the calibration file of each joint."""
    name, calibrations = "rig", dict[str, Path]()
    if options.arm is not None:
        arm = load_arm_file(options.arm)
        name, calibrations = arm.name, dict(arm.calibrations)
    for text in options.calibration:
        joint, equals, path = text.partition("=")
        if not (joint and equals and path):
            raise ParameterError(f"'{text}'", where="import --calibration", expected="JOINT=FILE")
        calibrations[joint] = Path(path)
    if not calibrations:
        raise ParameterError("no calibration is named", where="import --propose", expected="--arm or --calibration")
    return name, calibrations
