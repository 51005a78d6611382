"""Messages of a bag by where their bytes lie, thousands at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.bulk.scanning import copy_messages

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_estimator.core.types import ByteArray, IntArray


@dataclass(frozen=True)
class Block:
    """Messages, n of them, in the order of their log times.

    Attributes:
        data: Where their bytes lie.
        topics: Of each message, which of the wanted topics it is of, shape (n,).
        times_ns: Log times, shape (n,).
        starts: Where each begins in ``data``, shape (n,).
        lengths: How many bytes each has, shape (n,).

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
    def size(self) -> int:
        """How much memory the block keeps [bytes]."""
        return self.data.nbytes + 4 * self.times_ns.nbytes

    def chosen(self, which: IntArray | slice) -> Block:
        """Return some of the messages, which share their bytes with this block."""
        return Block(self.data, self.topics[which], self.times_ns[which], self.starts[which], self.lengths[which])

    def dense(self) -> Block:
        """Return the messages; if most of the bytes are none of theirs, with bytes of their own instead."""
        size = int(self.lengths.sum())
        if 2 * size >= len(self.data):
            return self
        starts, data = np.cumsum(self.lengths) - self.lengths, np.empty(size, dtype=np.uint8)
        copy_messages(self.data, self.starts, self.lengths, data)
        return Block(data, self.topics.copy(), self.times_ns.copy(), starts, self.lengths.copy())


def merged(parts: Sequence[Block], size: int) -> Iterator[Block]:
    """Yield the messages of several blocks as if they were of one, in the order of their log times.

    Args:
        parts: Of messages of equal log time those of a former block come first.
        size: How many bytes of messages to yield at a time, about; a single block is yielded as it is.

    """
    if len(parts) == 1:
        yield parts[0]
        return
    part_of = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    order = np.argsort(np.concatenate([part.times_ns for part in parts]), kind="stable")
    sizes = np.cumsum(np.concatenate([part.lengths for part in parts])[order])
    begins = np.zeros(len(parts), dtype=np.int64)
    stops = np.unique(np.searchsorted(sizes, np.arange(size, sizes[-1], size)) + 1)
    for some in np.split(part_of[order], stops[stops < len(order)]):
        ends = begins + np.bincount(some, minlength=len(parts))
        each = zip(parts, begins, ends, strict=True)
        yield _joined([part.chosen(slice(begin, end)).dense() for part, begin, end in each if begin < end])
        begins = ends


def _joined(parts: Sequence[Block]) -> Block:
    """Return the messages of several blocks as one, likewise."""
    sizes = np.array([len(part.data) for part in parts])
    block = Block(
        data=np.concatenate([part.data for part in parts]),
        topics=np.concatenate([part.topics for part in parts]),
        times_ns=np.concatenate([part.times_ns for part in parts]),
        starts=np.concatenate(
            [part.starts + begin for part, begin in zip(parts, np.cumsum(sizes) - sizes, strict=True)]
        ),
        lengths=np.concatenate([part.lengths for part in parts]),
    )
    return block.chosen(np.argsort(block.times_ns, kind="stable"))
