"""Many messages that are laid out alike, read or written as one numpy table (see ``ros.cdr`` for one message)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posor_estimator.bulk.scanning import fits, gather
from posor_estimator.ros.cdr import Schema
from posor_estimator.ros.cdr_fields import Kind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

ByteArray: TypeAlias = NDArray[np.uint8]

LEAD = 4
"""Bytes before a message in its row: its body, which begins four bytes later, is then aligned in memory too."""


@dataclass(frozen=True)
class TableLayout:
    """Where the numbers of messages lie that have the same strings, and sequences of the same lengths.

    Attributes:
        template: The bytes of such a message, shape (s,).
        fixed: Which of them decide whether another one is such a message: encapsulation, lengths, characters; (f,).
        strings: The strings, by path such as ``header.frame_id``; a list of strings is left out.
        dtype: Of a row: every number by its path, such as ``header.stamp.sec``.

    """

    template: ByteArray
    fixed: IntArray
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
        fixed = [at for offset, there in layout.decisive.items() for at in range(offset, offset + len(there))]
        strings: dict[str, str] = {}
        names, formats, offsets = [], [], []
        for path, span in layout.spans.items():
            field = schema.by_path[path]
            if field.code == "s":
                fixed.extend(range(span.part.start, span.part.stop))
                strings[path] = data[span.part].decode("utf-8", "replace")
                continue
            names.append(path)
            formats.append((f"<{field.code}", () if field.kind is Kind.ONE else (span.length,)))
            offsets.append(LEAD + span.offset)
        stride = -(-(LEAD + layout.size) // 8) * 8
        form: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": stride}
        template = np.frombuffer(data, dtype=np.uint8)[: layout.size].copy()
        return TableLayout(template, np.array(fixed, dtype=np.int64), strings, np.dtype(form))

    @staticmethod
    def like(message: Any) -> TableLayout:
        """Return the layout of an rclpy message, whose numbers stand in the template."""
        schema = Schema.of(type(message))
        return TableLayout.of(schema.serialize(message), schema)

    def fits(self, data: ByteArray, starts: IntArray, lengths: IntArray) -> BoolArray:
        """Return which messages, by where they begin in ``data`` and how long they are, have this layout, (n,)."""
        out = np.empty(len(starts), dtype=np.bool_)
        fits(data, starts, lengths, self.template, self.fixed, out)
        return out

    def read(self, data: ByteArray, starts: IntArray) -> Table:
        """Return messages of this layout, by where they begin in ``data``."""
        table = np.empty((len(starts), self.dtype.itemsize), dtype=np.uint8)
        gather(data, starts, table[:, LEAD : LEAD + len(self.template)])
        return Table(self, table)

    def new(self, count: int) -> Table:
        """Return messages that are all like the template."""
        row = np.zeros(self.dtype.itemsize, dtype=np.uint8)
        row[LEAD : LEAD + len(self.template)] = self.template
        return Table(self, np.tile(row, (count, 1)))


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
        fields: Any = self.layout.dtype.fields
        begin = fields[first][1]
        return self.rows[:, begin : begin + 8 * count].view(np.float64)

    @property
    def messages(self) -> ByteArray:
        """The bytes of the messages, shape (n, s)."""
        return self.rows[:, LEAD : LEAD + len(self.layout.template)]

    def chosen(self, which: BoolArray | IntArray | slice) -> Table:
        """Return some of the messages."""
        return Table(self.layout, self.rows[which])
