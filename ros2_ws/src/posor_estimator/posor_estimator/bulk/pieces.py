"""The messages of one topic as tables: as long as they are laid out alike, as one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.bulk.layout import Table, TableLayout
from posor_estimator.errors import BagError, TopicError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_estimator.bulk.block import Block
    from posor_estimator.core.types import IntArray
    from posor_estimator.ros.cdr import Schema


@dataclass(frozen=True)
class Piece:
    """Successive messages of a topic that are laid out alike.

    Attributes:
        times_ns: Log times, shape (n,).
        places: Which messages of the block they are, shape (n,); later ones have larger numbers.
        table: The messages.

    """

    times_ns: IntArray
    places: IntArray
    table: Table


class TopicReader:
    """Turns the messages of one topic, block after block, into pieces."""

    def __init__(self, number: int, topic: str, schema: Schema, where: str) -> None:
        """Read the topic that blocks know by a number; ``where`` is what to call the bag."""
        self._number = number
        self._topic = topic
        self._schema = schema
        self._where = where
        self._layout: TableLayout | None = None

    def pieces(self, block: Block) -> Iterator[Piece]:
        """Yield the topic's messages of a block, in order.

        Raises:
            BagError: A message cannot be read.

        """
        places = np.flatnonzero(block.topics == self._number)
        mine = block.chosen(places)
        begin, count = 0, len(mine)
        while begin < count:
            table = None
            if self._layout is not None:
                table = self._layout.read(mine.data, mine.starts[begin:], mine.lengths[begin:])
            if table is None or not len(table):
                table = self._alone(mine, begin)
            end = begin + len(table)
            yield Piece(mine.times_ns[begin:end], places[begin:end], table)
            begin = end

    def _alone(self, block: Block, n: int) -> Table:
        """Return one message of another layout; those after it are then expected to be like it."""
        start, length = int(block.starts[n]), int(block.lengths[n])
        data = block.data[start : start + length].tobytes()
        try:
            data = self._schema.normal(data)
            self._layout = TableLayout.of(data, self._schema)
        except TopicError as error:
            when = f"{self._where}, topic {self._topic}, logged at {block.times_ns[n]} ns"
            raise BagError(str(error).rstrip("."), where=when, expected="a message that is whole") from error
        one = np.frombuffer(data, dtype=np.uint8)
        return self._layout.read(one, np.zeros(1, dtype=np.int64), np.array([len(one)]))
