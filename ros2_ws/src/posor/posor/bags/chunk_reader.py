"""Reads the chunks of an MCAP file that hold messages of some topics, in the order of the first of these messages."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from rosbags.rosbag2.storage_mcap import decompress, read_exact

from posor.bags.chunk_merger import END, ReadPosition
from posor.bags.mcap_file import INDEX_HEAD
from posor.bags.message_block import MessageBlock
from posor.errors import BagError
from posor.messages.byte_kernels import MESSAGE_HEAD, RECORD_HEAD, index_messages

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader

    from posor.numerics.array_types import ByteArray

CHUNK_HEAD = RECORD_HEAD + 40
"""Bytes of a chunk record before the name of its compression and its records, as rosbags counts them."""
CRC_AT = RECORD_HEAD + 24
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Entry of a message index: log time, and offset of the message in its chunk."""


class _PendingChunk(NamedTuple):
    """A chunk that has not been read; ordered by position, and no two chunks begin at the same offset.

    Attributes:
        first: None of its messages of the topics comes before this position.
        time_is_exact: The first of these messages is at ``first``; else that may be a message of another topic.
        chunk: The chunk.

    """

    first: ReadPosition
    time_is_exact: bool
    chunk: ChunkInfo


class ChunkReader:
    """Chunks that have not been read yet; false when there is none."""

    def __init__(self, file: McapReader, topics: Sequence[str], where: str) -> None:
        """Select the chunks of an opened file with messages of some topics; ``where`` names the bag in errors."""
        if file.bio is None:
            message = "the file is closed"
            raise ValueError(message)
        self._bio: BinaryIO = file.bio
        self._where = where
        self._numbers = np.full(1 << 16, -1, dtype=np.int64)
        for connection in file.connections:
            if connection.topic in topics:
                self._numbers[connection.id] = topics.index(connection.topic)
        self._pending = [
            _PendingChunk(
                ReadPosition(chunk.message_start_time, chunk.chunk_start_offset), time_is_exact=False, chunk=chunk
            )
            for chunk in file.chunks
            if any(count and self._numbers[channel] >= 0 for channel, count in chunk.channel_count.items())
        ]
        heapq.heapify(self._pending)
        self._find_next_chunk()

    def __bool__(self) -> bool:
        """Return whether there is a chunk."""
        return bool(self._pending)

    @property
    def next_position(self) -> ReadPosition:
        """No unread message of the topics comes before this position; ``END`` when there is no chunk."""
        return self._pending[0].first if self._pending else END

    @property
    def next_size(self) -> int:
        """Size of the next chunk [bytes]."""
        return self._pending[0].chunk.uncompressed_size

    def read_next(self) -> tuple[int, MessageBlock]:
        """Return the file offset of the next chunk, and its messages of the topics.

        Raises:
            BagError: The chunk is damaged.

        """
        first, _, chunk = heapq.heappop(self._pending)
        block = self._index_messages(np.frombuffer(self._read_records(chunk), dtype=np.uint8))
        if len(block) and not first.time_ns <= block.times_ns[0] <= block.times_ns[-1] <= chunk.message_end_time:
            raise BagError(
                f"the chunk at byte {first.offset} holds messages logged from {block.times_ns[0]} to "
                f"{block.times_ns[-1]} ns",
                where=self._where,
                expected=f"from {first.time_ns} to {chunk.message_end_time} ns, as its index says",
            )
        self._find_next_chunk()
        return first.offset, block

    def _find_next_chunk(self) -> None:
        """Bring the chunk with the first message of the topics to the front, or one that ends before all others."""
        while self._pending and not self._pending[0].time_is_exact:
            first, _, chunk = self._pending[0]
            if all(chunk.message_end_time < other.first.time_ns for other in self._pending[1:3]):
                return
            time_ns = max(first.time_ns, self._read_first_time(chunk))
            heapq.heapreplace(
                self._pending, self._pending[0]._replace(first=first._replace(time_ns=time_ns), time_is_exact=True)
            )

    def _read_first_time(self, chunk: ChunkInfo) -> int:
        """Return the log time of the first message of the topics in a chunk, from the index records after the chunk."""
        self._bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
        data, offset, times = read_exact(self._bio, chunk.message_index_length), 0, []
        while offset + INDEX_HEAD.size <= len(data):
            _, length, channel, size = INDEX_HEAD.unpack_from(data, offset)
            begin, offset = offset + INDEX_HEAD.size, offset + RECORD_HEAD + length
            if begin + size == offset <= len(data) and size >= INDEX_ENTRY.itemsize and self._numbers[channel] >= 0:
                entries = np.frombuffer(data, INDEX_ENTRY, count=size // INDEX_ENTRY.itemsize, offset=begin)
                times.append(int(entries["log_time"].min()))
        if offset != len(data) or not times:
            raise BagError(
                f"the chunk at byte {chunk.chunk_start_offset} has a damaged message index",
                where=self._where,
                expected="the log times of its messages",
            )
        return min(times)

    def _read_records(self, chunk: ChunkInfo) -> bytes:
        """Return the records of a chunk, decompressed."""
        bio = self._bio
        bio.seek(chunk.chunk_start_offset + CRC_AT)
        crc = int.from_bytes(read_exact(bio, 4), "little")
        bio.seek(chunk.chunk_start_offset + CHUNK_HEAD + len(chunk.compression))
        return decompress(read_exact(bio, chunk.compressed_size), chunk.compression, chunk.uncompressed_size, crc)

    def _index_messages(self, data: ByteArray) -> MessageBlock:
        """Return the messages of the topics among a chunk's records."""
        capacity = len(data) // (RECORD_HEAD + MESSAGE_HEAD) + 1
        topics, times, starts, lengths = (np.empty(capacity, dtype=np.int64) for _ in range(4))
        count, end = index_messages(data, self._numbers, topics, times, starts, lengths)
        if end != len(data):
            when = f", after the message logged at {times[count - 1]} ns" if count else ""
            message = f"a chunk holds a record that runs beyond its end{when}"
            raise BagError(message, where=self._where, expected="whole records")
        # Select by indices, which copies: the four arrays have the capacity for the shortest possible messages.
        return MessageBlock(data, topics, times, starts, lengths).select(np.argsort(times[:count], kind="stable"))
