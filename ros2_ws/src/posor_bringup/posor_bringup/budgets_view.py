"""The thesis' error budgets beside the model's, as tables in a terminal and as JSON."""

from __future__ import annotations

import math
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from rich.table import Table

from posor_bringup.budget_cells import Agreement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from posor_bringup.budget_cells import BudgetTable, Cell

_STYLES = {Agreement.AGREES: "", Agreement.EXPLAINED: "yellow", Agreement.DIFFERS: "bold red"}
_SMALL = 5e-7
"""A factor below this is nothing: what the lean of the plate leaves of one that is zero."""


def print_table(table: BudgetTable, console: Console) -> None:
    """Print a table, cell by cell: model, thesis, their ratio; cells that differ with the letter of their reason."""
    marks: dict[str, str] = {}
    shown = Table(title=f"Table {table.number}: {table.title}", title_justify="left")
    shown.add_column("perturbation", overflow="fold")
    for column in table.columns:
        shown.add_column(f"{column}\nmodel / thesis = ratio", justify="right")
    for row in table.rows:
        shown.add_row(row, *(_cell(table.cell(row, column), marks) for column in table.columns))
    console.print(shown)
    for text, mark in marks.items():
        console.print(f"  {mark}) {text}", markup=False)


def _cell(cell: Cell, marks: dict[str, str]) -> str:
    computed = "0" if abs(cell.computed) < _SMALL else f"{cell.computed:.4g}"
    if cell.agreement is Agreement.NOT_LEGIBLE:
        return f"{computed} / not legible"
    ratio = f" = {cell.ratio:.3f}" if math.isfinite(cell.ratio) else ""
    text = f"{computed} / {cell.printed.text}{ratio}"
    if cell.agreement is Agreement.AGREES:
        return text
    mark = "no reason found"
    if cell.agreement is Agreement.EXPLAINED and cell.reason is not None:
        mark = marks.setdefault(cell.reason.text, ascii_lowercase[len(marks)])
    return f"[{_STYLES[cell.agreement]}]{text} {mark})[/]"


def summary(tables: Sequence[BudgetTable]) -> str:
    """Return one sentence on how many cells agree."""
    cells = [cell for table in tables for cell in table.cells]
    number = {agreement: sum(cell.agreement is agreement for cell in cells) for agreement in Agreement}
    return (
        f"{len(cells)} cells: {number[Agreement.AGREES]} agree within rounding, {number[Agreement.EXPLAINED]} differ "
        f"for a reason that gives the printed number, {number[Agreement.DIFFERS]} differ without one, "
        f"{number[Agreement.NOT_LEGIBLE]} not legible."
    )


def as_json(tables: Sequence[BudgetTable]) -> list[dict[str, Any]]:
    """Return every cell by name; ``ratio`` is null where nothing was printed, or zero."""
    return [
        {
            "table": table.number,
            "row": row,
            "column": column,
            "computed": cell.computed,
            "printed": _finite(cell.printed.number),
            "ratio": _finite(cell.ratio),
            "agreement": cell.agreement.value,
            "note": cell.reason.text if cell.reason and cell.agreement is Agreement.EXPLAINED else "",
            "reason_gives": cell.reason.gives if cell.reason and cell.agreement is Agreement.EXPLAINED else None,
        }
        for table in tables
        for row in table.rows
        for column in table.columns
        for cell in (table.cell(row, column),)
    ]


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None
