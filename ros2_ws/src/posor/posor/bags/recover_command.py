# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""recover: writes what is whole of a damaged MCAP bag, or of one whose recording was killed, to a new bag."""

from __future__ import annotations

import shutil
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import Statistics

from posor.bags.bag_reader import storage_files
from posor.bags.bag_writer import BagWriter
from posor.bags.mcap_file import UNKNOWN, Damage, definitions_of, mapped, read_index
from posor.bags.mcap_search import read_records
from posor.bags.mcap_storage import definitions_by_number, topic_of
from posor.bags.ordered_reader import stored_name
from posor.bags.provenance import custom_data
from posor.bags.recorded_topics import METADATA, BagMetadata, Unread, connection_of, profiles_of
from posor.bags.stored_file import LAST_TIME_NS
from posor.errors import BagError
from posor.messages.byte_kernels import MESSAGE_HEAD
from posor.messages.message_definitions import stored_type_hash
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mcap.records import McapRecord, Schema

MESSAGE = Struct("<HIQ")  # head of a message: channel, sequence number, log time; the time of publication follows


@dataclass
class Rescue:
    """What was found in one file."""

    path: Path  # the file
    messages: int = 0  # number of messages that were rescued
    stated: int | None = None  # number of messages of the undamaged file; None: its index is lost
    damages: list[Damage] = field(default_factory=list)  # the damaged places
    lost: Counter[str] = field(default_factory=Counter)  # whole messages that are left out, by the reason, a clause
    skipped: Counter[int] = field(default_factory=Counter)  # records that are left out, by their type
    is_missing: bool = False  # whether metadata.yaml lists the file, and there is none

    def lines(self) -> list[str]:
        """Return what was rescued and what is lost, in sentences."""
        if self.is_missing:
            return [f"{self.path}: lost; {METADATA} lists it, but there is no such MCAP file"]
        lines = [f"{self.path}: {self.messages} messages rescued"]
        lines += [f"{self.path}, byte {each.offset}: {each.what}; {each.size} bytes lost" for each in self.damages]
        lines += [
            f"{self.path}: {count} records of type 0x{opcode:02x}, which the format does not define, left out"
            for opcode, count in sorted(self.skipped.items())
        ]
        lines += [f"{self.path}: {count} messages lost, {reason}" for reason, count in self.lost.items()]
        if self.stated is None:
            lines.append(f"{self.path}: its index states no number of messages, so that of lost ones is not known")
        else:
            lines.append(f"{self.path}: {max(0, self.stated - self.messages)} of {self.stated} messages lost")
        return lines


