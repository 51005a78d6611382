"""recover: writes the whole chunks of a damaged MCAP bag, or of one whose recording was killed, to a new bag."""

from __future__ import annotations

import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from struct import error as StructError
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, McapRecord, Schema, Statistics
from rosbags.rosbag2 import Reader

from posor.bags.bag_reader import storage_files
from posor.bags.bag_writer import BagWriter
from posor.bags.mcap_file import MAGIC, Damage, Record, mapped, read_index, read_records
from posor.bags.provenance import custom_data
from posor.errors import BagError
from posor.messages.byte_kernels import MESSAGE_HEAD
from posor.messages.message_definitions import Definition, stored_type_hash
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from rosbags.interfaces import Connection

MESSAGE = Struct("<HIQ")  # head of a message: channel, sequence number, log time; the time of publication follows


@dataclass
class Rescue:
    """What was found in one file."""

    path: Path  # the file
    messages: int = 0  # number of messages that were rescued
    chunks: int = 0  # number of whole chunks, and of whole messages outside of chunks
    unknown: int = 0  # number of messages whose topic is not known, because its definition is damaged
    stated: int | None = None  # number of messages of the undamaged file; None: its index is lost
    damages: list[Damage] = field(default_factory=list)  # the damaged places

    def lines(self) -> list[str]:
        """Return what was rescued and what is lost, in sentences."""
        lines = [f"{self.path}: {self.messages} messages in {self.chunks} chunks rescued"]
        lines += [f"{self.path}, byte {each.offset}: {each.what}; {each.size} bytes lost" for each in self.damages]
        if self.unknown:
            lines.append(f"{self.path}: {self.unknown} messages lost, the definitions of their topics are damaged")
        if self.stated is None:
            lines.append(f"{self.path}: its index is lost, so the number of lost messages is not known")
        else:
            lines.append(f"{self.path}: {self.stated - self.messages} of {self.stated} messages lost")
        return lines


class _Topics:
    """Topics of a damaged file by channel; they are added to the new bag as their definitions are found."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._definitions: dict[tuple[type, int], Schema | Channel] = {}
        self.channels: dict[int, int] = {}

    def add(self, records: Iterable[McapRecord]) -> None:
        """Add the definitions among some records; invalid ones, in a file without checksums, are left out."""
        found = {(type(each), each.id): each for each in records if isinstance(each, (Schema, Channel))}
        if new := {key: each for key, each in found.items() if key not in self._definitions}:
            with suppress(Exception):  # rosbags raises whatever the bytes lead to
                for source in _parse_topics([*self._definitions.values(), *new.values()]):
                    ext: Any = source.ext
                    definition = Definition(source.msgdef.data, stored_type_hash(source))
                    self.channels[source.id] = self._writer.add_topic(
                        source.topic, source.msgtype, definition, ext.offered_qos_profiles, ext.serialization_format
                    )
                self._definitions |= new


def _parse_topics(definitions: Iterable[Schema | Channel]) -> list[Connection]:
    """Have rosbags read schemas and channels as those of a file without messages."""
    with NamedTemporaryFile(suffix=".mcap") as file:
        builder = RecordBuilder()
        footer = Footer(summary_start=0, summary_offset_start=0, summary_crc=0)
        ordered = sorted(definitions, key=lambda each: (isinstance(each, Channel), each.id))
        for record in (Header("ros2", ""), *ordered, DataEnd(0), footer):
            record.write(builder)
        file.write(MAGIC + builder.end() + MAGIC)
        file.flush()
        with Reader(file.name) as reader:
            return list(reader.connections)


def recover(bag: Path, output: Path) -> list[Rescue]:
    """Write the whole chunks of a bag's MCAP files to a new bag.

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
    if output.exists():
        raise BagError("exists already", where=str(output), expected="a new folder")
    try:
        rescues = _write(bag, files, output)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
    if not any(rescue.messages for rescue in rescues):
        shutil.rmtree(output)
        first = "; ".join(
            f"{each.damages[0].what} at byte {each.damages[0].offset}" for each in rescues if each.damages
        )
        raise BagError(f"holds no whole chunk with messages{first and ', '}{first}", where=str(bag))
    return rescues


def _write(bag: Path, files: Sequence[Path], output: Path) -> list[Rescue]:
    rescues = []
    with BagWriter(output, custom_data(bag if bag.is_dir() else bag.parent)) as writer:
        for file in files:
            if file.is_file() and not file.stat().st_size:
                rescues.append(Rescue(file, damages=[Damage(0, 0, "the file is empty")]))
            else:
                rescues.append(_rescue(file, writer))
    return rescues


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
            rescue.chunks += 1
            topics.add(_definitions(piece))
            for opcode, content in piece:
                if opcode != Opcode.MESSAGE or len(content) < MESSAGE_HEAD:
                    continue
                number, _, time_ns = MESSAGE.unpack_from(content)
                channel = topics.channels.get(number)
                if channel is None:
                    rescue.unknown += 1
                else:
                    writer.write_message(channel, time_ns, content[MESSAGE_HEAD:])
                    rescue.messages += 1
    return rescue


def _definitions(records: Iterable[Record]) -> Iterator[McapRecord]:
    """Yield the schemas and channels among some records; invalid ones are left out."""
    for opcode, content in records:
        if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            kind = Schema if opcode == Opcode.SCHEMA else Channel
            with suppress(McapError, ValueError, OverflowError, StructError):
                yield kind.read(ReadDataStream(BytesIO(content)))


def parser() -> CommandLineParser:
    """Return the parser of the command line."""
    command = CommandLineParser(
        prog="posor recover",
        description="Write the whole chunks of a damaged MCAP bag to a new bag, and say what is lost.",
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


if __name__ == "__main__":
    sys.exit(main())
