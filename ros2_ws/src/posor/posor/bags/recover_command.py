"""recover: writes the whole chunks of a damaged MCAP bag, or of one whose recording was killed, to a new bag."""

from __future__ import annotations

import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any

from rosbags.rosbag2.storage_mcap import McapReader

from posor.bags.bag_reader import storage_files
from posor.bags.mcap_file import (
    RECORD_HEAD,
    Damage,
    Opcode,
    Record,
    mapped,
    read_index,
    read_records,
)
from posor.bags.mcap_writer import McapBagWriter
from posor.bags.provenance import custom_data
from posor.errors import BagError
from posor.messages.message_definitions import stored_type_hash
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rosbags.interfaces import Connection

MESSAGE = Struct("<HIQ")
"""Head of a message: channel, sequence number, log time; the time of publication follows."""
MESSAGE_HEAD = 22
COUNT = Struct("<Q")
"""First field of the statistics: number of messages."""


@dataclass
class Rescue:
    """What was found in one file.

    Attributes:
        path: The file.
        messages: Number of messages that were rescued.
        chunks: Number of whole chunks, and of whole messages outside of chunks.
        unknown: Number of messages whose topic is not known, because its definition is damaged.
        stated: Number of messages of the undamaged file; None: its index is lost.
        damages: The damaged places.

    """

    path: Path
    messages: int = 0
    chunks: int = 0
    unknown: int = 0
    stated: int | None = None
    damages: list[Damage] = field(default_factory=list)

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
    """Topics by channel, from the records of schemas and channels that have been found so far."""

    def __init__(self) -> None:
        self._records: dict[tuple[int, bytes], bytes] = {}
        self.by_channel: Mapping[int, Connection] = {}

    def add(self, records: Sequence[Record]) -> None:
        """Add the definitions among some records; invalid ones, in a file without checksums, are left out."""
        new = {
            (opcode, content[:2]): RECORD_HEAD.pack(opcode, len(content)) + content
            for opcode, content in records
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and (opcode, content[:2]) not in self._records
        }
        if new:
            with suppress(Exception):  # rosbags raises whatever the bytes lead to
                self.by_channel = _parse_topics(self._records | new)
                self._records |= new


def _parse_topics(records: Mapping[tuple[int, bytes], bytes]) -> dict[int, Connection]:
    """Have rosbags parse schemas and channels as those of an index."""
    reader = McapReader(Path())
    reader.bio = BytesIO(b"".join(record for _, record in sorted(records.items())) + bytes([Opcode.FOOTER]))
    reader.read_index()
    return {connection.id: connection for connection in reader.connections}


class _Output:
    """The new bag; topics are added as they are found."""

    def __init__(self, path: Path) -> None:
        self.writer = McapBagWriter(path)
        self._connections: dict[tuple[str, str, str], Connection] = {}

    def write(self, source: Connection, time_ns: int, data: bytes) -> None:
        self.writer.write(self.add_topic(source), time_ns, data)

    def add_topic(self, source: Connection) -> Connection:
        """Return the topic of the new bag for one of a damaged file."""
        ext: Any = source.ext
        key = source.topic, source.msgtype, repr(ext)
        if key not in self._connections:
            self._connections[key] = self.writer.add_connection(
                source.topic,
                source.msgtype,
                msgdef=source.msgdef.data,
                rihs01=stored_type_hash(source),
                serialization_format=ext.serialization_format,
                offered_qos_profiles=ext.offered_qos_profiles,
            )
        return self._connections[key]


def recover(bag: Path, output: Path) -> list[Rescue]:
    """Write the whole chunks of a bag's MCAP files to a new bag.

    Log time and bytes of each message are kept; its sequence number is not, and its time of publication becomes its
    log time, as in every bag of the recorder.

    Args:
        bag: Folder, with or without metadata.yaml, or a single .mcap file.
        output: Folder of the new bag; must not exist.

    Returns:
        What was found, by file.

    Raises:
        BagError: The bag has no MCAP file, no message can be rescued, or the output exists or cannot be written.

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
    except BaseException as error:
        shutil.rmtree(output, ignore_errors=True)
        if isinstance(error, OSError):
            raise BagError(f"the bag cannot be written, {error.strerror}", where=str(output)) from error
        raise
    if not any(rescue.messages for rescue in rescues):
        shutil.rmtree(output)
        first = "; ".join(
            f"{each.damages[0].what} at byte {each.damages[0].offset}" for each in rescues if each.damages
        )
        raise BagError(f"holds no whole chunk with messages{first and ', '}{first}", where=str(bag))
    return rescues


def _write(bag: Path, files: Sequence[Path], output: Path) -> list[Rescue]:
    target, rescues = _Output(output), []
    with target.writer:
        for key, value in custom_data(bag if bag.is_dir() else bag.parent).items():
            target.writer.set_custom_data(key, value)
        for file in files:
            if file.is_file() and not file.stat().st_size:
                rescues.append(Rescue(file, damages=[Damage(0, 0, "the file is empty")]))
            else:
                rescues.append(_rescue(file, target))
    return rescues


def _rescue(file: Path, target: _Output) -> Rescue:
    """Write what is whole in a file to the new bag."""
    rescue, topics = Rescue(file), _Topics()
    with mapped(file) as data:
        index = read_index(data)
        if not isinstance(index, Damage):
            topics.add(index)
            counts = [COUNT.unpack_from(each.content)[0] for each in index if each.opcode == Opcode.STATISTICS]
            rescue.stated = counts[0] if counts else None
        for piece in read_records(data):
            if isinstance(piece, Damage):
                rescue.damages.append(piece)
                continue
            rescue.chunks += 1
            topics.add(piece)
            for opcode, content in piece:
                if opcode != Opcode.MESSAGE or len(content) < MESSAGE_HEAD:
                    continue
                channel, _, time_ns = MESSAGE.unpack_from(content)
                if channel in topics.by_channel:
                    target.write(topics.by_channel[channel], time_ns, content[MESSAGE_HEAD:])
                    rescue.messages += 1
                else:
                    rescue.unknown += 1
    for connection in topics.by_channel.values():
        target.add_topic(connection)
    return rescue


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
