"""Cells of the error budgets of the thesis: printed number, number of the model, reason of a difference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from posor_lab.thesis_data import last_digit, parse_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

_MARGIN = 1.0 + 1e-9


class Agreement(Enum):
    """Result of the comparison of a printed cell with the model."""

    AGREES = "agrees within rounding"
    EXPLAINED = "differs, explained"
    DIFFERS = "DIFFERS"
    NOT_LEGIBLE = "not legible"


@dataclass(frozen=True)
class Reason:
    """Why a printed cell differs from the model.

    Attributes:
        text: What the thesis did differently, as far as the numbers show.
        gives: The number that follows from doing so, in the unit of the cell.

    """

    text: str
    gives: float


@dataclass(frozen=True)
class Printed:
    """A printed number.

    Attributes:
        text: Its digits; ``nan``: not legible.
        last_digit: One unit of its last digit.

    """

    text: str
    last_digit: float

    @property
    def number(self) -> float:
        """The value; NaN: not legible."""
        return float(self.text)


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        table: Number of the table.
        row: The perturbation.
        column: The quantity that it affects.
        printed: The printed number.
        computed: The number of the model, in the same unit.
        input_rounding: Possible change of ``computed`` by the rounding of the printed perturbation.
        reason: Why the two differ; None: no reason is known.

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
        """Computed over printed; NaN if the cell is not legible or both are zero."""
        if self.printed.number == 0.0:
            return math.nan if self.computed == 0.0 else math.inf
        return self.computed / self.printed.number

    @property
    def agreement(self) -> Agreement:
        """Result of the comparison.

        A cell agrees if the rounding of the cell (half a unit of its last digit) and of the printed perturbation covers
        the difference. A reason explains a cell within a whole unit, because some printed digits are cut, not rounded.
        """
        printed, unit = self.printed.number, self.printed.last_digit
        if math.isnan(printed):
            return Agreement.NOT_LEGIBLE
        if abs(self.computed - printed) <= (0.5 * unit + self.input_rounding) * _MARGIN:
            return Agreement.AGREES
        if self.reason and abs(self.reason.gives - printed) <= (unit + self.input_rounding) * _MARGIN:
            return Agreement.EXPLAINED
        return Agreement.DIFFERS


@dataclass(frozen=True)
class BudgetTable:
    """A table of the thesis: number such as ``5.2``, title, and cells column by column."""

    number: str
    title: str
    cells: tuple[Cell, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in printed order."""
        return tuple(dict.fromkeys(cell.column for cell in self.cells))

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows, in printed order."""
        return tuple(dict.fromkeys(cell.row for cell in self.cells))

    @property
    def holds(self) -> bool:
        """Whether every difference is explained."""
        return all(cell.agreement is not Agreement.DIFFERS for cell in self.cells)

    def cell(self, row: str, column: str) -> Cell:
        """Return one cell."""
        return next(cell for cell in self.cells if (cell.row, cell.column) == (row, column))


def printed_cells(rows: Sequence[Mapping[str, str]], column: str, path: Path) -> list[Printed]:
    """Return a printed column; a bare 0 has the finest last digit of its column.

    Raises:
        DataFileError: A cell is not a number.

    """
    numbers = [parse_number(row, column, f"{path}, row {n}", "a number or nan") for n, row in enumerate(rows, start=1)]
    units = [last_digit(row[column]) for row in rows]
    return [
        Printed(row[column], min(units) if number == 0.0 else unit)
        for row, number, unit in zip(rows, numbers, units, strict=True)
    ]
