# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags: MCAP with checksums, metadata of version 9, type definitions and hashes, quality of service.

A file consists of the records of ``mcap.records``. The writer of that library takes messages one by one, too slowly for
``reprocess``: here a table of messages becomes a chunk at once. The checksum of the data section is not stated: the
chunks hold all messages, and a reader would have to read the file twice.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter, defaultdict
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple, Self
from zlib import crc32

import numpy as np
import yaml
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from posor.bags.mcap_file import INDEX_HEAD, MAGIC, RECORD_HEAD
from posor.bags.provenance import PENDING
from posor.bags.recorded_topics import CDR
from posor.errors import BagError
from posor.messages.byte_kernels import write_records
from posor.numerics.stamps import NS
from posor.output_files import write_files, writing

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from mcap.records import McapRecord

    from posor.messages.message_definitions import Definition
    from posor.numerics.array_types import ByteArray, IntArray

CHUNK_BYTES = 1 << 20  # size of a chunk of messages that are written one by one
INFINITE_NS = 2**63 - 1
POLICIES = ("history", "reliability", "durability", "liveliness")
DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
CHUNK_HEAD = Struct("<BQQQQIIQ")  # head of the record, first and last log time, size, checksum, no compression, size
MESSAGE_HEAD = Struct("<BQHIQQ")  # head of the record, channel, sequence number, log and publish time


class TopicMessages(NamedTuple):
    """Messages of one topic with the same length."""

    channel: int  # of the topic, see ``BagWriter.add_topic``
    times_ns: IntArray  # log times, which do not go back, shape (n,)
    messages: ByteArray  # shape (n, s)


@dataclass
class _Topic:
    """A topic, and what metadata.yaml says of it."""

    channel: Channel
    metadata: dict[str, Any]
    count: int = 0


def file_name_of(bag: Path) -> str:
    """Return the name of the only file of a bag, as rosbag2 names the first one: ``ros2 bag reindex`` wants it."""
    return f"{bag.name}_0.mcap"


