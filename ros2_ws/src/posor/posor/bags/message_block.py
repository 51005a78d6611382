"""Thousands of messages of a bag: their bytes, and arrays with the topic, log time, offset and length of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.messages.byte_kernels import copy_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.numerics.array_types import ByteArray, IntArray


@dataclass(frozen=True)
class MessageBlock:
    """Messages, n of them, in the order of their log times.

    Attributes:
        data: Bytes that contain all messages.
        topics: Number of each message's topic, shape (n,).
        times_ns: Log times, shape (n,).
        starts: Offset of each message in ``data``, shape (n,).
        lengths: Bytes of each message, shape (n,).

    """

    data: ByteArray
    topics: IntArray
    times_ns: IntArray
    starts: IntArray
    lengths: IntArray

    def __len__(self) -> int:
        """Return the number of messages."""
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


def merge_blocks(parts: Sequence[MessageBlock], size: int) -> Iterator[MessageBlock]:
    """Yield the messages of several blocks in the order of their log times.

    Args:
        parts: The blocks. Of messages with equal log times those of an earlier block come first.
        size: Approximate bytes of messages to yield at a time; a single block is yielded as it is.

    """
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
    """Return the messages of several blocks as one block."""
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
