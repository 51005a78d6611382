"""Cells of the thesis' error budgets: what was printed, what the model gives, and why they differ where they do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from posor_estimator.errors import DataFileError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

_MARGIN = 1.0 + 1e-9


class Agreement(Enum):
    """How a printed cell and the model compare."""

    AGREES = "agrees within rounding"
    EXPLAINED = "differs, explained"
    DIFFERS = "DIFFERS"
    NOT_LEGIBLE = "not legible"


@dataclass(frozen=True)
class Reason:
    """Why a printed cell is another than the model's.

    Attributes:
        text: What was done differently, as far as the numbers tell.
        gives: The number that follows from doing so, in the cell's unit.

    """

    text: str
    gives: float


@dataclass(frozen=True)
class Printed:
    """A number as it was printed.

    Attributes:
        text: Its digits; ``nan`` where they are not legible.
        last_digit: One unit of its last digit.

    """

    text: str
    last_digit: float

    @property
    def number(self) -> float:
        """The number."""
        return float(self.text)


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        table: Number of the table.
        row: The perturbation.
        column: What it does something to.
        printed: As printed.
        computed: By the model, in the same unit.
        input_rounding: What rounding of the printed perturbation can make of ``computed``.
        reason: Why the two differ; nothing where they do not.

    """

    table: str
    row: str
    column: str
    printed: Printed
    computed: float
    input_rounding: float = 0.0
    reason: Reason | None = None

    @property
    def ratio(self) -> float:
        """Computed over printed; NaN where nothing is legible, or nothing printed and computed."""
        if self.printed.number == 0.0:
            return math.inf if self._off(self.computed) > 0.0 else math.nan
        return self.computed / self.printed.number

    def _off(self, number: float) -> float:
        return abs(number - self.printed.number)

    @property
    def agreement(self) -> Agreement:
        """How the two compare.

        They agree if rounding of the cell, to half a unit of its last digit, and of the printed perturbation can make
        one of the other. A reason explains if its number is within a whole unit, since printed digits are at times cut.
        """
        if math.isnan(self.printed.number):
            return Agreement.NOT_LEGIBLE
        if self._off(self.computed) <= (0.5 * self.printed.last_digit + self.input_rounding) * _MARGIN:
            return Agreement.AGREES
        if self.reason and self._off(self.reason.gives) <= (self.printed.last_digit + self.input_rounding) * _MARGIN:
            return Agreement.EXPLAINED
        return Agreement.DIFFERS


@dataclass(frozen=True)
class BudgetTable:
    """A table of the thesis, cell by cell.

    Attributes:
        number: Such as ``5.2``.
        title: What it is about.
        columns: Names of its columns.
        rows: Names of its rows, in print's order.
        cells: All cells.

    """

    number: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[str, ...]
    cells: tuple[Cell, ...]

    @property
    def holds(self) -> bool:
        """Whether every difference is explained."""
        return all(cell.agreement is not Agreement.DIFFERS for cell in self.cells)

    def cell(self, row: str, column: str) -> Cell:
        """Return one cell."""
        return next(cell for cell in self.cells if (cell.row, cell.column) == (row, column))


def printed_cells(rows: Sequence[Mapping[str, str]], column: str, path: Path) -> list[Printed]:
    """Return a column as printed. A bare 0 counts to the finest digit of its column.

    Raises:
        DataFileError: A cell is no number.

    """
    units = []
    for line, row in enumerate(rows, start=1):
        try:
            float(row[column])
        except ValueError:
            where = f"{path}, row {line}, column '{column}'"
            raise DataFileError(f"'{row[column]}' is no number", where=where, expected="a number or nan") from None
        units.append(last_digit(row[column]))
    return [
        Printed(row[column], min(units) if float(row[column]) == 0.0 else unit)
        for row, unit in zip(rows, units, strict=True)
    ]


def last_digit(text: str) -> float:
    """Return one unit of a number's last digit."""
    return 10.0 ** -len(text.partition(".")[2])
