# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag in blocks, and those of one topic as tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import BagError, TopicError
from posor.messages.byte_kernels import copy_messages
from posor.messages.message_table import MessageTable, TableLayout

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import ByteArray, IntArray


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

    @staticmethod
    def merge(parts: Sequence[MessageBlock]) -> MessageBlock:
        """Return the messages of several blocks in the order of their log times, those of equal log time as given."""
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
            raise BagError(f"{error.where}: {error.what}", where=where, expected=error.expected) from error
        message = np.frombuffer(data, dtype=np.uint8)
        return self._layout.read(message, np.zeros(1, dtype=np.int64), np.array([len(message)]))
