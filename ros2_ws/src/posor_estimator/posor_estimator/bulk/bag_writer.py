"""Writes bags in bulk: thousands of messages, given as a table of bytes, become one chunk of an MCAP file.

rosbags writes all else: schemas, channels, the summary, metadata.yaml. The chunks are as its own: no compression, no
checksum.
"""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, write_record, write_string, write_uint32, write_uint64

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection

    from posor_estimator.bulk.layout import ByteArray
    from posor_estimator.core.types import IntArray

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
"""Of a message record: opcode and length, then what comes before the message itself."""
OPCODE_AND_LENGTH = 9
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])


class Part(NamedTuple):
    """Messages of one topic, of one length."""

    connection: Connection
    times_ns: IntArray
    """Log times, which do not go back, shape (n,)."""
    messages: ByteArray
    """Shape (n, s)."""


class _ChunkWriter(McapWriter):
    """Also takes whole chunks."""

    def write_chunk(self, parts: Sequence[Part]) -> None:
        """Write messages as one chunk, each topic's in the order of its part."""
        first = min(int(part.times_ns[0]) for part in parts)
        last = max(int(part.times_ns[-1]) for part in parts)
        begun = self.chunk.bio.getvalue()  # schemas and channels, before the first message
        records: list[Any] = [begun]
        indices = []
        size = len(begun)
        for part in parts:
            table = _records(part)
            index = np.empty(len(table), dtype=INDEX_ENTRY)
            index["log_time"] = part.times_ns
            index["offset"] = size + np.arange(len(table), dtype=np.int64) * table.shape[1]
            indices.append(index)
            records.append(table.data)
            size += table.nbytes
            self.channel_stats[part.connection.id] += len(table)
        self.message_start_time = min(first, self.message_start_time)
        self.message_end_time = max(last, self.message_end_time)
        begin = self.bio.tell()
        self._write_records(records, size, first, last)
        end = self.bio.tell()
        offsets = []
        for part, index in zip(parts, indices, strict=True):
            offsets.append((part.connection.id, self.bio.tell()))
            record = BytesIO()
            record.write(part.connection.id.to_bytes(2, "little"))
            write_uint32(record, index.nbytes)
            record.write(index.data)
            write_record(self.bio, MESSAGE_INDEX, record)
        summary = BytesIO()
        for number in (first, last, begin, end - begin):
            write_uint64(summary, number)
        write_uint32(summary, 10 * len(offsets))
        for channel, offset in offsets:
            summary.write(channel.to_bytes(2, "little"))
            write_uint64(summary, offset)
        write_uint64(summary, self.bio.tell() - end)
        write_string(summary, "")
        write_uint64(summary, size)
        write_uint64(summary, size)
        self.chunks.append(summary)
        self.chunk.bio = BytesIO()

    def _write_records(self, records: Sequence[Any], size: int, first: int, last: int) -> None:
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
        for record in records:
            self.bio.write(record)


class BulkWriter(Writer):
    """A rosbags writer, MCAP only, that takes many messages at a time."""

    STORAGE_PLUGINS = {StoragePlugin.MCAP: _ChunkWriter}  # noqa: RUF012  as rosbags has it

    def __init__(self, path: Path) -> None:
        """Write a bag into a folder that is yet to be made."""
        super().__init__(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)

    def write_parts(self, parts: Sequence[Part]) -> None:
        """Write messages as one chunk."""
        parts = [part for part in parts if len(part.times_ns)]
        if not parts or not isinstance(self.storage, _ChunkWriter):
            return
        self.storage.write_chunk(parts)
        for part in parts:
            self.counts[part.connection.id] += len(part.times_ns)
            self.min_timestamp = min(self.min_timestamp, int(part.times_ns[0]))
            self.max_timestamp = max(self.max_timestamp, int(part.times_ns[-1]))


def _records(part: Part) -> ByteArray:
    """Return messages as records, shape (n, head + s)."""
    count, size = part.messages.shape
    heads = np.empty(count, dtype=HEAD)
    heads["opcode"] = MESSAGE
    heads["length"] = HEAD.itemsize - OPCODE_AND_LENGTH + size
    heads["channel"] = part.connection.id
    heads["sequence"] = 0
    heads["log_time"] = heads["publish_time"] = part.times_ns
    table = np.empty((count, HEAD.itemsize + size), dtype=np.uint8)
    table[:, : HEAD.itemsize] = heads.view(np.uint8).reshape(count, HEAD.itemsize)
    table[:, HEAD.itemsize :] = part.messages
    return table
