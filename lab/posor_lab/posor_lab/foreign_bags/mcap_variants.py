# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""MCAP files with every freedom that the specification leaves to a writer (https://mcap.dev/spec)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple
from zlib import crc32

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.writer import CompressionType, IndexType, Writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from random import Random

    from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"
PROFILES = ("ros2", "", "ros1", "px4", "anything")
COMPRESSIONS: Mapping[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.ZstdCompressor(level=1).compress,
}
NOT_EXTENDED = {0x02, 0x05}  # footer and message
INDEX_TYPES = (IndexType.CHUNK, IndexType.MESSAGE, IndexType.ATTACHMENT, IndexType.METADATA)


class GivenTopic(NamedTuple):
    """A topic as its writer describes it."""

    name: str
    type_name: str  # empty: the file states no schema
    encoding: str  # of the messages
    definition_encoding: str
    definition: bytes


class GivenMessage(NamedTuple):
    """A message to write."""

    topic: GivenTopic
    time_ns: int  # log time
    data: bytes


def happens(chance: Random, share: float) -> bool:
    """Return True in this share of the calls."""
    return chance.random() < share


def write_mcap(messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], chance: Random) -> bytes:
    """Return a file with these messages in this order, written by ``mcap`` or record by record, with any options."""
    if happens(chance, 0.5):
        return _write_by_library(messages, topics, chance)
    return _RecordFile(messages, topics, chance).write()


def _write_by_library(messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], chance: Random) -> bytes:
    flip = partial(happens, chance, 0.6)
    file, types = BytesIO(), IndexType.NONE
    for each in INDEX_TYPES:
        types |= each if flip() else IndexType.NONE
    writer = Writer(
        file,
        chunk_size=chance.choice([1, 300, 2000, 1 << 20]),
        compression=chance.choice(list(CompressionType)),
        index_types=types,
        repeat_channels=flip(),
        repeat_schemas=flip(),
        use_chunking=flip(),
        use_statistics=flip(),
        use_summary_offsets=flip(),
        enable_crcs=flip(),
        enable_data_crcs=flip(),
    )
    writer.start(profile=chance.choice(PROFILES), library="any")
    channels = {}
    for topic in topics:
        schema = writer.register_schema(topic.type_name, topic.definition_encoding, topic.definition)
        number = schema if topic.type_name else 0
        channels[topic] = [writer.register_channel(topic.name, topic.encoding, number, {"n": str(n)}) for n in range(2)]
    for n, message in enumerate(messages):
        writer.add_message(chance.choice(channels[message.topic]), message.time_ns, message.data, message.time_ns, n)
        if happens(chance, 0.02):
            writer.add_attachment(1, 1, "setup.txt", "text/plain", chance.randbytes(50))
            writer.add_metadata("rosbag2", {"serialized_metadata": "any"})
    writer.finish()
    return file.getvalue()


@dataclass
class _Counts:
    """Content of the statistics of a file."""

    channels: Counter[int]
    chunks: int = 0
    attachments: int = 0
    metadata: int = 0


