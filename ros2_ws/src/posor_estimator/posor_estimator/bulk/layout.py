"""Many messages that are laid out alike, read or written as one numpy table (see ``ros.cdr`` for one message)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posor_estimator.bulk.scanning import gather
from posor_estimator.ros.cdr import Schema
from posor_estimator.ros.cdr_fields import Kind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.types import BoolArray, ByteArray, FloatArray, IntArray

LongArray: TypeAlias = NDArray[np.uint64]

LEAD = 4
"""Bytes before a message in its row: its body, which begins four bytes later, is then aligned in memory too."""
EVERY_BIT = 0xFF


@dataclass(frozen=True)
class TableLayout:
    """Where the numbers of messages lie that have the same strings, and sequences of the same lengths.

    Attributes:
        size: Bytes of such a message.
        row: A table's row with such a message, shape (bytes,).
        fixed: Which bits of the row decide whether another one is such a message: encapsulation, lengths, characters.
        strings: The strings, by path such as ``header.frame_id``; a list of strings is left out.
        dtype: Of a row: every number by its path, such as ``header.stamp.sec``.

    """

    size: int
    row: ByteArray
    fixed: ByteArray
    strings: Mapping[str, str]
    dtype: np.dtype[np.void]

    @staticmethod
    def of(data: bytes, schema: Schema) -> TableLayout:
        """Return the layout of a message.

        Args:
            data: In plain CDR, little endian (``Schema.normal``).
            schema: Of its type.

        Raises:
            TopicError: The bytes are no such message.

        """
        layout = schema.layout(data)
        stride = -(-(LEAD + layout.size) // 8) * 8
        row, fixed = np.zeros(stride, dtype=np.uint8), np.zeros(stride, dtype=np.uint8)
        row[LEAD : LEAD + layout.size] = np.frombuffer(data, dtype=np.uint8)[: layout.size]
        for offset, there in layout.decisive.items():
            fixed[LEAD + offset : LEAD + offset + len(there)] = EVERY_BIT
        strings: dict[str, str] = {}
        names, formats, offsets = [], [], []
        for path, span in layout.spans.items():
            field = schema.by_path[path]
            if field.code == "s":
                fixed[LEAD + span.part.start : LEAD + span.part.stop + 1] = EVERY_BIT  # with the zero at its end
                strings[path] = data[span.part].decode("utf-8", "replace")
                continue
            names.append(path)
            formats.append((f"<{field.code}", () if field.kind is Kind.ONE else (span.length,)))
            offsets.append(LEAD + span.offset)
        form: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": stride}
        return TableLayout(layout.size, row, fixed, strings, np.dtype(form))

    @staticmethod
    def like(message: Any) -> TableLayout:
        """Return the layout of an rclpy message, whose numbers stand in the row."""
        schema = Schema.of(type(message))
        return TableLayout.of(schema.serialize(message), schema)

    def read(self, data: ByteArray, starts: IntArray, lengths: IntArray) -> Table:
        """Return messages, by where they begin in ``data`` and how long they are, up to the first of another layout."""
        rows = np.empty((len(starts), len(self.row)), dtype=np.uint8)
        template, fixed, words = (array.view(np.uint64) for array in (self.row, self.fixed, rows))
        count = gather(data, starts, lengths, template, fixed, words, rows[:, LEAD : LEAD + self.size])
        return Table(self, rows[:count])

    def empty(self, count: int) -> Table:
        """Return room for messages."""
        return Table(self, np.empty((count, len(self.row)), dtype=np.uint8))

    def offset(self, path: str) -> int:
        """Return at which byte of a message a field is, or begins."""
        fields: Any = self.dtype.fields
        return int(fields[path][1]) - LEAD

    def column(self, path: str) -> int:
        """Return which float64 number of a row a field is, or begins with."""
        fields: Any = self.dtype.fields
        return int(fields[path][1]) // 8

    def new(self, count: int) -> Table:
        """Return messages that are all like the one of which this is the layout."""
        return Table(self, np.tile(self.row, (count, 1)))


@dataclass(frozen=True)
class Table:
    """Messages that are laid out alike, n of them.

    Attributes:
        layout: How.
        rows: A row for each, shape (n, bytes): the message, with some bytes before and after it.

    """

    layout: TableLayout
    rows: ByteArray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.rows)

    def __getitem__(self, path: str) -> Any:
        """Return the numbers of a field, shape (n,) or (n, k); writing to them writes to the messages."""
        return self.rows.view(self.layout.dtype)[path][:, 0]

    def __setitem__(self, path: str, numbers: Any) -> None:
        """Write the numbers of a field."""
        self[path][...] = numbers

    def span(self, first: str, count: int) -> FloatArray:
        """Return successive float64 numbers as one array, (n, count); writing to it writes to the messages."""
        begin = self.layout.column(first)
        return self.rows.view(np.float64)[:, begin : begin + count]

    @property
    def messages(self) -> ByteArray:
        """The bytes of the messages, shape (n, s)."""
        return self.rows[:, LEAD : LEAD + self.layout.size]

    def chosen(self, which: BoolArray | IntArray | slice) -> Table:
        """Return some of the messages."""
        return Table(self.layout, self.rows[which])
