"""Rows of the thesis table for the error budgets, tables 5.2, 5.4, 7.9 and 7.12: one for each cell with an effect."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from posor_lab.thesis_budgets.budget_cells import Agreement
from posor_lab.thesis_budgets.diode_tables import table_5_4, table_7_9
from posor_lab.thesis_budgets.probe_tables import table_5_2, table_7_12
from posor_lab.thesis_table.thesis_row import ThesisRow, Verdict

if TYPE_CHECKING:
    from posor.reporting.plot import Plot

    from posor_lab.thesis_budgets.budget_cells import Cell, Printed

_UNITS = ("uin", "urad")
_DISTANCES = {"l_0_0": "the distance at (0, 0) in", "l_m1_1p5": "the distance at (-1, 1.5) in"}


def rows() -> list[ThesisRow]:
    """Return the cells of the budgets, without those of perturbations that have no effect, in print and in the model.

    Raises:
        DataFileError: A printed table cannot be read.

    """
    tables = (table_5_2(), table_5_4(), table_7_9(), table_7_12())
    return [
        _row(cell) for table in tables for cell in table.cells if cell.printed.number != 0.0 or cell.computed != 0.0
    ]


def plots() -> list[Plot]:
    """Return no figure: the thesis draws none of its budgets."""
    return []


def _row(cell: Cell) -> ThesisRow:
    """Return a cell as a row; factors of tables 5.2 and 5.4 are in inch and radian."""
    name, _, unit = cell.column.rpartition("_")
    column, unit = (name, unit) if unit in _UNITS else (cell.column, "in, rad")
    column = column.removeprefix("induced_").removeprefix("sigma_")
    row = ThesisRow(
        f"Table {cell.table}",
        f"{cell.row}, effect on {_DISTANCES.get(column, column)}",
        unit,
        _digits(cell.printed),
        cell.computed,
        _reason(cell),
    )
    needs_reason = row.verdict is not Verdict.AGREES or cell.agreement is not Agreement.AGREES
    return replace(row, reason=row.reason if needs_reason else "", input_rounding=cell.input_rounding)


def _digits(printed: Printed) -> str:
    """Return the printed digits; a bare 0 gets the digits of its column."""
    if math.isnan(printed.number):
        return ""
    return printed.text if printed.number else f"{0.0:.{max(0, round(-math.log10(printed.last_digit)))}f}"


def _reason(cell: Cell) -> str:
    """Return why a cell differs, as far as the comparison of the budgets knows."""
    match cell.agreement:
        case Agreement.NOT_LEGIBLE:
            return "not legible in the scan"
        case Agreement.EXPLAINED if cell.reason:
            return f"{cell.reason.text}: {cell.reason.gives:.4g}"
        case Agreement.AGREES:
            return "within the rounding of the cell and of the printed perturbation"
        case _:
            return "no reason is known"
