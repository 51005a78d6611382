"""thesis: what the thesis prints beside what this project computes, row by row, with the figures redrawn.

Exit code 0: every row has been computed, whether or not it agrees.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.html_page import Cell, Section, render_page
from posor.reporting.html_page import table as html_table
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_console import report_console
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from posor_lab.output_files import check_writable, write_json
from posor_lab.thesis_table.thesis_row import Agreement
from posor_lab.thesis_table.thesis_table import (
    all_rows,
    compute_subject,
    format_cells,
    json_content,
    row_files,
    summary,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from posor_lab.thesis_table.thesis_row import ThesisRow
    from posor_lab.thesis_table.thesis_table import Subject

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


if __name__ == "__main__":
    sys.exit(main())