class BagWriter:
    """A bag that is being written; as a context manager it closes the bag, also after an error.

    Equal calls give equal bytes. Every method raises an OutputError if the storage fails.

    Attributes:
        path: The folder.

    """

    def __init__(self, path: Path, custom_data: Mapping[str, str] | None = None, where: Path | None = None) -> None:
        """Create the bag's folder.

        ``custom_data``: of the bag's metadata; until the bag is closed it is in a file of its own; ``where``: names the
        bag in errors; None: its folder. Raises BagError: the folder exists already.
        """
        if path.exists():
            raise BagError("exists already", where=str(path), expected="a new folder")
        self.path = path
        self._where = where or path
        self._custom_data = dict(custom_data or {})
        self._schemas: list[Schema] = []
        self._topics: list[_Topic] = []
        self._channels: dict[str, int] = {}
        self._indices: list[ChunkIndex] = []
        self._records = RecordBuilder()  # that wait to become a chunk
        self._outside = Counter[int]()  # records outside of chunks, by type
        self._entries = defaultdict[int, list[tuple[int, int]]](list)  # log time and offset of each message, by channel
        self._buffer: ByteArray = np.empty(0, dtype=np.uint8)
        with writing(self._where):
            path.mkdir(parents=True)
            if custom_data:
                (path / PENDING).write_text(json.dumps(self._custom_data, indent=1) + "\n", encoding="utf-8")
            self._file = (path / file_name_of(path)).open("xb")
            self._file.write(MAGIC + _bytes_of(Header("ros2", "posor")))

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by topic."""
        counts = dict.fromkeys(self._channels, 0)
        for topic in self._topics:
            counts[topic.channel.topic] += topic.count
        return counts

    def add_topic(self, name: str, type_name: str, definition: Definition, qos: Sequence[Any] = ()) -> int:
        """Add a topic, unless it is there already, and return the number of its channel.

        ``name``: of the topic; with another type or other profiles it has another channel; ``type_name``: message type;
        ``definition``: of the type; ``qos``: profiles that the publishers offer: ``QoSProfile`` of rclpy or ``Qos`` of
        rosbags.
        """
        form = "ros2idl" if definition.text.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
        schema = Schema(id=0, name=type_name, encoding=form, data=definition.text.encode())
        return self.add_channel(name, schema, CDR, qos, definition.type_hash)

    def add_channel(
        self,
        name: str,
        schema: Schema | None,
        encoding: str,
        qos: Sequence[Any] = (),
        type_hash: str = "",
        details: Mapping[str, str] | None = None,
    ) -> int:
        """Add a channel, unless it is there already, and return its number; see ``add_topic``.

        ``schema``: of its messages, in any language; its number does not count; ``encoding``: of the messages;
        ``details``: of the channel.
        """
        profiles = [_qos_entry(profile) for profile in qos]
        metadata = {
            "name": name,
            "type": schema.name if schema else "",
            "serialization_format": encoding,
            "offered_qos_profiles": profiles,
            "type_description_hash": type_hash,
        }
        channel = Channel(
            id=len(self._topics) + 1,
            topic=name,
            message_encoding=encoding,
            metadata={**(details or {}), "offered_qos_profiles": yaml.safe_dump(profiles).strip()},
            schema_id=self._add_schema(schema) if schema else 0,
        )
        for topic in self._topics:
            if topic.metadata == metadata and topic.channel == replace(channel, id=topic.channel.id):
                return topic.channel.id
        channel.write(self._records)
        self._channels[name] = channel.id
        self._topics.append(_Topic(channel, metadata))
        return channel.id

    def _add_schema(self, schema: Schema) -> int:
        """Add a schema, unless it is there already, and return its number."""
        for each in self._schemas:
            if each == replace(schema, id=each.id):
                return each.id
        self._schemas.append(replace(schema, id=len(self._schemas) + 1))
        self._schemas[-1].write(self._records)
        return self._schemas[-1].id

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Write one serialised message with its log time [ns]."""
        self.write_message(self._channels[topic], time_ns, data)

    def write_message(self, channel: int, time_ns: int, data: bytes) -> None:
        """Write one serialised message of a channel with its log time [ns]."""
        self._entries[channel].append((time_ns, self._records.count))
        message = Message(channel_id=channel, log_time=time_ns, publish_time=time_ns, sequence=0, data=data)
        message.write(self._records)
        self._topics[channel - 1].count += 1
        if self._records.count > CHUNK_BYTES:
            self._close_chunk()

    def write_messages(self, parts: Sequence[TopicMessages]) -> None:
        """Write messages as one chunk; every channel has one part at most."""
        parts = [part for part in parts if len(part.times_ns)]
        if not parts:
            return
        if self._entries:
            self._close_chunk()
        begin = np.frombuffer(self._records.end(), dtype=np.uint8)  # schemas and channels
        head_size = MESSAGE_HEAD.size
        size = len(begin) + sum(len(part.times_ns) * (head_size + part.messages.shape[1]) for part in parts)
        if len(self._buffer) < size:
            self._buffer = np.empty(size, dtype=np.uint8)  # reused: allocating would double the time
        records, offset, entries = self._buffer[:size], len(begin), {}
        records[:offset] = begin
        for part in parts:
            count, length = len(part.times_ns), head_size + part.messages.shape[1]
            rows = records[offset : offset + count * length].reshape(count, length)
            head = MESSAGE_HEAD.pack(Opcode.MESSAGE, length - RECORD_HEAD.size, part.channel, 0, 0, 0)
            entries[part.channel] = index = np.empty((count, 2), dtype=np.int64)
            write_records(np.frombuffer(head, np.uint8), part.times_ns, part.messages, offset, rows, index)
            offset += rows.nbytes
            self._topics[part.channel - 1].count += count
        self._write_chunk(records, entries)

    def write_record(self, opcode: int, content: bytes) -> None:
        """Write a record that is outside of chunks: an attachment or metadata."""
        if self._records.count:
            self._close_chunk()
        with writing(self._where):
            self._file.write(RECORD_HEAD.pack(opcode, len(content)) + content)
        self._outside[opcode] += 1

    def flush(self) -> None:
        """Hand all messages to the operating system; they survive the end of this process, not a loss of power."""
        if self._entries:
            self._close_chunk()
        with writing(self._where):
            self._file.flush()

    def close(self) -> None:
        """Write index and metadata."""
        if self._records.count:
            self._close_chunk()
        with writing(self._where):
            information = self._information()
            self._write_index(information)
            self._file.close()
            text = yaml.safe_dump({"rosbag2_bagfile_information": information}, allow_unicode=True)
            write_files({self.path / "metadata.yaml": text})
            (self.path / PENDING).unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _close_chunk(self) -> None:
        """Write the messages since the last chunk as a chunk."""
        entries = {channel: np.array(index, dtype=np.int64) for channel, index in self._entries.items()}
        self._entries.clear()
        self._write_chunk(np.frombuffer(self._records.end(), dtype=np.uint8), entries)

    def _write_chunk(self, records: ByteArray, entries: Mapping[int, IntArray]) -> None:
        """Write records as a chunk; ``entries``: log time and offset of each message, shape (n, 2), by channel."""
        times = [(int(index[:, 0].min()), int(index[:, 0].max())) for index in entries.values()] or [(0, 0)]
        first, last = min(first for first, _ in times), max(last for _, last in times)
        size = len(records)
        length = CHUNK_HEAD.size - RECORD_HEAD.size + size
        head = CHUNK_HEAD.pack(Opcode.CHUNK, length, first, last, size, crc32(records.data), 0, size)
        with writing(self._where):
            begin = self._file.tell()
            self._file.write(head)
            self._file.write(records.data)
            end, offsets = self._file.tell(), {}
            for channel, index in entries.items():
                offsets[channel] = self._file.tell()
                length = INDEX_HEAD.size - RECORD_HEAD.size + index.nbytes
                self._file.write(INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length, channel, index.nbytes))
                self._file.write(index.data)
            chunk = ChunkIndex(
                chunk_start_offset=begin,
                chunk_length=end - begin,
                message_start_time=first,
                message_end_time=last,
                message_index_offsets=offsets,
                message_index_length=self._file.tell() - end,
                compression="",
                compressed_size=size,
                uncompressed_size=size,
            )
            self._indices.append(chunk)

    def _information(self) -> dict[str, Any]:
        """Return the content of metadata.yaml."""
        file, (first, last) = file_name_of(self.path), self._time_span()

        def extent() -> dict[str, Any]:  # a new one each time: YAML would refer to the first one
            return {
                "starting_time": {"nanoseconds_since_epoch": first},
                "duration": {"nanoseconds": max(0, last - first)},
                "message_count": sum(topic.count for topic in self._topics),
            }

        topics = [{"topic_metadata": topic.metadata, "message_count": topic.count} for topic in self._topics]
        return extent() | {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [file],
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [extent() | {"path": file}],
            "custom_data": self._custom_data or None,
            "ros_distro": "jazzy",
        }

    def _time_span(self) -> tuple[int, int]:
        """Return the earliest and the latest log time; as rosbag2 states them for a bag without messages."""
        chunks = [chunk for chunk in self._indices if chunk.message_index_offsets]
        first = min((chunk.message_start_time for chunk in chunks), default=INFINITE_NS)
        return first, max((chunk.message_end_time for chunk in chunks), default=0)

    def _write_index(self, information: Mapping[str, Any]) -> None:
        """Write what follows the chunks: metadata, index and footer."""
        text = {"serialized_metadata": yaml.safe_dump(information).strip()}
        metadata = _bytes_of(Metadata(name="rosbag2", metadata=text))
        metadata_at = self._file.tell()
        self._file.write(metadata + _bytes_of(DataEnd(0)))
        first, last = self._time_span()
        counts = {topic.channel.id: topic.count for topic in self._topics}
        statistics = Statistics(
            message_count=sum(counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._topics),
            attachment_count=self._outside[Opcode.ATTACHMENT],
            metadata_count=1 + self._outside[Opcode.METADATA],
            chunk_count=len(self._indices),
            message_start_time=first,
            message_end_time=last,
            channel_message_counts=counts,
        )
        place = MetadataIndex(name="rosbag2", offset=metadata_at, length=len(metadata))
        channels = [topic.channel for topic in self._topics]
        footer = Footer(summary_start=self._file.tell(), summary_offset_start=0, summary_crc=0)
        index = b"".join(map(_bytes_of, [*self._schemas, *channels, *self._indices, place, statistics]))
        footer.summary_crc = crc32(index + _bytes_of(footer)[:-4])
        self._file.write(index + _bytes_of(footer) + MAGIC)


@contextmanager
def replace_bag(bag: Path, custom_data: Mapping[str, str] | None = None) -> Iterator[BagWriter]:
    """Write a bag that replaces an existing bag only once it is complete. Raises OutputError: the storage fails."""
    bag.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=bag.parent, prefix=".making-") as folder:
        new = Path(folder) / bag.name
        with BagWriter(new, custom_data) as writer:
            yield writer
        if bag.exists():
            shutil.rmtree(bag)
        new.rename(bag)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _qos_entry(profile: Any) -> dict[str, Any]:
    """Return an offered profile as metadata of version 9 state it; an unspecified duration (zero) is infinite."""
    entry: dict[str, Any] = {name: getattr(profile, name).name.lower() for name in POLICIES}
    for name in DURATIONS:
        duration = getattr(profile, name)
        if hasattr(duration, "nanoseconds"):
            sec, nsec = divmod(duration.nanoseconds or INFINITE_NS, NS)
        else:
            sec, nsec = duration
        entry[name] = {"sec": sec, "nsec": nsec}
    avoid = profile.avoid_ros_namespace_conventions
    return entry | {"depth": profile.depth, "avoid_ros_namespace_conventions": avoid}
