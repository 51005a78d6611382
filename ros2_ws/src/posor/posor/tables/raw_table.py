# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A table as its file has it: named columns of numbers or texts, and the place of each row."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.errors import DataFileError
from posor.tables.number_text import OVERLOAD, parse_number

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray, IntArray
    from posor.tables.table_units import Unit

MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
"""Texts of a cell without a value, in lower case."""


class Column(NamedTuple):
    """A column: its name, its unit, the time from row to row and that of the first row, where the file states them."""

    name: str
    unit: Unit | None = None
    unknown_unit: str = ""
    """What the file states in place of a unit that is known."""
    interval_s: float | None = None
    begin: str = ""


class InvalidCell(NamedTuple):
    """A cell that is no number: row and column from 0, and its text."""

    row: int
    column: int
    text: str


@dataclass
class Cells:
    """The columns of a table that were asked for, r rows."""

    places: IntArray  # number of the line or row in the file, (r,)
    numbers: dict[int, FloatArray] = field(default_factory=dict)  # by column, (r,); NaN: missing or invalid
    values: dict[int, NDArray[Any]] = field(default_factory=dict)  # by column, as in the file, (r,)
    invalid: list[InvalidCell] = field(default_factory=list)
    incomplete: list[tuple[int, str, str]] = field(default_factory=list)  # rows not whole: place, what, expected

    @property
    def positions(self) -> IntArray:
        """Position of each row in the table, that of the first is 0, (r,); rows that are not whole count."""
        left_out = np.array([place for place, _, _ in self.incomplete], dtype=np.int64)
        return np.arange(len(self.places)) + np.searchsorted(np.sort(left_out), self.places)


class RawTable(ABC):
    """A file with a table."""

    place_word = "row"
    hint = ""
    """What may make a column missing, for errors."""
    decimal_hint = ""
    """What makes a decimal comma a number, for errors."""

    def __init__(self, path: Path, columns: Sequence[Column]) -> None:
        """Store the columns that the file has."""
        self.path = path
        self.columns = tuple(column._replace(name=" ".join(column.name.split())) for column in columns)
        if not self.columns:
            raise DataFileError("holds no columns", where=str(path), expected="columns of numbers with equal lengths")

    @abstractmethod
    def read(self, numbers: Collection[int], values: Collection[int]) -> Cells:
        """Return columns as numbers, and columns as the file has them.

        Raises:
            DataFileError: The file cannot be read, or its columns have different lengths.

        """

    def index(self, column: str | int, where: str) -> int:
        """Return the index of a column by its name, or by its number from 1; ``where``: names the entry of the map.

        Raises:
            DataFileError: The column is missing, or several have this name.

        """
        names = [each.name for each in self.columns]
        if isinstance(column, int):
            if column <= len(names):
                return column - 1
            raise DataFileError(
                f"column {column} of {where} is missing", where=str(self.path), expected=f"1 to {len(names)}"
            )
        found = [n for n, name in enumerate(names) if name == " ".join(column.split())]
        if not found:
            expected = f"one of {', '.join(repr(name[:_LONGEST_NAME]) for name in names)}{self.hint}"
            raise DataFileError(f"column '{column}' of {where} is missing", where=str(self.path), expected=expected)
        if len(found) > 1:
            numbers = " and ".join(str(n + 1) for n in found)
            what = f"column '{column}' of {where} occurs {len(found)} times"
            raise DataFileError(what, where=str(self.path), expected=f"its number, {numbers.replace(' and ', ' or ')}")
        return found[0]

    def place(self, row: int, column: int | None = None) -> str:
        """Return the place of a cell, or of a row, for errors; ``row``: its number in the file."""
        name = "" if column is None else f", column '{self.columns[column].name}'"
        return f"{self.path}, {self.place_word} {row}{name}"


class ArrayTable(RawTable):
    """A table whose columns are arrays already."""

    def __init__(self, path: Path, columns: Sequence[tuple[Column, NDArray[Any]]], *, note: str = "") -> None:
        """Store the columns; ``note``: what is incomplete in the file."""
        super().__init__(path, [column for column, _ in columns])
        self._arrays, self._note = [array for _, array in columns], note

    def read(self, numbers: Collection[int], values: Collection[int]) -> Cells:
        """Return the columns."""
        wanted = {n: self._arrays[n] for n in sorted({*numbers, *values})}
        self._check_times([self.columns[n] for n in wanted])
        count = min(map(len, wanted.values()), default=0)
        for n, array in wanted.items():
            if len(array) != count and not self._note:
                shortest = next(each for each in wanted if len(wanted[each]) == count)
                what = f"column '{self.columns[n].name}' has {len(array)} rows"
                expected = f"{count}, as column '{self.columns[shortest].name}'"
                raise DataFileError(what, where=str(self.path), expected=expected)
        cells = Cells(places=np.arange(1, count + 1))
        if self._note:
            cells.incomplete.append((count, self._note, "a whole file"))
        for n in numbers:
            array = wanted[n][:count]
            if array.dtype.kind in "biuf":
                column = array.astype(np.float64)
                wrong = np.abs(column) >= OVERLOAD
                cells.invalid += [InvalidCell(int(row), n, f"{column[row]:g}") for row in np.flatnonzero(wrong)]
                column[wrong] = np.nan
            else:
                column = parse_numbers(["" if cell is None else str(cell) for cell in array.tolist()], ".", n, 0, cells)
            cells.numbers[n] = column
        cells.values |= {n: wanted[n][:count] for n in values}
        return cells

    def _check_times(self, columns: Sequence[Column]) -> None:
        """Raise DataFileError: the rows of two columns are of different times, by what the file states."""
        timed = [column for column in columns if column.begin]
        for column in timed[1:]:
            first = timed[0]
            if column.begin != first.begin:
                what = f"column '{column.name}' begins at {column.begin}"
                expected = f"{first.begin}, as column '{first.name}': columns that were sampled together"
                raise DataFileError(what, where=str(self.path), expected=expected)


def parse_numbers(texts: Sequence[str], decimal: str, column: int, first_row: int, cells: Cells) -> FloatArray:
    """Return the numbers of a column's cells, (r,); NaN: missing, or invalid and added to ``cells``."""
    joined = "\n".join(texts)
    is_plain = joined.isascii() and "_" not in joined and joined.count("\n") == len(texts) - 1
    if is_plain and (decimal == "." or "." not in joined):
        try:
            parsed = np.array(joined.replace(",", ".").split("\n") if decimal == "," else texts, dtype=np.float64)
        except ValueError:
            pass
        else:
            if (np.abs(parsed) < OVERLOAD).all():
                return parsed
    numbers = np.full(len(texts), np.nan)
    for n, text in enumerate(texts):
        cell = text.strip()
        if cell.lower() in MISSING:
            continue
        plain = cell.replace(",", ".") if decimal == "," and "." not in cell else "" if decimal == "," else cell
        if decimal == "," and cell.lstrip("+-").isdigit():
            plain = cell
        try:
            number = parse_number(plain)
        except ValueError:
            number = math.nan
        if abs(number) < OVERLOAD:
            numbers[n] = number
        else:
            cells.invalid.append(InvalidCell(first_row + n, column, text))
    return numbers


def is_number(cell: str, decimal: str) -> bool:
    """Return whether the text of a cell is a number."""
    return bool(np.isfinite(parse_numbers([cell], decimal, 0, 0, Cells(np.empty(0, dtype=np.int64)))[0]))


_LONGEST_NAME = 80
