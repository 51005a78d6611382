# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text files: CSV and what data acquisition programs write in its place."""

from __future__ import annotations

import codecs
import csv
import io
import re
from itertools import islice, pairwise
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import DataFileError
from posor.tables.raw_table import MISSING, Cells, Column, RawTable, is_number, parse_numbers
from posor.tables.table_units import find_unit, stated_unit, unit_in_name

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from posor.tables.table_map import FileLayout

SEPARATORS = {"tab": "\t", "space": " "}
_OTHER_SEPARATORS = {"';'": ";", "tab": "\t", "'|'": "|", "','": ",", "space": " "}  # as in a map
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_ERROR_CELL = re.compile(r"#(N/A|N/?V|[A-Z/0]+[!?])(?!\w)", re.IGNORECASE)  # of a spreadsheet, at the begin of a row
LEFT_OUT = "Comment"  # last column of LabVIEW's files (.lvm), of which a row without comment has no cell
_CHUNK = 20_000  # rows that are converted at a time
_ENOUGH_ROWS = 3  # to judge the length of the last cell
_EXPONENT = re.compile(r"[0-9.,][eE][-+]?([0-9]*)$")
_ABSENT = 1 << 30  # for a length, where there is no cell or no exponent
_FEWEST_CELLS = 3  # of a row that a quoted cell of several lines may contain
_BEGIN = 4096  # number of bytes that show whether a file is text
_MOST = 0.8  # share of the upper bytes of UTF-16 that are zero, at least


def byte_order_mark(data: bytes) -> str:
    """Return the encoding that the first bytes of a file state; empty: no mark."""
    return next((name for mark, name in _MARKS if data.startswith(mark)), "")


def utf_16_without_mark(begin: bytes) -> str:
    """Return ``utf-16-le`` or ``utf-16-be`` if the first bytes of a file look like one of them; else empty."""
    for name, upper, lower in (("utf-16-le", begin[1::2], begin[::2]), ("utf-16-be", begin[::2], begin[1::2])):
        if upper.count(0) > _MOST * len(upper) and lower.count(0) < (1.0 - _MOST) * len(lower):
            return name
    return ""


def decode(data: bytes, encoding: str, where: str, *, growing: bool = False) -> str:
    """Return the text of a file. Raises DataFileError: the bytes are of another encoding; names the line.

    ``growing``: another program is still writing the file; its last line is left out until it has an end.
    """
    encoding = byte_order_mark(data) or encoding
    begin = data[:_BEGIN]
    if encoding == "utf-8" and b"\0" in (begin.rstrip(b"\0") or begin):  # zeros at the end: the recorder lost power
        expected = "text, or a Parquet, TDMS or MATLAB file"
        if wide := utf_16_without_mark(begin):
            expected = f"file: {{encoding: {wide}}} in the map, or text"
        raise DataFileError("holds zero bytes", where=where, expected=expected)
    try:
        if not growing:
            return data.decode(encoding)
        text = codecs.getincrementaldecoder(encoding)().decode(data)
        return text[: max(text.rfind("\n"), text.rfind("\r")) + 1]
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        what = f"byte {error.start} (0x{data[error.start]:02X}) is not {encoding}"
        expected = "the encoding in the map, such as file: {encoding: cp1252}"
        raise DataFileError(what, where=f"{where}, line {line}", expected=expected) from None
    except UnicodeError:
        raise DataFileError(f"is not {encoding}", where=where, expected="the encoding in the map") from None


