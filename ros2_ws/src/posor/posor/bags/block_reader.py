"""Reads the messages of some topics of a bag thousands at a time, in the order of rosbags' ``Reader.messages``.

MCAP files with an index are read a whole chunk at a time; every other kind of bag (SQLite, MCAP without an index,
compressed files or messages) is read message by message by rosbags.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, NamedTuple

import numpy as np
from mcap.records import Channel, ChunkIndex

from posor.bags.bag_reader import bag_files, check_count
from posor.bags.mcap_file import INDEX_HEAD, RECORD_HEAD, checked_index, chunk_records
from posor.errors import BagError, TopicError
from posor.messages.byte_kernels import MESSAGE_HEAD, copy_messages, index_messages
from posor.messages.message_table import MessageTable, TableLayout

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mcap.records import McapRecord
    from rosbags.rosbag2 import Reader

    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import ByteArray, IntArray

BLOCK_BYTES = 4 << 20  # approximate bytes that are read at a time; a single chunk may be larger
BLOCK_MESSAGES = 16_384  # messages that are read at a time where rosbags reads them one by one
MOST_WAITING = 512 << 20  # limit of the bytes of messages that wait in memory for chunks that overlap in log time
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Entry of a message index: log time, and offset of the message in its chunk."""


@dataclass(frozen=True)
class MessageBlock:
    """Messages, n of them, in the order of their log times."""

    data: ByteArray  # bytes that contain all messages
    topics: IntArray  # number of each message's topic, shape (n,)
    times_ns: IntArray  # log times, shape (n,)
    starts: IntArray  # offset of each message in ``data``, shape (n,)
    lengths: IntArray  # bytes of each message, shape (n,)

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def nbytes(self) -> int:
        """Memory that the block holds [bytes]."""
        return self.data.nbytes + 4 * self.times_ns.nbytes

    def select(self, which: IntArray | slice) -> MessageBlock:
        """Return some of the messages; they share ``data`` with this block."""
        return MessageBlock(
            self.data, self.topics[which], self.times_ns[which], self.starts[which], self.lengths[which]
        )

    def compact(self) -> MessageBlock:
        """Return the messages with bytes of their own if they use less than half of ``data``, else this block."""
        size = int(self.lengths.sum())
        if 2 * size >= len(self.data):
            return self
        starts, data = np.cumsum(self.lengths) - self.lengths, np.empty(size, dtype=np.uint8)
        copy_messages(self.data, self.starts, self.lengths, data)
        return MessageBlock(data, self.topics.copy(), self.times_ns.copy(), starts, self.lengths.copy())


def read_blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    """Yield the messages of some topics in the order of ``reader.messages``.

    In a file of the bag, the order is that of the log times; messages of equal log time keep their order in the file.
    ``topics``: the topics; a block numbers them in this order; ``where``: name of the bag in errors. Raises BagError: a
    chunk is cut short or damaged, or chunks overlap so much that too many messages wait; at the end, when the number of
    messages differs from that in the bag's index.
    """
    count = 0
    for block in _read_blocks(reader, topics, where):
        count += len(block)
        yield block
    check_count(reader, topics, count, where)


