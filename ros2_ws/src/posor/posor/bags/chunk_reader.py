# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads the messages of some topics of MCAP files in the order of their log times, a whole chunk at a time."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from posor.bags.mcap_file import INDEX_HEAD, RECORD_HEAD
from posor.bags.message_block import MessageBlock
from posor.errors import BagError
from posor.messages.byte_kernels import MESSAGE_HEAD, index_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.bags.mcap_file import Span
    from posor.bags.mcap_storage import McapFile
    from posor.numerics.array_types import ByteArray

BLOCK_BYTES = 4 << 20  # approximate bytes that are read at a time; a single chunk may be larger
MOST_WAITING = 512 << 20  # limit of the bytes of messages that wait in memory for chunks that overlap in log time
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Entry of a message index: log time, and offset of the message in its chunk."""


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


class ChunkReader:
    """Reads MCAP files chunk by chunk in the order of the first messages of some topics.

    Messages of a chunk wait until no later chunk can contain earlier ones; each is copied a few times at most. Messages
    outside of chunks are read as if pieces of some megabytes were chunks.
    """

    def __init__(
        self, files: Sequence[McapFile], topics: Sequence[str], where: str, start: int | None, stop: int | None
    ) -> None:
        """Select the chunks with messages of some topics from ``start`` to before ``stop`` [ns]; None: all.

        ``where`` names the bag in errors.
        """
        self._files, self._topics, self._where = files, topics, where
        self._first_ns, self._stop_ns = start or 0, END.time_ns if stop is None else stop
        self._numbers: list[dict[int, int]] = []
        self._held: list[_Held] = []
        chunks: list[tuple[_ReadPosition, Span]] = []
        for n, file in enumerate(files):
            numbers = {each.id: topics.index(each.topic) for each in file.connections if each.topic in topics}
            self._numbers.append(numbers)
            chunks += (
                (_ReadPosition(span.start_ns, n, span.offset), span)
                for span in file.spans
                if (span.channels is None or not span.channels.isdisjoint(numbers))
                and span.end_ns >= self._first_ns
                and span.start_ns < self._stop_ns
            )
        chunks.sort(key=itemgetter(0))
        ends = [span.end_ns for _, span in chunks]
        if any(end >= following.time_ns for end, (following, _) in zip(ends, chunks[1:], strict=False)):
            chunks = [(position._replace(time_ns=self._first_time(position, span)), span) for position, span in chunks]
            chunks.sort(key=itemgetter(0))
        self._chunks = chunks

    def read_blocks(self) -> Iterator[MessageBlock]:
        """Yield the messages in order."""
        size = 0
        for n, (first, chunk) in enumerate(self._chunks, start=1):
            size += chunk.size
            block = self._read_chunk(first, chunk)
            if len(block):
                self._held.append(_Held(first, block.compact()))
            limit, following = self._chunks[n] if n < len(self._chunks) else (END, None)
            if following is None or size + following.size > BLOCK_BYTES:
                yield from self._take_before(limit)
                size = 0

    def _read_chunk(self, first: _ReadPosition, chunk: Span) -> MessageBlock:
        file = self._files[first.file]
        block = self._index_messages(np.frombuffer(file.records(chunk), dtype=np.uint8), first, chunk)
        if len(block) and not first.time_ns <= block.times_ns[0] <= block.times_ns[-1] <= chunk.end_ns:
            span = f"{block.times_ns[0]} to {block.times_ns[-1]} ns, not {first.time_ns} to {chunk.end_ns} ns"
            raise file.damage(chunk, f"the chunk holds messages logged from {span} as stated")
        times = np.searchsorted(block.times_ns, [self._first_ns, self._stop_ns])
        return block.select(slice(*times)) if times[1] - times[0] < len(block) else block

    def _first_time(self, position: _ReadPosition, chunk: Span) -> int:
        """Return the log time of the first message of the topics in a chunk, if index records after it state it."""
        file, numbers = self._files[position.file], self._numbers[position.file]
        data = file.read(chunk.offset + chunk.length, chunk.index_length)
        offset, times = 0, []
        while offset + INDEX_HEAD.size <= len(data):
            opcode, length, channel, size = INDEX_HEAD.unpack_from(data, offset)
            begin, offset = offset + INDEX_HEAD.size, offset + RECORD_HEAD.size + length
            if begin + size > offset or offset > len(data):
                break
            if opcode == Opcode.MESSAGE_INDEX and size >= INDEX_ENTRY.itemsize and channel in numbers:
                entries = np.frombuffer(data, INDEX_ENTRY, count=size // INDEX_ENTRY.itemsize, offset=begin)
                times.append(int(entries["log_time"].min()))
        if offset != chunk.index_length:
            raise file.damage(chunk, "the chunk has a damaged message index")
        return max([position.time_ns, *([min(times)] if times else [])])

    def _index_messages(self, data: ByteArray, position: _ReadPosition, chunk: Span) -> MessageBlock:
        numbers, known = np.full(1 << 16, -1, dtype=np.int64), self._numbers[position.file]
        numbers[list(known)] = list(known.values())
        capacity = len(data) // (RECORD_HEAD.size + MESSAGE_HEAD) + 1
        topics, times, starts, lengths = (np.empty(capacity, dtype=np.int64) for _ in range(4))
        count, end = index_messages(data, numbers, topics, times, starts, lengths)
        if end != len(data):
            when = f", after the message logged at {times[count - 1]} ns" if count else ""
            what = f"a chunk holds a record that runs beyond its end{when}"
            raise self._files[position.file].damage(chunk, what)
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