def lines_of(text: str, comment: str, names_line: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that is neither empty nor a comment; line ends of any system.

    ``names_line``: number of the line of the names, which may follow the sign of a comment; None: unknown.
    """
    for number, line in enumerate(io.StringIO(text, newline=None), 1):
        is_comment = bool(comment) and line.startswith(comment) and not _ERROR_CELL.match(line)
        is_comment |= number == 1 and line.startswith("sep=")  # of Excel
        if is_comment and number == names_line:
            line, is_comment = line.removeprefix(comment), False  # noqa: PLW2901
        if line.strip() and not is_comment:
            yield number, line


def are_names(cells: list[str]) -> bool:
    """Return whether cells may be the names of columns: different texts, none of them a number or a missing value."""
    values = [cell for cell in cells if cell.lower() in MISSING or any(is_number(cell, sign) for sign in ".,")]
    return not values and 1 < len(cells) == len(set(cells))


def strip_trailing_empty_cells(cells: list[str]) -> list[str]:
    """Return the cells of a line without the empty ones that trailing separators produce."""
    return cells[: max((n for n, cell in enumerate(cells, 1) if cell), default=0)]


def names_fit(names: list[str], row: list[str]) -> bool:
    """Return whether a row of data has a cell for each name and no more; either may have separators at its end."""
    names = strip_trailing_empty_cells(names)
    least = len(names) - (names[-1:] == [LEFT_OUT])
    return 0 < len(strip_trailing_empty_cells(row)) <= len(names) and least <= len(row)


class TextTable(RawTable):
    """A text file with a row of names, and one row for each scan."""

    place_word = "line"
    decimal_hint = "; file: {decimal: ','} in the map if it has a decimal comma"

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
        if header_line is None and all(is_number(cell, layout.decimal) or not cell for cell in header):
            expected = "names, or file: {header_line: 0} in the map if there are no names, "
            expected += f"{{header_line: {number}}} if these are the names, or the line where they follow a '#'"
            raise DataFileError("holds numbers in place of names", where=f"{path}, line {number}", expected=expected)
        others = [word for word, sign in _OTHER_SEPARATORS.items() if len(header) == 1 and sign in header[0]]
        if others:
            self.hint = f"; file: {{separator: {others[0]}}} in the map if it separates the cells"
        if header_line == 0:
            self._refuse_skipped_names()
            header = [str(n + 1) for n in range(len(header))]
        header = strip_trailing_empty_cells(header) or header[:1]
        below = _units_below(units, len(header))
        columns = [
            Column(name, *stated_unit(name, "" if unit_in_name(name) else text))
            for name, text in zip(header, below, strict=True)
        ]
        super().__init__(path, columns)

    def _refuse_skipped_names(self) -> None:
        """Refuse a map without header that skips a line of names right above the data, as wide as they are.

        Of words between blanks, only units tell names from a sentence.
        """
        for (number, names), (line, row) in pairwise(self._rows(1)):
            if line >= self._data_line:
                names = strip_trailing_empty_cells(names)  # noqa: PLW2901
                known = are_names(names) and (self._layout.separator != "space" or any(map(unit_in_name, names)))
                if number < self._data_line and known and names_fit(names, row):
                    what, where = "holds names or units, which header_line: 0 skips", f"{self._where}, line {number}"
                    expected = f"the line of the names in the map, such as file: {{header_line: {number}}}"
                    raise DataFileError(what, where=where, expected=expected)
                return

    def _rows(self, first_line: int) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of every line that is neither empty nor a comment."""
        layout, number = self._layout, 0
        separator = SEPARATORS.get(layout.separator, layout.separator)

        def lines() -> Iterator[str]:
            nonlocal number
            for number, line in lines_of(self._text, layout.comment, layout.header_line):
                if number >= first_line:
                    yield " ".join(line.split()) if layout.separator == "space" else line

        reader = csv.reader(lines(), delimiter=separator, skipinitialspace=True, strict=True)
        first = 0  # lines before this row
        try:
            for cells in reader:
                if reader.line_num > first + 1:
                    self._refuse_swallowed_rows(cells, separator, number)
                first = reader.line_num
                yield number, [cell.strip() for cell in cells]
        except csv.Error as error:
            expected = "quotes in pairs, and the separator of the file in the map"
            raise DataFileError(str(error), where=f"{self._where}, line {number}", expected=expected) from None

    def _refuse_swallowed_rows(self, cells: list[str], separator: str, number: int) -> None:
        """Refuse a cell of several lines of which one has the separators of a row: a quote was left open."""
        width = sum(cell.count(separator) for cell in cells) + len(cells) - 1
        for line in (line for cell in cells if "\n" in cell for line in cell.splitlines()):
            if _FEWEST_CELLS <= len(cells) <= line.count(separator) + 1 <= width + 1:
                what, expected = "a quote opens before this line and closes in it, around whole rows", "quotes in pairs"
                raise DataFileError(what, where=f"{self._where}, line {number}", expected=expected)

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
        count, rows, least, least_exponent = len(self.columns), 0, _ABSENT, _ABSENT
        ended = self._text.endswith(("\n", "\r"))
        held: tuple[int, list[str]] | None = None
        for number, row in self._rows(self._data_line):
            if len(row) > count and any(row[count:]):
                expected = f"{count}, as in the header"
                if self._layout.separator == ",":
                    expected += "; numbers with decimal commas need another separator"
                raise DataFileError(f"there are {len(row)} cells", where=self.place(number), expected=expected)
            if held:
                length, exponent = _lengths(held[1][-1])
                rows, least, least_exponent = rows + 1, min(least, length), min(least_exponent, exponent)
                yield held[0], held[1] + [""] * (count - len(held[1]))
            held = None
            if len(row) < (count - 1 if self.columns[-1].name == LEFT_OUT else count):
                cells.incomplete.append((number, f"there are {len(row)} cells", f"{count}, as in the header"))
            else:
                held = number, row[:count]
        length, exponent = (_ABSENT, _ABSENT) if held is None else _lengths(held[1][-1])
        is_short = length < least or exponent < least_exponent < _ABSENT
        if held and not ended and rows >= _ENOUGH_ROWS and is_short:
            what = f"'{held[1][-1]}' at the end of the file is shorter than all cells above it"
            if length >= least:
                what = f"the exponent of '{held[1][-1]}' at the end of the file is shorter than those above it"
            cells.incomplete.append((held[0], what, "a whole line"))
        elif held:
            yield held[0], held[1] + [""] * (count - len(held[1]))


def _lengths(cell: str) -> tuple[int, int]:
    """Return the length of a cell, and the number of digits of its exponent, if it has one."""
    exponent = _EXPONENT.search(cell)
    return len(cell), len(exponent[1]) if exponent else _ABSENT


def _units_below(rows: list[list[str]], count: int) -> list[str]:
    """Return what the lines between header and data state as the unit of each column; empty: nothing.

    An unknown text counts in a line most of whose cells are known units.
    """
    units = [""] * count
    for row in rows:
        cells = [cell.strip("[]() ") for cell in row[:count]]
        known = [find_unit(cell) is not None for cell in cells]
        is_line_of_units = 2 * sum(known) > sum(map(bool, cells))
        for n, cell in enumerate(cells):
            if known[n] or is_line_of_units:
                units[n] = units[n] if find_unit(units[n]) else cell or units[n]
    return units