def _read_blocks(reader: Reader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    files = [] if reader.compression_mode in {"file", "message"} else bag_files(Path(str(reader.path)))
    indices = [checked_index(file) if file.suffix == ".mcap" else [] for file in files]
    if indices and all(any(isinstance(record, ChunkIndex) for record in index) for index in indices):
        for file, index in zip(files, indices, strict=True):
            with file.open("rb") as opened:
                yield from _FileReader(opened, index, topics, where).read_blocks()
    else:
        yield from _read_messages(reader, topics)


def _read_messages(reader: Reader, topics: Sequence[str]) -> Iterator[MessageBlock]:
    numbers = {topic: number for number, topic in enumerate(topics)}
    messages = reader.messages([connection for connection in reader.connections if connection.topic in numbers])
    while group := list(islice(messages, BLOCK_MESSAGES)):
        lengths = np.fromiter((len(data) for _, _, data in group), np.int64, len(group))
        yield MessageBlock(
            data=np.frombuffer(b"".join(data for _, _, data in group), dtype=np.uint8),
            topics=np.fromiter((numbers[connection.topic] for connection, _, _ in group), np.int64, len(group)),
            times_ns=np.fromiter((time_ns for _, time_ns, _ in group), np.int64, len(group)),
            starts=np.cumsum(lengths) - lengths,
            lengths=lengths,
        )


class _ReadPosition(NamedTuple):
    """Position of a message in the order in which rosbags reads a file: by log time, then by offset of the chunk."""

    time_ns: int
    offset: int


END = _ReadPosition(np.iinfo(np.int64).max, np.iinfo(np.int64).max)


class _Held(NamedTuple):
    """Messages of the chunk at an offset that wait for later chunks."""

    offset: int
    block: MessageBlock


class _FileReader:
    """Reads an MCAP file chunk by chunk in the order of the first messages of some topics.

    Messages of a chunk wait until no later chunk can contain earlier ones; each is copied a few times at most.
    """

    def __init__(self, file: BinaryIO, index: Sequence[McapRecord], topics: Sequence[str], where: str) -> None:
        """Select the chunks with messages of some topics; ``where`` names the bag in errors."""
        self._file, self._topics, self._where = file, topics, where
        self._numbers = np.full(1 << 16, -1, dtype=np.int64)
        for record in index:
            if isinstance(record, Channel) and record.topic in topics:
                self._numbers[record.id] = topics.index(record.topic)
        self._held: list[_Held] = []
        chunks = [
            chunk
            for chunk in index
            if isinstance(chunk, ChunkIndex) and any(self._numbers[number] >= 0 for number in _channels_of(chunk))
        ]
        chunks.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
        firsts = [chunk.message_start_time for chunk in chunks]
        if any(chunk.message_end_time >= following for chunk, following in zip(chunks, firsts[1:], strict=False)):
            firsts = [max(chunk.message_start_time, self._read_first_time(chunk)) for chunk in chunks]
        positions = [_ReadPosition(*each) for each in zip(firsts, (c.chunk_start_offset for c in chunks), strict=True)]
        self._chunks = sorted(zip(positions, chunks, strict=True), key=lambda each: each[0])

    def read_blocks(self) -> Iterator[MessageBlock]:
        """Yield the messages of the file in order."""
        size = 0
        for n, (first, chunk) in enumerate(self._chunks, start=1):
            size += chunk.uncompressed_size
            block = self._read_chunk(first, chunk)
            if len(block):
                self._held.append(_Held(first.offset, block.compact()))
            limit, following = self._chunks[n] if n < len(self._chunks) else (END, None)
            if following is None or size + following.uncompressed_size > BLOCK_BYTES:
                yield from self._take_before(limit)
                size = 0

    def _read_chunk(self, first: _ReadPosition, chunk: ChunkIndex) -> MessageBlock:
        self._file.seek(first.offset)
        records = chunk_records(self._file.read(chunk.chunk_length)[RECORD_HEAD.size :])
        block = self._index_messages(np.frombuffer(records, dtype=np.uint8))
        if len(block) and not first.time_ns <= block.times_ns[0] <= block.times_ns[-1] <= chunk.message_end_time:
            raise BagError(
                f"the chunk at byte {first.offset} holds messages logged from {block.times_ns[0]} to "
                f"{block.times_ns[-1]} ns",
                where=self._where,
                expected=f"from {first.time_ns} to {chunk.message_end_time} ns, as its index says",
            )
        return block

    def _read_first_time(self, chunk: ChunkIndex) -> int:
        """Return the log time of the first message of the topics in a chunk, from the index records after the chunk."""
        self._file.seek(chunk.chunk_start_offset + chunk.chunk_length)
        data, offset, times = self._file.read(chunk.message_index_length), 0, []
        while offset + INDEX_HEAD.size <= len(data):
            _, length, channel, size = INDEX_HEAD.unpack_from(data, offset)
            begin, offset = offset + INDEX_HEAD.size, offset + RECORD_HEAD.size + length
            if begin + size == offset <= len(data) and size >= INDEX_ENTRY.itemsize and self._numbers[channel] >= 0:
                entries = np.frombuffer(data, INDEX_ENTRY, count=size // INDEX_ENTRY.itemsize, offset=begin)
                times.append(int(entries["log_time"].min()))
        if offset != chunk.message_index_length or not times:
            raise BagError(
                f"the chunk at byte {chunk.chunk_start_offset} has a damaged message index",
                where=self._where,
                expected="the log times of its messages",
            )
        return min(times)

    def _index_messages(self, data: ByteArray) -> MessageBlock:
        capacity = len(data) // (RECORD_HEAD.size + MESSAGE_HEAD) + 1
        topics, times, starts, lengths = (np.empty(capacity, dtype=np.int64) for _ in range(4))
        count, end = index_messages(data, self._numbers, topics, times, starts, lengths)
        if end != len(data):
            when = f", after the message logged at {times[count - 1]} ns" if count else ""
            message = f"a chunk holds a record that runs beyond its end{when}"
            raise BagError(message, where=self._where, expected="whole records")
        # Select by indices, which copies: the four arrays have the capacity for the shortest possible messages.
        return MessageBlock(data, topics, times, starts, lengths).select(np.argsort(times[:count], kind="stable"))

    def _take_before(self, limit: _ReadPosition) -> Iterator[MessageBlock]:
        """Yield the messages before a position, in order."""
        ready, waiting = [], []
        for offset, block in sorted(self._held, key=lambda held: held.offset):
            side: Literal["left", "right"] = "right" if offset < limit.offset else "left"
            count = int(np.searchsorted(block.times_ns, limit.time_ns, side=side))
            if count:
                ready.append(block.select(slice(count)))
            if count < len(block):
                rest = block.select(slice(count, None)) if count else block
                waiting.append(_Held(offset, rest.compact()))
        self._held = waiting
        if ready:
            yield from _merge_blocks(ready, BLOCK_BYTES)
        if sum(block.nbytes for _, block in waiting) > MOST_WAITING:
            time_ns = min(int(block.times_ns[0]) for _, block in waiting)
            raise BagError(
                f"chunks overlap so much in log time that more than {MOST_WAITING >> 20} MiB of messages of "
                f"{', '.join(self._topics)} wait for others, at {time_ns} ns",
                where=self._where,
                expected="messages about in the order of their log times, as `mcap sort` writes them",
            )


def _channels_of(chunk: ChunkIndex) -> list[int]:
    """Return the channels with messages in a chunk: those whose index record, of 15 bytes and more, has entries."""
    offsets = sorted((offset, number) for number, offset in chunk.message_index_offsets.items())
    end = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    return [number for (begin, number), (end, _) in pairwise([*offsets, (end, 0)]) if end - begin > INDEX_HEAD.size]


def _merge_blocks(parts: Sequence[MessageBlock], size: int) -> Iterator[MessageBlock]:
    """Yield the messages of several blocks in the order of their log times."""
    if len(parts) == 1:
        yield parts[0]
        return
    part_of = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    order = np.argsort(np.concatenate([part.times_ns for part in parts]), kind="stable")
    sizes = np.cumsum(np.concatenate([part.lengths for part in parts])[order])
    begins = np.zeros(len(parts), dtype=np.int64)
    cuts = np.unique(np.searchsorted(sizes, np.arange(size, sizes[-1], size)) + 1)
    for group in np.split(part_of[order], cuts[cuts < len(order)]):
        ends = begins + np.bincount(group, minlength=len(parts))
        ranges = zip(parts, begins, ends, strict=True)
        yield _sorted_by_time([part.select(slice(begin, end)).compact() for part, begin, end in ranges if begin < end])
        begins = ends


def _sorted_by_time(parts: Sequence[MessageBlock]) -> MessageBlock:
    sizes = np.array([len(part.data) for part in parts])
    block = MessageBlock(
        data=np.concatenate([part.data for part in parts]),
        topics=np.concatenate([part.topics for part in parts]),
        times_ns=np.concatenate([part.times_ns for part in parts]),
        starts=np.concatenate(
            [part.starts + begin for part, begin in zip(parts, np.cumsum(sizes) - sizes, strict=True)]
        ),
        lengths=np.concatenate([part.lengths for part in parts]),
    )
    return block.select(np.argsort(block.times_ns, kind="stable"))


class TopicReader:
    """Turns the messages of one topic, block after block, into tables."""

    def __init__(self, number: int, topic: str, schema: Schema, where: str) -> None:
        """Read the topic of a ``number`` in the blocks; ``topic`` and ``where``, the bag, name it in errors."""
        self._number = number
        self._topic = topic
        self._schema = schema
        self._where = where
        self._layout: TableLayout | None = None

    def read_tables(self, block: MessageBlock) -> Iterator[tuple[IntArray, IntArray, MessageTable]]:
        """Yield the topic's messages of a block in order: log times [ns], positions in the block, messages.

        Raises BagError: a message is invalid.
        """
        positions = np.flatnonzero(block.topics == self._number)
        own = block.select(positions)
        begin, count = 0, len(own)
        while begin < count:
            table = None
            if self._layout is not None:
                table = self._layout.read(own.data, own.starts[begin:], own.lengths[begin:])
            if table is None or not len(table):
                table = self._read_first(own, begin)
            end = begin + len(table)
            yield own.times_ns[begin:end], positions[begin:end], table
            begin = end

    def _read_first(self, block: MessageBlock, n: int) -> MessageTable:
        start, length = int(block.starts[n]), int(block.lengths[n])
        data = block.data[start : start + length].tobytes()
        try:
            data = self._schema.normal(data)
            self._layout = TableLayout.of(data, self._schema)
        except TopicError as error:
            where = f"{self._where}, topic {self._topic}, logged at {block.times_ns[n]} ns"
            raise BagError(str(error).rstrip("."), where=where, expected="a message that is whole") from error
        message = np.frombuffer(data, dtype=np.uint8)
        return self._layout.read(message, np.zeros(1, dtype=np.int64), np.array([len(message)]))
