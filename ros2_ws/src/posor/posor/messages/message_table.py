# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many messages with the same layout as one numpy table: a row of bytes for each, a named column for each field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.messages.byte_kernels import gather_rows
from posor.messages.cdr_schema import FieldKind, Schema

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from posor.numerics.array_types import BoolArray, ByteArray, FloatArray, IntArray, WordArray

LEAD = 4  # bytes before a message in its row; its body, four bytes later, is so aligned in memory too
ALL_BITS = 0xFF


class MessageRows(NamedTuple):
    """Messages in rows: the same memory as bytes, as words and floats of four bytes, and as floats of eight bytes."""

    octets: ByteArray
    words: WordArray
    floats: FloatArray
    singles: NDArray[np.float32]

    @staticmethod
    def of(rows: ByteArray) -> MessageRows:
        """Return views of rows of bytes, whose length is a multiple of eight."""
        return MessageRows(rows, rows.view(np.int32), rows.view(np.float64), rows.view(np.float32))


@dataclass(frozen=True)
class TableLayout:
    """Field offsets of messages with the same strings, and with sequences of the same lengths."""

    size: int  # bytes of such a message
    row: ByteArray  # row of the example message, shape (bytes,)
    fixed: ByteArray  # bits that every row of this layout shares with ``row``: encapsulation, lengths, characters
    strings: Mapping[str, str]  # the strings by path, such as ``header.frame_id``; lists of strings are left out
    dtype: np.dtype[np.void]  # of a row: every number by its path, such as ``header.stamp.sec``

    @staticmethod
    def of(data: bytes, schema: Schema) -> TableLayout:
        """Return the layout of an example message.

        ``data``: the message in plain CDR, little endian (``Schema.normal``); ``schema``: of its type. Raises
        TopicError: invalid bytes.
        """
        layout = schema.layout(data)
        stride = -(-(LEAD + layout.size) // 8) * 8
        row, fixed = np.zeros(stride, dtype=np.uint8), np.zeros(stride, dtype=np.uint8)
        row[LEAD : LEAD + layout.size] = np.frombuffer(data, dtype=np.uint8)[: layout.size]
        for offset, expected in layout.decisive.items():
            fixed[LEAD + offset : LEAD + offset + len(expected)] = ALL_BITS
        strings: dict[str, str] = {}
        names, formats, offsets = [], [], []
        for path, span in layout.spans.items():
            field = schema.by_path[path]
            if field.code == "s":
                fixed[LEAD + span.part.start : LEAD + span.part.stop + 1] = ALL_BITS  # with the zero at its end
                strings[path] = data[span.part].decode("utf-8", "replace")
                continue
            names.append(path)
            formats.append((f"<{field.code}", () if field.kind is FieldKind.ONE else (span.length,)))
            offsets.append(LEAD + span.offset)
        form: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": stride}
        return TableLayout(layout.size, row, fixed, strings, np.dtype(form))

    def read(self, data: ByteArray, starts: IntArray, lengths: IntArray) -> MessageTable:
        """Return messages up to the first of another layout, by their offsets in ``data`` and their lengths."""
        rows = np.empty((len(starts), len(self.row)), dtype=np.uint8)
        layout = np.stack([self.row, self.fixed]).view(np.uint64)
        count = gather_rows(data, starts, lengths, layout, rows.view(np.uint64), rows[:, LEAD : LEAD + self.size])
        return MessageTable(self, rows[:count])

    def copies(self, count: int) -> MessageTable:
        """Return a table of copies of the example message."""
        return MessageTable(self, np.tile(self.row, (count, 1)))

    def offset(self, path: str) -> int:
        """Return the byte of a message at which a field begins."""
        fields: Any = self.dtype.fields
        return int(fields[path][1]) - LEAD


@dataclass(frozen=True)
class MessageTable:
    """Messages with the same layout, n of them."""

    layout: TableLayout  # of all rows
    rows: ByteArray  # one message each, with padding before and after it, shape (n, bytes)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, path: str) -> Any:
        return self.rows.view(self.layout.dtype)[path][:, 0]

    def __setitem__(self, path: str, numbers: Any) -> None:
        self[path][...] = numbers

    def span(self, first: str, count: int) -> FloatArray:
        """Return successive float64 numbers that begin with field ``first``, shape (n, count), as a view."""
        begin = (LEAD + self.layout.offset(first)) // 8
        return self.rows.view(np.float64)[:, begin : begin + count]

    @property
    def messages(self) -> ByteArray:
        """The bytes of the messages, shape (n, size)."""
        return self.rows[:, LEAD : LEAD + self.layout.size]

    def select(self, which: BoolArray | IntArray | slice) -> MessageTable:
        """Return some of the messages."""
        return MessageTable(self.layout, self.rows[which])
