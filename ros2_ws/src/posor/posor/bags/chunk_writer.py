"""Writes MCAP bags a chunk at a time: thousands of messages, given as a table of bytes, become one chunk."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin

from posor.bags.mcap_file import Opcode
from posor.bags.mcap_writer import ChecksummedMcapWriter, McapBagWriter
from posor.messages.byte_kernels import write_records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rosbags.interfaces import Connection

    from posor.numerics.array_types import ByteArray, IntArray

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


class TopicMessages(NamedTuple):
    """Messages of one topic with the same length."""

    connection: Connection
    times_ns: IntArray
    """Log times, which do not go back, shape (n,)."""
    messages: ByteArray
    """Shape (n, s)."""


class _ChunkWriter(ChecksummedMcapWriter):
    """A writer that also writes whole chunks."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._buffer: ByteArray = np.empty(0, dtype=np.uint8)

    def write_chunk(self, parts: Sequence[TopicMessages]) -> None:
        """Write messages as one chunk; every topic has one part at most."""
        first = min(int(part.times_ns[0]) for part in parts)
        last = max(int(part.times_ns[-1]) for part in parts)
        pending = self.chunk.bio.getvalue()  # schemas and channels, before the first message
        self.chunk.bio = BytesIO()
        size = len(pending) + sum(len(part.times_ns) * (HEAD.itemsize + part.messages.shape[1]) for part in parts)
        if len(self._buffer) < size:
            self._buffer = np.empty(size, dtype=np.uint8)  # reused: allocating would double the time
        records, offset, entries = self._buffer[:size], len(pending), {}
        records[:offset] = np.frombuffer(pending, dtype=np.uint8)
        for part in parts:
            count, length = len(part.times_ns), HEAD.itemsize + part.messages.shape[1]
            rows = records[offset : offset + count * length].reshape(count, length)
            entries[part.connection.id] = index = np.empty((count, 2), dtype=np.int64)
            write_records(_record_head(part), part.times_ns, part.messages, offset, rows, index)
            offset += rows.nbytes
            self.channel_stats[part.connection.id] += count
        self.message_start_time = min(first, self.message_start_time)
        self.message_end_time = max(last, self.message_end_time)
        self.append_chunk(records.data, first, last, entries)


class ChunkedBagWriter(McapBagWriter):
    """A writer of bags that writes many messages at a time."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: _ChunkWriter}  # noqa: RUF012  as rosbags has it

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
    head["opcode"] = Opcode.MESSAGE
    head["length"] = HEAD.itemsize - OPCODE_AND_LENGTH + part.messages.shape[1]
    head["channel"] = part.connection.id
    return head.view(np.uint8)
