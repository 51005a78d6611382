# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A table of a report, with the same cells on a console and on a page; the console of programs that print one."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from posor.reporting.html_page import Section, paragraph, table
from posor.reporting.number_columns import align_numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.reporting.plot import Plot


def report_console(width: int) -> Console:
    """Return a console on standard output, as wide as the terminal, elsewhere of ``width`` columns."""
    return Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else width)


@dataclass(frozen=True)
class ReportTable:
    """A table."""

    title: str  # on a console
    header: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells of each row
    note: str = ""  # meaning of the table, for the page; empty: none
    rule_before: int | None = None  # number of the row that a console separates from the rows before; None: no row

    def print(self, console: Console) -> None:
        """Print the table."""
        columns = [list(cells) for cells in zip(*self.rows, strict=True)]
        aligned = [align_numbers(cells) for cells in columns] or [None] * len(self.header)
        printed = Table(title=self.title, title_justify="left")
        for name, numbers in zip(self.header, aligned, strict=True):
            printed.add_column(name, justify="right" if numbers else "left", overflow="fold")
        shown = [numbers or cells for numbers, cells in zip(aligned, columns, strict=bool(columns))]
        for number, row in enumerate(zip(*shown, strict=True)):
            if number == self.rule_before:
                printed.add_section()
            printed.add_row(*row)
        console.print(printed)

    def section(self, heading: str, plots: Sequence[Plot] = ()) -> Section:
        """Return the part of a page with the table, and its note below it."""
        body = table(self.header, self.rows)
        return Section(heading, body + paragraph(self.note) if self.note else body, plots)
