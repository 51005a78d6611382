"""A table of a report, with the same cells on a console and on a page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.table import Table

from posor.reporting.html_page import Section, paragraph, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from posor.reporting.plot import Plot


@dataclass(frozen=True)
class ReportTable:
    """A table."""

    title: str  # on a console
    header: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells of each row
    note: str = ""  # meaning of the table, for the page; empty: none
    left: int | None = None  # number of columns, from the first on, that are flush left on a console; None: all
    rule_before: int | None = None  # number of the row that a console separates from the rows before; None: no row

    def print(self, console: Console) -> None:
        """Print the table."""
        printed = Table(title=self.title, title_justify="left")
        for number, name in enumerate(self.header):
            flush_left = self.left is None or number < self.left
            printed.add_column(name, justify="left" if flush_left else "right", overflow="fold")
        for number, row in enumerate(self.rows):
            if number == self.rule_before:
                printed.add_section()
            printed.add_row(*row)
        console.print(printed)

    def section(self, heading: str, plots: Sequence[Plot] = ()) -> Section:
        """Return the part of a page with the table, and its note below it."""
        body = table(self.header, self.rows)
        return Section(heading, body + paragraph(self.note) if self.note else body, plots)