class _Topics:
    """Topics of a damaged file by channel; they are added to the new bag as their definitions are found."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._schemas: dict[int, Schema] = {}
        self.channels: dict[int, int] = {}

    def add(self, records: Iterable[McapRecord]) -> None:
        """Add the definitions among some records; a channel whose schema is not known is left out."""
        schemas, channels = definitions_by_number(records)
        self._schemas |= schemas
        for number, channel in channels.items():
            schema = self._schemas.get(channel.schema_id)
            if number in self.channels or (schema is None and channel.schema_id):
                continue
            topic = topic_of(channel, self._schemas)
            found = connection_of(topic, 0, BagMetadata())
            type_hash = "" if isinstance(found, Unread) else stored_type_hash(found)
            self.channels[number] = self._writer.add_channel(
                channel.topic, schema, channel.message_encoding, profiles_of(topic.qos), type_hash, channel.metadata
            )


def recover(bag: Path, output: Path) -> list[Rescue]:
    """Write the whole chunks of a bag's MCAP files, and the whole messages outside of chunks, to a new bag.

    Messages of every encoding are copied, and so are attachments and metadata; records of unknown types are not.
    Log time and bytes of each message are kept; its sequence number is not, and its time of publication becomes its log
    time, as in every bag of the recorder. ``bag``: folder, with or without metadata.yaml, or a single .mcap file;
    ``output``: folder of the new bag; must not exist. Return what was found, by file. Raises BagError: the bag has no
    MCAP file, no message can be rescued, or the output exists; OutputError: the output cannot be written.
    """
    if not bag.exists():
        raise BagError("does not exist", where=str(bag), expected="an MCAP file, or a folder of MCAP files")
    files = storage_files(bag, ".mcap")
    if not files:
        raise BagError("holds no MCAP file", where=str(bag), expected="an MCAP file; for SQLite: 'sqlite3 .recover'")
    if compressed := [file for file in files if file.name != stored_name(file)]:
        raise BagError("is compressed", where=str(compressed[0]), expected="its content, as 'unzstd' writes it")
    if output.exists():
        raise BagError("exists already", where=str(output), expected="a new folder")
    try:
        rescues = _write(bag, files, output)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
    if not any(rescue.messages for rescue in rescues):
        shutil.rmtree(output)
        first = [f"{each.damages[0].what} at byte {each.damages[0].offset}" for each in rescues if each.damages]
        lost = [f"{count} messages lost, {reason}" for each in rescues for reason, count in each.lost.items()]
        raise BagError(", ".join(["holds no whole message", *first, *lost]), where=str(bag))
    return rescues


def _write(bag: Path, files: Sequence[Path], output: Path) -> list[Rescue]:
    rescues = []
    with BagWriter(output, custom_data(bag if bag.is_dir() else bag.parent)) as writer:
        for file in files:
            if file.is_file() and not file.stat().st_size:
                rescues.append(Rescue(file, damages=[Damage(0, 0, "the file is empty")]))
            else:
                rescues.append(_rescue(file, writer))
    found = {stored_name(file) for file in files}
    missing = [name for name in _listed_files(bag) if stored_name(Path(name)) not in found]
    return rescues + [Rescue(bag / name, is_missing=True) for name in missing]


def _listed_files(bag: Path) -> Sequence[str]:
    """Return the names of the files that metadata.yaml lists; none if there is none, or it is damaged."""
    with suppress(BagError):
        return BagMetadata.load(bag).files
    return ()


def _rescue(file: Path, writer: BagWriter) -> Rescue:
    rescue, topics = Rescue(file), _Topics(writer)
    with mapped(file) as data:
        index = read_index(data)
        if not isinstance(index, Damage):
            topics.add(index)
            rescue.stated = next((each.message_count for each in index if isinstance(each, Statistics)), None)
        for piece in read_records(data):
            if isinstance(piece, Damage):
                rescue.damages.append(piece)
                continue
            topics.add(definitions_of(piece))
            for opcode, content in piece:
                if opcode == Opcode.MESSAGE and len(content) >= MESSAGE_HEAD:
                    number, _, time_ns = MESSAGE.unpack_from(content)
                    channel = topics.channels.get(number)
                    if channel is None:
                        rescue.lost["the definitions of their topics are damaged"] += 1
                    elif time_ns > LAST_TIME_NS:
                        rescue.lost["their log times are damaged"] += 1
                    else:
                        writer.write_message(channel, time_ns, content[MESSAGE_HEAD:])
                        rescue.messages += 1
                elif opcode == Opcode.ATTACHMENT or (opcode == Opcode.METADATA and not _is_of_rosbag2(content)):
                    writer.write_record(opcode, content)
                elif opcode in UNKNOWN:
                    rescue.skipped[opcode] += 1
    return rescue


def _is_of_rosbag2(metadata: bytes) -> bool:
    """Return whether a record is the copy of metadata.yaml, which every bag has its own of."""
    return metadata.startswith(b"\x07\0\0\0rosbag2")


def parser() -> CommandLineParser:
    """Return the parser of the command line."""
    command = CommandLineParser(
        prog="posor recover",
        description="Write what is whole of a damaged MCAP bag to a new bag, and say what is lost.",
    )
    text = "folder of a bag, with or without metadata.yaml, or its .mcap file; it is not changed"
    command.add_argument("bag", type=Path, metavar="BAG", help=text)
    command.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="the new bag; must not exist yet")
    return command


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if any message was rescued, also if others are lost."""
    options = parser().parse_args(arguments)
    for rescue in recover(options.bag, options.output):
        sys.stdout.writelines(f"{line}.\n" for line in rescue.lines())
    sys.stdout.write(f"written to {options.output}\n")
    return 0
