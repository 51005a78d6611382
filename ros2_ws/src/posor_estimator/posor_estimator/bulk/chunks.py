"""The chunks of an MCAP file with messages of some topics, each read once, by when the first of these was logged."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

import numpy as np
from rosbags.rosbag2.storage_mcap import decompress, read_exact

from posor_estimator.bulk.bag_writer import INDEX_HEAD
from posor_estimator.bulk.block import Block
from posor_estimator.bulk.scanning import MESSAGE_HEAD, RECORD_HEAD, index_messages
from posor_estimator.bulk.waiting import LAST, Place
from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader

    from posor_estimator.core.types import ByteArray

CHUNK_HEAD = RECORD_HEAD + 40
"""Bytes of a chunk record before its compression's name and its records, as rosbags counts them."""
CRC_AT = RECORD_HEAD + 24
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Of a message index: when a message was logged, and where in its chunk it begins."""


class _ToCome(NamedTuple):
    """A chunk that is yet to be read; they compare by place, and no two begin at one offset.

    Attributes:
        first: No message of it that is wanted comes before this place.
        settled: The first of them is there; else it may be one of another topic.
        chunk: The chunk.

    """

    first: Place
    settled: bool
    chunk: ChunkInfo


class Chunks:
    """Chunks that are yet to be read; false when there is none."""

    def __init__(self, file: McapReader, topics: Sequence[str], where: str) -> None:
        """Take the chunks of an opened file with messages of some topics; ``where`` is what to call the bag."""
        if file.bio is None:
            message = "the file is closed"
            raise ValueError(message)
        self._bio: BinaryIO = file.bio
        self._where = where
        self._numbers = np.full(1 << 16, -1, dtype=np.int64)
        for connection in file.connections:
            if connection.topic in topics:
                self._numbers[connection.id] = topics.index(connection.topic)
        self._heap = [
            _ToCome(Place(chunk.message_start_time, chunk.chunk_start_offset), settled=False, chunk=chunk)
            for chunk in file.chunks
            if any(count and self._numbers[channel] >= 0 for channel, count in chunk.channel_count.items())
        ]
        heapq.heapify(self._heap)
        self._settle()

    def __bool__(self) -> bool:
        """Return whether there is one."""
        return bool(self._heap)

    @property
    def first(self) -> Place:
        """A place before which there is no wanted message that is yet to be read; ``LAST`` when there is no chunk."""
        return self._heap[0].first if self._heap else LAST

    @property
    def size(self) -> int:
        """How large the next chunk is [bytes]."""
        return self._heap[0].chunk.uncompressed_size

    def read(self) -> tuple[int, Block]:
        """Return where in the file the next chunk begins, and its messages of the wanted topics.

        Raises:
            BagError: It is damaged.

        """
        first, _, chunk = heapq.heappop(self._heap)
        block = self._found(np.frombuffer(self._records(chunk), dtype=np.uint8))
        if len(block) and not first.time_ns <= block.times_ns[0] <= block.times_ns[-1] <= chunk.message_end_time:
            raise BagError(
                f"the chunk at byte {first.offset} holds messages logged from {block.times_ns[0]} to "
                f"{block.times_ns[-1]} ns",
                where=self._where,
                expected=f"from {first.time_ns} to {chunk.message_end_time} ns, as its index says",
            )
        self._settle()
        return first.offset, block

    def _settle(self) -> None:
        """Bring to the front a chunk whose first wanted message is the first of all, or that ends before all others."""
        while self._heap and not self._heap[0].settled:
            first, _, chunk = self._heap[0]
            if all(chunk.message_end_time < other.first.time_ns for other in self._heap[1:3]):
                return
            time_ns = max(first.time_ns, self._first_ns(chunk))
            heapq.heapreplace(self._heap, _ToCome(Place(time_ns, first.offset), settled=True, chunk=chunk))

    def _first_ns(self, chunk: ChunkInfo) -> int:
        """Return when the first message of wanted topics in a chunk was logged, as the records behind the chunk say."""
        self._bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
        data, at, times = read_exact(self._bio, chunk.message_index_length), 0, []
        while at + INDEX_HEAD.size <= len(data):
            _, length, channel, size = INDEX_HEAD.unpack_from(data, at)
            begin, at = at + INDEX_HEAD.size, at + RECORD_HEAD + length
            if begin + size == at <= len(data) and size >= INDEX_ENTRY.itemsize and self._numbers[channel] >= 0:
                entries = np.frombuffer(data, INDEX_ENTRY, count=size // INDEX_ENTRY.itemsize, offset=begin)
                times.append(int(entries["log_time"].min()))
        if at != len(data) or not times:
            raise BagError(
                f"the chunk at byte {chunk.chunk_start_offset} has a damaged message index",
                where=self._where,
                expected="the log times of its messages",
            )
        return min(times)

    def _records(self, chunk: ChunkInfo) -> bytes:
        """Return the records of a chunk, decompressed."""
        bio = self._bio
        bio.seek(chunk.chunk_start_offset + CRC_AT)
        crc = int.from_bytes(read_exact(bio, 4), "little")
        bio.seek(chunk.chunk_start_offset + CHUNK_HEAD + len(chunk.compression))
        return decompress(read_exact(bio, chunk.compressed_size), chunk.compression, chunk.uncompressed_size, crc)

    def _found(self, data: ByteArray) -> Block:
        """Return the messages of wanted topics among a chunk's records."""
        most = len(data) // (RECORD_HEAD + MESSAGE_HEAD) + 1
        topics, times, starts, lengths = (np.empty(most, dtype=np.int64) for _ in range(4))
        count, end = index_messages(data, self._numbers, topics, times, starts, lengths)
        if end != len(data):
            when = f", after the message logged at {times[count - 1]} ns" if count else ""
            message = f"a chunk holds a record that runs beyond its end{when}"
            raise BagError(message, where=self._where, expected="whole records")
        # By indices, which copies: all four arrays have room for the shortest messages that there may be.
        return Block(data, topics, times, starts, lengths).chosen(np.argsort(times[:count], kind="stable"))
