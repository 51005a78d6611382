# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""thesis: printed numbers of the thesis beside the computed ones, row by row, with the figures redrawn.

Exit code 0: every row has been computed, whether or not it agrees.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.html_page import Cell, Section, render_page
from posor.reporting.html_page import table as html_table
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import report_console
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from posor_lab.lab_output import check_writable, write_json
from posor_lab.thesis_data import data_path
from posor_lab.thesis_table.figure_data import draw_figures
from posor_lab.thesis_table.row_file import RowFile
from posor_lab.thesis_table.thesis_row import Agreement

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from posor.reporting.plot import Plot
    from rich.console import Console

    from posor_lab.thesis_table.thesis_row import ThesisRow

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Subject:
    """The rows of one subject by section, and its figures."""

    title: str
    rows: tuple[ThesisRow, ...]
    plots: tuple[Plot, ...]


def row_files() -> list[Path]:
    """Return the files of rows, one for each subject, in their order."""
    return sorted(data_path("thesis_rows").glob("*.yaml"))


def compute_subject(path: Path) -> Subject:
    """Compute the rows and figures of a file. Raises PosorError: the file is invalid, or a calculation fails."""
    file = RowFile(path)
    subject = Subject(file.title, tuple(sorted(file.rows(), key=_order)), tuple(draw_figures(file)))
    file.check_unused()
    return subject


def all_rows(subjects: Iterable[Subject]) -> list[ThesisRow]:
    """Return the rows of all subjects by section, appendices after the sections of their chapter."""
    return sorted((row for subject in subjects for row in subject.rows), key=_order)


def _order(row: ThesisRow) -> tuple[int, bool, list[int]]:
    """Return the place of a row: chapter, sections before appendices, numbers of the section."""
    numbers = [int(digits) for digits in _DIGITS.findall(row.section)]
    return numbers[0], row.section.startswith("App"), numbers


def summary(rows: Iterable[ThesisRow]) -> str:
    """Return two sentences: how many rows agree, and of which kinds these are."""
    rows = list(rows)
    number = Counter(row.verdict for row in rows)
    kinds = Counter(row.kind_name for row in rows if row.verdict is Agreement.AGREES)
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    return (
        f"{number.total()} rows: {number[Agreement.AGREES]} agree within 2 % or rounding, {number[Agreement.DIFFERS]} "
        f"differ for the reason stated, {number[Agreement.NOT_LEGIBLE]} are not legible in print. "
        f"Of the rows that agree by their kind: {counts}."
    )


def format_cells(row: ThesisRow) -> tuple[str, ...]:
    """Return a row as text: section, quantity, printed, computed, unit, difference, kind, verdict, reason."""
    return (
        row.section,
        row.quantity,
        row.printed,
        f"{row.computed:.5g}",
        "" if row.unit == "1" else row.unit,
        _format_difference(row),
        row.kind_name,
        row.verdict.value,
        row.reason,
    )


def _format_difference(row: ThesisRow) -> str:
    if row.difference is None:
        return ""
    if row.printed_number:
        return f"{100.0 * row.difference / abs(row.printed_number):+.1f} %"
    return f"{row.difference:+.2g}"


def json_content(rows: Iterable[ThesisRow]) -> dict[str, Any]:
    """Return the rows for JSON; a number that is not legible and its difference are null."""
    return {
        "rows": [
            {
                "section": row.section,
                "quantity": row.quantity,
                "unit": row.unit,
                "printed": row.printed_number,
                "computed": row.computed,
                "difference": row.difference,
                "verdict": row.verdict.value,
                "kind": row.kind_name,
                "reason": row.reason,
            }
            for row in rows
        ]
    }


_TITLE = "The thesis of 1985 beside this project"
HEADER = ("section", "quantity", "printed", "computed", "unit", "difference", "verdict")
_WIDE = {"quantity", "verdict"}
_NUMBERS = {"printed", "computed", "difference"}
_STYLES = {Agreement.AGREES: "", Agreement.DIFFERS: "yellow", Agreement.NOT_LEGIBLE: "dim"}
_CSS_CLASSES = {Agreement.AGREES: "holds", Agreement.DIFFERS: "fails", Agreement.NOT_LEGIBLE: ""}


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="thesis", description="Printed numbers of the thesis beside the computed ones.")
    parser.add_argument(
        "--output", type=Path, default=Path("build/thesis.json"), help="JSON file; the page is beside it"
    )
    output = check_writable(parser.parse_args(arguments).output)
    page = check_writable(output.with_suffix(".html"))
    if page == output:
        parser.error(f"--output {output}: the page has this name")
    subjects = [compute_subject(path) for path in row_files()]
    rows = all_rows(subjects)
    console = report_console(150)
    print_rows(rows, console)
    console.print(summary(rows))
    write_json(output, json_content(rows))
    page.write_text(render_thesis_page(subjects, rows), encoding="utf-8")
    print(f"page written to {page}")
    return 0


def print_rows(rows: Sequence[ThesisRow], console: Console) -> None:
    """Print all rows as one table; a reason is not repeated from row to row."""
    shown = Table(title=_TITLE, title_justify="left", box=SIMPLE_HEAD)
    for name in HEADER:
        if name in _WIDE:
            shown.add_column(name, ratio=1)
        else:
            shown.add_column(name, justify="right" if name in _NUMBERS else "left", no_wrap=True)
    reason = ""
    for row in rows:
        repeated = row.reason and row.reason == reason
        reason = row.reason
        *cells, _, verdict, why = map(escape, format_cells(replace(row, reason="as above") if repeated else row))
        shown.add_row(*cells, ": ".join(filter(None, (verdict, why))), style=_STYLES[row.verdict])
    console.print(shown)


def render_thesis_page(subjects: Sequence[Subject], rows: Sequence[ThesisRow]) -> str:
    """Return the page: for each subject its figures and its rows."""
    sections = [
        Section(subject.title, html_table((*HEADER, "reason", "kind"), map(_page_cells, subject.rows)), subject.plots)
        for subject in subjects
    ]
    return render_page(_TITLE, summary(rows), holds=True, sections=sections)


def _page_cells(row: ThesisRow) -> tuple[str | Cell, ...]:
    *cells, kind, verdict, reason = format_cells(row)
    return *cells, Cell(verdict, _CSS_CLASSES[row.verdict]), reason, kind
