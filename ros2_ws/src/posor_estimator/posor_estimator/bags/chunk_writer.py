"""Writes MCAP bags a chunk at a time: thousands of messages, given as a table of bytes, become one chunk.

rosbags writes all else: schemas, channels, the summary, metadata.yaml. Chunks have neither compression nor checksum, as
those of rosbags.
"""

from __future__ import annotations

from io import BytesIO
from struct import Struct
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, write_string, write_uint32, write_uint64

from posor_estimator.bags.byte_kernels import write_records

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection

    from posor_estimator.numerics.array_types import ByteArray, IntArray

METADATA_VERSION: Literal[9] = 9
MESSAGE, CHUNK, MESSAGE_INDEX = 0x05, 0x06, 0x07
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""Head of a message record: opcode and length, then channel, sequence number and times."""
OPCODE_AND_LENGTH = 9
INDEX_HEAD = Struct("<BQHI")
"""Head of a topic's index record: opcode, length, channel, length of the entries."""


class TopicMessages(NamedTuple):
    """Messages of one topic with the same length."""

    connection: Connection
    times_ns: IntArray
    """Log times, which do not go back, shape (n,)."""
    messages: ByteArray
    """Shape (n, s)."""


class _ChunkWriter(McapWriter):
    """A rosbags MCAP writer that also writes whole chunks."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._buffer: ByteArray = np.empty(0, dtype=np.uint8)

    def write_chunk(self, parts: Sequence[TopicMessages]) -> None:
        """Write messages as one chunk; every topic has one part at most."""
        first = min(int(part.times_ns[0]) for part in parts)
        last = max(int(part.times_ns[-1]) for part in parts)
        pending = self.chunk.bio.getvalue()  # schemas and channels, before the first message
        size = len(pending) + sum(len(part.times_ns) * (HEAD.itemsize + part.messages.shape[1]) for part in parts)
        begin = self.bio.tell()
        self._write_head(size, first, last)
        self.bio.write(pending)
        indices, offset = [], len(pending)
        for part in parts:
            records, index = self._make_records(part, offset)
            self.bio.write(records.data)
            indices.append(index)
            offset += records.nbytes
            self.channel_stats[part.connection.id] += len(records)
        self.message_start_time = min(first, self.message_start_time)
        self.message_end_time = max(last, self.message_end_time)
        end = offset = self.bio.tell()
        offsets = {}
        for part, index in zip(parts, indices, strict=True):
            offsets[part.connection.id] = offset
            head = INDEX_HEAD.pack(MESSAGE_INDEX, 6 + index.nbytes, part.connection.id, index.nbytes)
            self.bio.write(head)
            self.bio.write(index.data)
            offset += len(head) + index.nbytes
        summary = BytesIO()
        for number in (first, last, begin, end - begin):
            write_uint64(summary, number)
        write_uint32(summary, 10 * len(offsets))
        for channel, index_offset in offsets.items():
            summary.write(channel.to_bytes(2, "little"))
            write_uint64(summary, index_offset)
        write_uint64(summary, offset - end)
        write_string(summary, "")
        write_uint64(summary, size)
        write_uint64(summary, size)
        self.chunks.append(summary)
        self.chunk.bio = BytesIO()

    def _make_records(self, part: TopicMessages, begin: int) -> tuple[ByteArray, IntArray]:
        """Return messages as records, and their index; ``begin``: offset of the first. Valid until the next call."""
        count, length = len(part.times_ns), HEAD.itemsize + part.messages.shape[1]
        if len(self._buffer) < count * length:
            self._buffer = np.empty(count * length, dtype=np.uint8)  # reused: allocating would double the time
        records = self._buffer[: count * length].reshape(count, length)
        index = np.empty((count, 2), dtype=np.int64)
        write_records(_record_head(part), part.times_ns, part.messages, begin, records, index)
        return records, index

    def _write_head(self, size: int, first: int, last: int) -> None:
        """Write the head of a chunk of ``size`` bytes."""
        head = BytesIO()
        write_uint64(head, first)
        write_uint64(head, last)
        write_uint64(head, size)
        write_uint32(head, 0)
        write_string(head, "")
        write_uint64(head, size)
        self.bio.write(CHUNK.to_bytes(1, "little"))
        write_uint64(self.bio, head.tell() + size)
        self.bio.write(head.getbuffer())


class ChunkedBagWriter(Writer):
    """A rosbags writer, MCAP only, that writes many messages at a time."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: _ChunkWriter}  # noqa: RUF012  as rosbags has it

    def __init__(self, path: Path) -> None:
        """Write a bag into a folder that does not exist yet."""
        super().__init__(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)

    def write_messages(self, parts: Sequence[TopicMessages]) -> None:
        """Write messages as one chunk."""
        parts = [part for part in parts if len(part.times_ns)]
        if not parts or not isinstance(self.storage, _ChunkWriter):
            return
        self.storage.write_chunk(parts)
        for part in parts:
            self.counts[part.connection.id] += len(part.times_ns)
            self.min_timestamp = min(self.min_timestamp, int(part.times_ns[0]))
            self.max_timestamp = max(self.max_timestamp, int(part.times_ns[-1]))


def _record_head(part: TopicMessages) -> ByteArray:
    """Return the first bytes of all records of a part, without the times."""
    head = np.zeros(1, dtype=HEAD)
    head["opcode"] = MESSAGE
    head["length"] = HEAD.itemsize - OPCODE_AND_LENGTH + part.messages.shape[1]
    head["channel"] = part.connection.id
    return head.view(np.uint8)
