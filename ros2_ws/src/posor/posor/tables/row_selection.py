# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which rows of a table are read: those that are whole and later than the ones before them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import DataFileError
from posor.tables.table_time import EXAMPLE, INVALID_NS, MISSING_NS

if TYPE_CHECKING:
    from posor.numerics.array_types import BoolArray, IntArray
    from posor.tables.raw_table import Cells, RawTable
    from posor.tables.table_map import TableMap

_LONGEST_TEXT = 60  # of a cell in an error
_GROUPS = re.compile(r"[-+]?\d{1,3}([.,'\u2019\s]\d{3})+([.,]\d*)?")  # of digits


@dataclass
class RowSelection:
    """The rows of a table that are read; every kind of the others is refused, or counted if the map says so."""

    table: RawTable
    map: TableMap
    cells: Cells
    stamps: IntArray  # of the rows [ns], MISSING_NS or INVALID_NS, (r,)
    time_columns: list[int]
    left_out: Counter[str] = field(default_factory=Counter)  # number of rows by kind

    def select(self, required: set[int], numeric: set[int]) -> BoolArray:
        """Return which rows are read (r,); ``required``: columns without missing cells; ``numeric``: of numbers.

        Raises DataFileError: a row is not whole, and the map does not say that such rows are left out.
        """
        self.keep: BoolArray = np.ones(len(self.cells.places), dtype=np.bool_)
        self._refuse_incomplete()
        self._refuse_invalid(numeric)
        self._refuse_invalid_times()
        self._refuse_missing(required)
        self._refuse_times_back()
        if not self.keep.any():
            expected = "rows with a number in every mapped column"
            raise DataFileError("no row is whole", where=str(self.table.path), expected=expected)
        return self.keep

    def _refuse(self, kind: str, where: str, what: str, expected: str, count: int) -> None:
        if kind not in self.map.leave_out:
            more = f" (and {count - 1} more)" if count > 1 else ""
            raise DataFileError(f"{what}{more}", where=where, expected=f"{expected}, or leave_out: [{kind}] in the map")
        self.left_out[kind] += count

    def _place(self, row: int, column: int | None) -> str:
        return self.table.place(int(self.cells.places[row]), column)

    def _refuse_incomplete(self) -> None:
        if self.cells.incomplete:
            place, what, expected = self.cells.incomplete[0]
            count = len(self.cells.incomplete)
            self._refuse("incomplete_rows", self.table.place(place), what, expected, count)

    def _refuse_invalid(self, numeric: set[int]) -> None:
        invalid = sorted(cell for cell in self.cells.invalid if cell.column in numeric)
        if not invalid:
            return
        names = [column.name for column in self.table.columns]
        for other in invalid:
            if (text := " ".join(other.text.split())) in names and text != names[other.column]:
                what, expected = f"another column, '{text}', begins", "one header; a file for each order of the columns"
                raise DataFileError(what, where=self._place(other.row, other.column), expected=expected)
        cell, rows = invalid[0], sorted({each.row for each in invalid})
        expected = "a number"
        if _GROUPS.fullmatch(cell.text.strip()):
            expected += " without separators of thousands"
        if self.map.file.decimal == "." and "," in cell.text and "." not in cell.text:
            expected += f" with a decimal point{self.table.decimal_hint}"
        self._refuse(
            "invalid_cells",
            self._place(cell.row, cell.column),
            f"'{_short(cell.text)}' is invalid",
            expected,
            len(rows),
        )
        self.keep[rows] = False

    def _refuse_invalid_times(self) -> None:
        wrong, time = self.keep & (self.stamps == INVALID_NS), self.map.time
        if not wrong.any():
            return
        row = int(np.flatnonzero(wrong)[0])
        text = _short(" ".join(str(self.cells.values[n][row]) for n in self.time_columns))
        expected = EXAMPLE if time.format == "iso" else f"a time in the form '{time.format}'"
        if time.unit:
            expected = "a number from the start on"
        what = f"'{text}' is no time from 1970 to 2038"
        self._refuse("invalid_cells", self._place(row, self.time_columns[-1]), what, expected, int(wrong.sum()))
        self.keep &= ~wrong

    def _refuse_missing(self, required: set[int]) -> None:
        columns = {n: np.isnan(self.cells.numbers[n]) for n in sorted(required)}
        missing = self.keep & np.logical_or.reduce([self.stamps == MISSING_NS, *columns.values()])
        if not missing.any():
            return
        row = int(np.flatnonzero(missing)[0])
        column = next((n for n, of_column in columns.items() if of_column[row]), (self.time_columns or [0])[0])
        self._refuse("missing_cells", self._place(row, column), "the cell has no value", "a number", int(missing.sum()))
        self.keep &= ~missing

    def _refuse_times_back(self) -> None:
        rows = np.flatnonzero(self.keep)
        times = self.stamps[rows]
        latest = np.maximum.accumulate(times)[:-1]
        back = np.concatenate([[False], times[1:] <= latest])[: len(rows)]
        if not back.any():
            return
        n = int(np.flatnonzero(back)[0])
        step_ns, expected = int(latest[n - 1] - times[n]), "times that increase"
        what = f"the time goes back by {step_ns / 1e9:g} s"
        if step_ns == 0:
            what = "the time is that of the row before"
            expected += "; a column with too few digits needs rate in its place"
        where = self._place(int(rows[n]), self.time_columns[0] if self.time_columns else None)
        self._refuse("time_back", where, what, expected, int(back.sum()))
        self.keep[rows[back]] = False


def _short(text: str) -> str:
    """Return the text of a cell in one line."""
    return " ".join(text.split())[:_LONGEST_TEXT]
