"""The messages of one topic as tables: one table for successive messages with the same layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor.errors import BagError, TopicError
from posor.messages.message_table import MessageTable, TableLayout

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor.bags.message_block import MessageBlock
    from posor.messages.cdr_schema import Schema
    from posor.numerics.array_types import IntArray


class TopicReader:
    """Turns the messages of one topic, block after block, into tables."""

    def __init__(self, number: int, topic: str, schema: Schema, where: str) -> None:
        """Prepare.

        Args:
            number: Of the topic in the blocks.
            topic: Its name, for errors.
            schema: Of its messages.
            where: Name of the bag in errors.

        """
        self._number = number
        self._topic = topic
        self._schema = schema
        self._where = where
        self._layout: TableLayout | None = None

    def read_tables(self, block: MessageBlock) -> Iterator[tuple[IntArray, IntArray, MessageTable]]:
        """Yield the topic's messages of a block in order: log times [ns], positions in the block, messages.

        Raises:
            BagError: A message is invalid.

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
        """Return message n alone, the first of a new layout."""
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
