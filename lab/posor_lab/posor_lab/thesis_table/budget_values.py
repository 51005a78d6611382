"""Cells of the error budgets, tables 5.2, 5.4, 7.9 and 7.12, for the file of rows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_lab.thesis_budgets.budget_cells import Agreement
from posor_lab.thesis_budgets.diode_tables import table_5_4, table_7_9
from posor_lab.thesis_budgets.probe_tables import table_5_2, table_7_12
from posor_lab.thesis_table.thesis_row import ThesisRow, Verdict

if TYPE_CHECKING:
    from posor_lab.thesis_budgets.budget_cells import Cell, Printed

_UNITS = ("uin", "urad")
_DISTANCES = {"l_0_0": "the distance at (0, 0) in", "l_m1_1p5": "the distance at (-1, 1.5) in"}


def budget_cells() -> list[dict[str, Any]]:
    """Return the cells without those of perturbations that have no effect, in print and in the model.

    Raises:
        DataFileError: A printed table cannot be read.

    """
    tables = (table_5_2(), table_5_4(), table_7_9(), table_7_12())
    cells = [cell for table in tables for cell in table.cells]
    return [_columns(cell) for cell in cells if cell.printed.number != 0.0 or cell.computed != 0.0]


def _columns(cell: Cell) -> dict[str, Any]:
    name, _, unit = cell.column.rpartition("_")
    column, unit = (name, unit) if unit in _UNITS else (cell.column, "in, rad")
    column = column.removeprefix("induced_").removeprefix("sigma_")
    return {
        "table": cell.table,
        "row": cell.row,
        "column": _DISTANCES.get(column, column),
        "unit": unit,
        "printed": _digits(cell.printed),
        "computed": cell.computed,
        "rounding": cell.input_rounding,
        "reason": _reason(cell),
    }


def _digits(printed: Printed) -> str:
    """Return the printed digits; a bare 0 gets the digits of its column."""
    if math.isnan(printed.number):
        return ""
    return printed.text if printed.number else f"{0.0:.{max(0, round(-math.log10(printed.last_digit)))}f}"


def _reason(cell: Cell) -> str:
    """Return why a cell differs, or that only the rounding of the perturbation makes it agree."""
    if cell.agreement is Agreement.NOT_LEGIBLE:
        return "not legible in the scan"
    if cell.agreement is Agreement.EXPLAINED and cell.reason:
        return f"{cell.reason.text}: {cell.reason.gives:.4g}"
    if cell.agreement is Agreement.DIFFERS:
        return "no reason is known"
    row = ThesisRow("", "", "", _digits(cell.printed), cell.computed)
    if row.verdict is Verdict.AGREES:
        return ""
    return "within the rounding of the cell and of the printed perturbation"
