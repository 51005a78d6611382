"""Messages of chunks that overlap in time, which wait until no chunk that is yet to be read can hold former ones."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from posor_estimator.bulk.block import Block, merged
from posor_estimator.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MOST_WAITING = 512 << 20
"""Bytes of messages that may wait in memory."""


class Place(NamedTuple):
    """Where a message stands in the order in which rosbags reads a file: by log time, then by chunk.

    Attributes:
        time_ns: Its log time.
        offset: Where its chunk begins in the file [bytes].

    """

    time_ns: int
    offset: int


LAST = Place(np.iinfo(np.int64).max, np.iinfo(np.int64).max)


class _Run(NamedTuple):
    """What is left of a chunk; runs compare by the place of the first message, which no other one has."""

    first: Place
    block: Block


class Waiting:
    """Merges the messages of chunks; each message is copied a few times at most, however long it waits."""

    def __init__(self, size: int, topics: Sequence[str], where: str) -> None:
        """Give out about so many bytes at a time; of these topics and this bag complaints speak."""
        self._size = size
        self._topics = topics
        self._where = where
        self._runs: list[_Run] = []
        self._kept = 0

    def add(self, offset: int, block: Block) -> None:
        """Take the messages of a chunk, and where in the file it begins."""
        if len(block):
            kept = block.dense()
            self._kept += kept.size
            heapq.heappush(self._runs, _Run(Place(int(kept.times_ns[0]), offset), kept))

    def before(self, limit: Place) -> Iterator[Block]:
        """Yield the messages that come before a place, in order.

        Raises:
            BagError: Those that are left take too much memory.

        """
        ready: dict[int, Block] = {}
        while self._runs and self._runs[0].first < limit:
            (_, offset), block = heapq.heappop(self._runs)
            self._kept -= block.size
            side: Literal["left", "right"] = "right" if offset < limit.offset else "left"
            count = int(np.searchsorted(block.times_ns, limit.time_ns, side=side))
            ready[offset] = block.chosen(slice(count))
            self.add(offset, block.chosen(slice(count, None)))
        if ready:
            yield from merged([block for _, block in sorted(ready.items())], self._size)
        if self._kept > MOST_WAITING:
            topics, time_ns = ", ".join(self._topics), self._runs[0].first.time_ns
            raise BagError(
                f"chunks overlap so much in log time that more than {MOST_WAITING >> 20} MiB of messages of {topics} "
                f"wait for others, at {time_ns} ns",
                where=self._where,
                expected="messages about in the order of their log times, as `mcap sort` writes them",
            )
