"""Reads the messages of some topics of a bag, thousands at a time or one by one, in the order of ``read_order.py``.

MCAP files with an index are read a whole chunk at a time; every other kind of bag (SQLite, MCAP without an index,
compressed files or messages) is read message by message by rosbags.
"""

from __future__ import annotations

from itertools import islice, pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from mcap.records import Channel, ChunkIndex

from posor.bags.mcap_file import INDEX_HEAD, RECORD_HEAD, checked_index, chunk_records
from posor.bags.message_block import MessageBlock
from posor.bags.read_order import order_scans
from posor.errors import BagError
from posor.messages.byte_kernels import MESSAGE_HEAD, index_messages

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from mcap.records import McapRecord
    from rosbags.interfaces import Connection

    from posor.bags.read_order import OrderedReader
    from posor.numerics.array_types import ByteArray

BLOCK_BYTES = 4 << 20  # approximate bytes that are read at a time; a single chunk may be larger
BLOCK_MESSAGES = 16_384  # messages that are read at a time where rosbags reads them one by one
MOST_WAITING = 512 << 20  # limit of the bytes of messages that wait in memory for chunks that overlap in log time
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Entry of a message index: log time, and offset of the message in its chunk."""


def read_blocks(reader: OrderedReader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    """Yield the messages of some topics in the order of their log times, scans in the order of their numbers.

    Messages of equal log time keep their order in the file. ``topics``: the topics; a block numbers them in this order;
    ``where``: name of the bag in errors. Raises BagError: a chunk is cut short or damaged, chunks overlap so much that
    too many messages wait, or the order of the scans is unknown; at the end, when the number of messages differs from
    that in the bag's index.
    """
    count = 0
    for block in order_scans(_read_blocks(reader, topics, where), reader, topics, where):
        count += len(block)
        yield block
    expected = sum(connection.msgcount for connection in reader.connections if connection.topic in topics)
    if count != expected:
        raise BagError(
            f"holds {count} messages of {', '.join(topics)}",
            where=where,
            expected=f"{expected}, as the index of the bag states",
        )


def read_messages(
    reader: OrderedReader, topics: Collection[str], where: str
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages of some topics one by one, as ``read_blocks``: topic, log time [ns], bytes."""
    connections = {connection.topic: connection for connection in reader.connections}
    names = list(topics)
    for block in read_blocks(reader, names, where):
        columns = (block.topics, block.times_ns, block.starts, block.lengths)
        for topic, time_ns, start, length in zip(*(column.tolist() for column in columns), strict=True):
            yield connections[names[topic]], time_ns, block.data[start : start + length].tobytes()


def _read_blocks(reader: OrderedReader, topics: Sequence[str], where: str) -> Iterator[MessageBlock]:
    files = [] if reader.compression_mode in {"file", "message"} else reader.files
    indices = {file: checked_index(file) if file.suffix == ".mcap" else [] for file in files}
    if indices and all(any(isinstance(record, ChunkIndex) for record in index) for index in indices.values()):
        yield from _ChunkReader(indices, topics, where).read_blocks()
    else:
        yield from _read_messages(reader, topics)


def _read_messages(reader: OrderedReader, topics: Sequence[str]) -> Iterator[MessageBlock]:
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
    """Position of a message in the order of reading: by log time, then by file and by offset of the chunk."""

    time_ns: int
    file: int
    offset: int


END = _ReadPosition(*3 * [np.iinfo(np.int64).max])


class _Held(NamedTuple):
    """Messages of the chunk at a position that wait for later chunks."""

    position: _ReadPosition
    block: MessageBlock