class _RecordFile:
    """A file that is composed record by record, as no library writes it."""

    def __init__(self, messages: Sequence[GivenMessage], topics: Sequence[GivenTopic], chance: Random) -> None:
        self._messages, self._chance, self._topics = messages, chance, topics
        self._padded, self._private, self._checked = (happens(chance, share) for share in (0.4, 0.4, 0.5))
        self._schemas = {
            topic: Schema(data=topic.definition, encoding=topic.definition_encoding, id=3 * n + 1, name=topic.type_name)
            for n, topic in enumerate(topics)
            if topic.type_name
        }
        self._channels = {
            topic: Channel(
                id=5 * n,
                topic=topic.name,
                message_encoding=topic.encoding,
                metadata={},
                schema_id=self._schemas[topic].id if topic in self._schemas else 0,
            )
            for n, topic in enumerate(topics)
        }
        self._counts, self._indices = _Counts(Counter()), list[ChunkIndex]()
        self._data = bytearray(MAGIC)

    def write(self) -> bytes:
        """Return the file."""
        chance = self._chance
        self._data += self._record(Header(chance.choice(PROFILES), "any"))
        place = chance.choice(["before", "first chunk", "every chunk"])
        chunked, with_index = chance.choice([0.0, 0.5, 1.0, 1.0]), happens(chance, 0.6)
        definitions = self._definitions()
        if place == "before" or chunked < 1.0:
            self._data += b"".join(definitions)
        begin = 0
        while begin < len(self._messages) or not begin:
            end = begin + chance.choice([1, 3, 10, 40, 1000])
            part = self._messages[begin:end]
            inside = definitions if place == "every chunk" or (place == "first chunk" and not begin) else []
            if happens(chance, chunked):
                self._write_chunk(part, inside, with_index=with_index)
            else:
                self._data += b"".join(record for record, _, _ in self._records(part))
            self._write_other_record()
            begin = end
        self._data += self._record(DataEnd(crc32(self._data) if self._checked else 0))
        return bytes(self._with_summary())

    def _definitions(self) -> list[bytes]:
        """Return schemas and channels, each schema before its channels, some of them twice."""
        records: list[McapRecord] = []
        for topic, channel in self._channels.items():
            own = [*([self._schemas[topic]] if topic in self._schemas else []), channel]
            records += own * self._chance.choice([1, 1, 2])
        return [self._record(each) for each in records]

    def _records(self, messages: Sequence[GivenMessage]) -> Iterator[tuple[bytes, int, int]]:
        """Yield the record of each message, with the records before it that readers skip; its channel and its start."""
        for n, message in enumerate(messages):
            channel = self._channels[message.topic].id
            record = Message(
                channel_id=channel,
                log_time=message.time_ns,
                publish_time=message.time_ns,
                sequence=n,
                data=message.data,
            )
            before = self._private_record()
            self._counts.channels[channel] += 1
            yield before + self._record(record), channel, len(before)

    def _write_chunk(self, messages: Sequence[GivenMessage], definitions: Sequence[bytes], *, with_index: bool) -> None:
        chance, content, entries = self._chance, bytearray(b"".join(definitions)), dict[int, list[tuple[int, int]]]()
        for (record, channel, start), message in zip(self._records(messages), messages, strict=True):
            entries.setdefault(channel, []).append((message.time_ns, len(content) + start))
            content += record
        times = [message.time_ns for message in messages] or [0]
        compression = chance.choice(list(COMPRESSIONS))
        data, begin = COMPRESSIONS[compression](bytes(content)), len(self._data)
        checksum = crc32(content) if self._checked else 0
        self._data += self._record(
            Chunk(
                compression=compression,
                data=data,
                message_end_time=max(times),
                message_start_time=min(times),
                uncompressed_crc=checksum,
                uncompressed_size=len(content),
            )
        )
        end, offsets = len(self._data), dict[int, int]()
        for channel, index in entries.items() if with_index else ():
            offsets[channel] = len(self._data) if happens(chance, 0.9) else 0
            self._data += self._record(MessageIndex(channel, index))
        self._counts.chunks += 1
        self._indices.append(
            ChunkIndex(
                chunk_length=end - begin,
                chunk_start_offset=begin,
                compression=compression,
                compressed_size=len(data),
                message_end_time=max(times),
                message_index_length=len(self._data) - end,
                message_index_offsets=offsets,
                message_start_time=min(times),
                uncompressed_size=len(content),
            )
        )

    def _write_other_record(self) -> None:
        chance = self._chance
        if happens(chance, 0.1):
            self._counts.attachments += 1
            attachment = Attachment(1, 1, "setup.txt", "text/plain", chance.randbytes(30))
            self._data += self._record(attachment, extend=False)
        if happens(chance, 0.1):
            self._counts.metadata += 1
            self._data += self._record(Metadata("any", {"key": "value"}))
        self._data += self._private_record()

    def _private_record(self) -> bytes:
        """Return a record of an application or of a later version of the format, or nothing."""
        if not self._private or happens(self._chance, 0.7):
            return b""
        content = self._chance.randbytes(self._chance.randrange(40))
        return (
            bytes([self._chance.choice([0x10, 0x7F, 0x80, 0x90, 0xFF])]) + len(content).to_bytes(8, "little") + content
        )

    def _with_summary(self) -> bytearray:
        chance, begin = self._chance, len(self._data)
        groups: list[list[McapRecord]] = [[*self._schemas.values()], [*self._channels.values()], [*self._indices]]
        total = self._counts.channels.total()
        times = [message.time_ns for message in self._messages] or [0]
        groups.append(
            [
                Statistics(
                    attachment_count=self._counts.attachments,
                    channel_count=len(self._channels),
                    channel_message_counts=self._counts.channels if happens(chance, 0.8) else {},
                    chunk_count=self._counts.chunks,
                    message_count=total,
                    message_end_time=max(times),
                    message_start_time=min(times),
                    metadata_count=self._counts.metadata,
                    schema_count=len(self._schemas),
                )
            ]
        )
        groups = [group for group in groups if happens(chance, 0.6)]
        chance.shuffle(groups)
        summary = b"".join(self._record(record) for group in groups for record in group)
        footer = Footer(summary_start=begin if summary else 0, summary_offset_start=0, summary_crc=0)
        if self._checked:
            footer.summary_crc = crc32(summary + self._record(footer)[:-4])
        return self._data + summary + self._record(footer) + MAGIC

    def _record(self, record: McapRecord, *, extend: bool = True) -> bytes:
        """Return the bytes of a record, with fields that a later version of the format may add."""
        builder = RecordBuilder()
        record.write(builder)
        data = bytes(builder.end())
        if not self._padded or not extend or data[0] in NOT_EXTENDED or happens(self._chance, 0.5):
            return data
        content = data[9:] + self._chance.randbytes(self._chance.randrange(1, 9))
        return data[:1] + len(content).to_bytes(8, "little") + content
