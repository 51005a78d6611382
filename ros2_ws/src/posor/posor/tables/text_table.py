"""Text files: CSV and what data acquisition programs write in its place."""

from __future__ import annotations

import codecs
import csv
import io
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import DataFileError
from posor.tables.raw_table import Cells, Column, RawTable, parse_numbers
from posor.tables.table_units import find_unit, unit_in_name

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from posor.tables.table_map import FileLayout
    from posor.tables.table_units import Unit

SEPARATORS = {"tab": "\t", "space": " "}
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_CHUNK = 20_000  # rows that are converted at a time
_ENOUGH_ROWS = 3  # to judge the length of the last cell


def byte_order_mark(data: bytes) -> str:
    """Return the encoding that the first bytes of a file state; empty: no mark."""
    return next((name for mark, name in _MARKS if data.startswith(mark)), "")


def decode(data: bytes, encoding: str, where: str) -> str:
    """Return the text of a file. Raises DataFileError: the bytes are of another encoding; names the line."""
    encoding = byte_order_mark(data) or encoding
    if encoding == "utf-8" and b"\0" in data[:4096]:
        wide = "utf-16-le" if data[1:2] == b"\0" else "utf-16-be"
        raise DataFileError("holds zero bytes", where=where, expected=f"file: {{encoding: {wide}}} in the map, or text")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"byte {error.start} (0x{data[error.start]:02X}) is not {encoding}"
        expected = "the encoding in the map, such as file: {encoding: cp1252}"
        raise DataFileError(what, where=f"{where}, line {line}", expected=expected) from None


class TextTable(RawTable):
    """A text file with a row of names, and one row for each scan."""

    place_word = "line"

    def __init__(self, path: Path, text: str, layout: FileLayout) -> None:
        """Read the header."""
        self._text, self._layout, self._where = text, layout, str(path)
        rows = self._rows(1)
        header_line = layout.header_line
        number, header = next(((n, cells) for n, cells in rows if header_line in (None, 0, n)), (0, list[str]()))
        if not header:
            expected = "a row of names and one row for each scan" + (f", line {header_line}" if header_line else "")
            raise DataFileError(
                "is empty" if not header_line else "ends before its header", where=str(path), expected=expected
            )
        self._data_line = layout.data_line or (number if header_line == 0 else number + 1)
        units = (
            [cells for n, cells in self._rows(number + 1) if n < self._data_line]
            if self._data_line > number + 1
            else []
        )
        if header_line == 0:
            header = [str(n + 1) for n in range(len(header))]
        while len(header) > 1 and not header[-1]:
            header.pop()  # a separator at the end of the line
        columns = [Column(name, unit_in_name(name) or _unit_below(units, n)) for n, name in enumerate(header)]
        super().__init__(path, columns)

    def _rows(self, first_line: int) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of every line that is neither empty nor a comment."""
        layout, number = self._layout, 0
        separator = SEPARATORS.get(layout.separator, layout.separator)

        def lines() -> Iterator[str]:
            nonlocal number
            for line in io.StringIO(self._text, newline=None):
                number += 1
                is_comment = bool(layout.comment) and line.startswith(layout.comment)
                is_comment |= number == 1 and line.startswith("sep=")  # of Excel
                if number >= first_line and line.strip() and not is_comment:
                    yield " ".join(line.split()) if layout.separator == "space" else line

        reader = csv.reader(lines(), delimiter=separator, skipinitialspace=True, strict=True)
        try:
            for cells in reader:
                yield number, [cell.strip() for cell in cells]
        except csv.Error as error:
            expected = "quotes in pairs, and the separator of the file in the map"
            raise DataFileError(str(error), where=f"{self._where}, line {number}", expected=expected) from None

    def read(self, numbers: Collection[int], values: Collection[int]) -> Cells:
        """Return the columns."""
        cells = Cells(places=np.empty(0, dtype=np.int64))
        parts: dict[int, list[np.ndarray]] = {n: [] for n in numbers}
        texts: dict[int, list[str]] = {n: [] for n in values}
        places: list[int] = []
        rows = self._whole_rows(cells)
        while chunk := list(islice(rows, _CHUNK)):
            columns = list(zip(*(row for _, row in chunk), strict=True))
            for n in numbers:
                parts[n].append(parse_numbers(columns[n], self._layout.decimal, n, len(places), cells))
            for n in values:
                texts[n] += columns[n]
            places += [number for number, _ in chunk]
        cells.places = np.array(places, dtype=np.int64)
        cells.numbers = {n: np.concatenate(part) if part else np.empty(0) for n, part in parts.items()}
        cells.values = {n: np.array(text, dtype=object) for n, text in texts.items()}
        return cells

    def _whole_rows(self, cells: Cells) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows with a cell for each column; others are added to ``cells`` or refused."""
        count, shortest, rows = len(self.columns), 1 << 30, 0
        ended = self._text.endswith(("\n", "\r"))
        held: tuple[int, list[str]] | None = None
        for number, row in self._rows(self._data_line):
            if len(row) > count and any(row[count:]):
                expected = f"{count}, as in the header"
                if self._layout.separator == ",":
                    expected += "; numbers with decimal commas need another separator"
                raise DataFileError(f"there are {len(row)} cells", where=self.place(number), expected=expected)
            if held:
                shortest, rows = min(shortest, len(held[1][-1])), rows + 1
                yield held
            held = None
            if len(row) < count:
                cells.incomplete.append((number, f"there are {len(row)} cells", f"{count}, as in the header"))
            else:
                held = number, row[:count]
        if held and not ended and rows >= _ENOUGH_ROWS and len(held[1][-1]) < shortest:
            what = f"'{held[1][-1]}' at the end of the file is shorter than all cells above it"
            cells.incomplete.append((held[0], what, "a whole line"))
        elif held:
            yield held


def _unit_below(rows: list[list[str]], column: int) -> Unit | None:
    """Return the unit that the lines between header and data state for a column."""
    cells = (row[column].strip("[]() ") for row in rows if column < len(row))
    return next((unit for cell in cells if (unit := find_unit(cell))), None)