class _ChunkReader:
    """Reads the MCAP files of a bag chunk by chunk in the order of the first messages of some topics.

    Messages of a chunk wait until no later chunk can contain earlier ones; each is copied a few times at most.
    """

    def __init__(self, files: Mapping[Path, Sequence[McapRecord]], topics: Sequence[str], where: str) -> None:
        """Select the chunks with messages of some topics; ``files``: with their indices; ``where`` names the bag."""
        self._topics, self._where = topics, where
        self._files = list(files)
        self._numbers: list[dict[int, int]] = []
        self._held: list[_Held] = []
        chunks: list[tuple[_ReadPosition, ChunkIndex]] = []
        for file, index in enumerate(files.values()):
            channels = [record for record in index if isinstance(record, Channel) and record.topic in topics]
            numbers = {channel.id: topics.index(channel.topic) for channel in channels}
            self._numbers.append(numbers)
            chunks += (
                (_ReadPosition(chunk.message_start_time, file, chunk.chunk_start_offset), chunk)
                for chunk in index
                if isinstance(chunk, ChunkIndex) and any(number in numbers for number in _channels_of(chunk))
            )
        chunks.sort(key=itemgetter(0))
        ends = [chunk.message_end_time for _, chunk in chunks]
        if any(end >= following.time_ns for end, (following, _) in zip(ends, chunks[1:], strict=False)):
            firsts = [max(position.time_ns, self._read_first_time(position.file, each)) for position, each in chunks]
            chunks = [(each[0]._replace(time_ns=first), each[1]) for first, each in zip(firsts, chunks, strict=True)]
            chunks.sort(key=itemgetter(0))
        self._chunks = chunks

    def read_blocks(self) -> Iterator[MessageBlock]:
        """Yield the messages in order."""
        size = 0
        for n, (first, chunk) in enumerate(self._chunks, start=1):
            size += chunk.uncompressed_size
            block = self._read_chunk(first, chunk)
            if len(block):
                self._held.append(_Held(first, block.compact()))
            limit, following = self._chunks[n] if n < len(self._chunks) else (END, None)
            if following is None or size + following.uncompressed_size > BLOCK_BYTES:
                yield from self._take_before(limit)
                size = 0

    def _read_chunk(self, first: _ReadPosition, chunk: ChunkIndex) -> MessageBlock:
        data = self._read_bytes(first.file, first.offset, chunk.chunk_length)
        block = self._index_messages(np.frombuffer(chunk_records(data[RECORD_HEAD.size :]), dtype=np.uint8), first.file)
        if len(block) and not first.time_ns <= block.times_ns[0] <= block.times_ns[-1] <= chunk.message_end_time:
            raise BagError(
                f"the chunk at byte {first.offset} holds messages logged from {block.times_ns[0]} to "
                f"{block.times_ns[-1]} ns",
                where=self._place(first.file),
                expected=f"from {first.time_ns} to {chunk.message_end_time} ns, as the index of the file states",
            )
        return block

    def _read_bytes(self, file: int, offset: int, length: int) -> bytes:
        with self._files[file].open("rb") as opened:
            opened.seek(offset)
            return opened.read(length)

    def _place(self, file: int) -> str:
        """Return the name of the bag in errors, with that of the file if there are several."""
        return self._where if len(self._files) == 1 else f"{self._where}, {self._files[file].name}"

    def _read_first_time(self, file: int, chunk: ChunkIndex) -> int:
        """Return the log time of the first message of the topics in a chunk, from the index records after the chunk."""
        data = self._read_bytes(file, chunk.chunk_start_offset + chunk.chunk_length, chunk.message_index_length)
        offset, times = 0, []
        while offset + INDEX_HEAD.size <= len(data):
            _, length, channel, size = INDEX_HEAD.unpack_from(data, offset)
            begin, offset = offset + INDEX_HEAD.size, offset + RECORD_HEAD.size + length
            if begin + size == offset <= len(data) and size >= INDEX_ENTRY.itemsize and channel in self._numbers[file]:
                entries = np.frombuffer(data, INDEX_ENTRY, count=size // INDEX_ENTRY.itemsize, offset=begin)
                times.append(int(entries["log_time"].min()))
        if offset != chunk.message_index_length or not times:
            raise BagError(
                f"the chunk at byte {chunk.chunk_start_offset} has a damaged message index",
                where=self._place(file),
                expected="the log times of its messages",
            )
        return min(times)

    def _index_messages(self, data: ByteArray, file: int) -> MessageBlock:
        numbers = np.full(1 << 16, -1, dtype=np.int64)
        numbers[list(self._numbers[file])] = list(self._numbers[file].values())
        capacity = len(data) // (RECORD_HEAD.size + MESSAGE_HEAD) + 1
        topics, times, starts, lengths = (np.empty(capacity, dtype=np.int64) for _ in range(4))
        count, end = index_messages(data, numbers, topics, times, starts, lengths)
        if end != len(data):
            when = f", after the message logged at {times[count - 1]} ns" if count else ""
            message = f"a chunk holds a record that runs beyond its end{when}"
            raise BagError(message, where=self._place(file), expected="whole records")
        # Select by indices, which copies: the four arrays have the capacity for the shortest possible messages.
        return MessageBlock(data, topics, times, starts, lengths).select(np.argsort(times[:count], kind="stable"))

    def _take_before(self, limit: _ReadPosition) -> Iterator[MessageBlock]:
        """Yield the messages before a position, in order."""
        ready, waiting = [], []
        for position, block in sorted(self._held, key=lambda held: held.position[1:]):
            side: Literal["left", "right"] = "right" if position[1:] < limit[1:] else "left"
            count = int(np.searchsorted(block.times_ns, limit.time_ns, side=side))
            if count:
                ready.append(block.select(slice(count)))
            if count < len(block):
                rest = block.select(slice(count, None)) if count else block
                waiting.append(_Held(position, rest.compact()))
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
        yield MessageBlock.merge(
            [part.select(slice(begin, end)).compact() for part, begin, end in ranges if begin < end]
        )
        begins = ends
