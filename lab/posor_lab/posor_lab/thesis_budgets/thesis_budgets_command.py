# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""budgets: the error budgets of the thesis, tables 5.2, 5.4, 7.9 and 7.12, cell by cell from the measurement model.

Exit code 0 only if every difference to a printed cell is explained.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import product
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import report_console
from rich.table import Table

from posor_lab.lab_output import parse_study, write_json
from posor_lab.thesis_budgets.budget_tables import DIODE_TOTAL, budget_tables, fits_of_linearisation, rig_theta
from posor_lab.thesis_table.thesis_row import Agreement

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console

    from posor_lab.thesis_budgets.budget_tables import BudgetCell, BudgetTable

_STYLES = {Agreement.EXPLAINED: "yellow", Agreement.DIFFERS: "bold red"}
_ZERO = 5e-7  # smaller factors are printed as 0: they come from the inclination of the plate


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="budgets", description="Error budgets of the thesis, cell by cell from the model.")
    output = parse_study(parser, "build/budgets.json", arguments).output
    tables = budget_tables()
    by_x, by_y, theta = rig_theta(tables["7.9"])
    derived = {
        "linearisation_of_7_9_and_7_7_uin": fits_of_linearisation(),
        "rig_theta_by_x_rad_per_in": by_x,
        "rig_theta_by_y_rad_per_in": by_y,
        "rig_theta_total_urad": theta,
    }
    console = report_console(150)
    for table in tables.values():
        print_table(table, console)
    printed = tables["7.9"].cell(DIODE_TOTAL, "induced_sigma_theta_urad").printed
    console.print(
        f"Derived, not printed: the rig has its spots apart along Y, so that theta goes by X ({by_x:.3f} rad/in) and "
        f"hardly by Y ({by_y:.3f}); the rows of table 7.9 then make {theta:.0f} urad, not {printed}."
    )
    console.print(summary(tables.values()))
    cells = [
        _cell_content(table.cell(*name)) for table in tables.values() for name in product(table.rows, table.columns)
    ]
    write_json(output, {"cells": cells, "derived": derived})
    return 0 if all(table.holds for table in tables.values()) else 1


def print_table(table: BudgetTable, console: Console) -> None:
    """Print model, thesis and ratio of each cell; a letter leads to the reason of a difference."""
    letters: dict[str, str] = {}
    shown = Table(title=f"Table {table.number}: {table.title}", title_justify="left")
    shown.add_column("perturbation", overflow="fold")
    for column in table.columns:
        shown.add_column(f"{column}\nmodel / thesis = ratio", justify="right")
    for row in table.rows:
        shown.add_row(row, *(_format_cell(table.cell(row, column), letters) for column in table.columns))
    console.print(shown)
    for text, letter in letters.items():
        console.print(f"  {letter}) {text}", markup=False)


def _format_cell(cell: BudgetCell, letters: dict[str, str]) -> str:
    computed = "0" if abs(cell.computed) < _ZERO else f"{cell.computed:.4g}"
    if cell.agreement is Agreement.NOT_LEGIBLE:
        return f"{computed} / not legible"
    ratio = f" = {cell.ratio:.3f}" if math.isfinite(cell.ratio) else ""
    text = f"{computed} / {cell.printed}{ratio}"
    if cell.agreement is Agreement.AGREES:
        return text
    mark = "no reason found"
    if cell.agreement is Agreement.EXPLAINED:
        mark = letters.setdefault(cell.reason, ascii_lowercase[len(letters)])
    return f"[{_STYLES[cell.agreement]}]{text} {mark})[/]"


def summary(tables: Iterable[BudgetTable]) -> str:
    """Return one sentence on how many cells agree."""
    number = Counter(cell.agreement for table in tables for cell in table.cells)
    return (
        f"{number.total()} cells: {number[Agreement.AGREES]} agree within rounding, {number[Agreement.EXPLAINED]} "
        f"differ for a reason that gives the printed number, {number[Agreement.DIFFERS]} differ without one, "
        f"{number[Agreement.NOT_LEGIBLE]} not legible."
    )


def _cell_content(cell: BudgetCell) -> dict[str, Any]:
    """Return a cell for JSON; ``ratio`` is null if the printed number is zero or not legible."""
    explained = cell.agreement is Agreement.EXPLAINED
    return {
        "table": cell.table,
        "row": cell.row,
        "column": cell.column,
        "computed": cell.computed,
        "printed": cell.printed_number if math.isfinite(cell.printed_number) else None,
        "ratio": cell.ratio if math.isfinite(cell.ratio) else None,
        "agreement": cell.agreement.value,
        "note": cell.reason if explained else "",
        "reason_gives": cell.gives if explained else None,
    }
