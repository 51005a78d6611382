"""Merges the messages of MCAP chunks that overlap in log time."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from posor.bags.message_block import MessageBlock, merge_blocks
from posor.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MOST_WAITING = 512 << 20
"""Limit of the bytes of messages that wait in memory."""


class ReadPosition(NamedTuple):
    """Position of a message in the order in which rosbags reads a file: by log time, then by chunk.

    Attributes:
        time_ns: Log time of the message.
        offset: Offset of its chunk in the file [bytes].

    """

    time_ns: int
    offset: int


END = ReadPosition(np.iinfo(np.int64).max, np.iinfo(np.int64).max)


class _Remainder(NamedTuple):
    """The messages of a chunk that still wait; ordered by the position of the first one, which is unique."""

    first: ReadPosition
    block: MessageBlock


class ChunkMerger:
    """Holds the messages of chunks until no later chunk can contain earlier ones; copies each a few times at most."""

    def __init__(self, size: int, topics: Sequence[str], where: str) -> None:
        """Prepare.

        Args:
            size: Approximate bytes of a merged block.
            topics: The topics, for errors.
            where: Name of the bag in errors.

        """
        self._size = size
        self._topics = topics
        self._where = where
        self._remainders: list[_Remainder] = []
        self._held_bytes = 0

    def add(self, offset: int, block: MessageBlock) -> None:
        """Add the messages of the chunk that begins at an offset of the file."""
        if len(block):
            held = block.compact()
            self._held_bytes += held.nbytes
            heapq.heappush(self._remainders, _Remainder(ReadPosition(int(held.times_ns[0]), offset), held))

    def take_before(self, limit: ReadPosition) -> Iterator[MessageBlock]:
        """Yield the messages before a position, in order.

        Raises:
            BagError: The messages that still wait take too much memory.

        """
        ready: dict[int, MessageBlock] = {}
        while self._remainders and self._remainders[0].first < limit:
            (_, offset), block = heapq.heappop(self._remainders)
            self._held_bytes -= block.nbytes
            side: Literal["left", "right"] = "right" if offset < limit.offset else "left"
            count = int(np.searchsorted(block.times_ns, limit.time_ns, side=side))
            ready[offset] = block.select(slice(count))
            self.add(offset, block.select(slice(count, None)))
        if ready:
            yield from merge_blocks([block for _, block in sorted(ready.items())], self._size)
        if self._held_bytes > MOST_WAITING:
            topics, time_ns = ", ".join(self._topics), self._remainders[0].first.time_ns
            raise BagError(
                f"chunks overlap so much in log time that more than {MOST_WAITING >> 20} MiB of messages of {topics} "
                f"wait for others, at {time_ns} ns",
                where=self._where,
                expected="messages about in the order of their log times, as `mcap sort` writes them",
            )
