"""A row of the thesis table by its section and the beginning of its quantity."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posor_lab.thesis_table.thesis_row import ThesisRow


def find_row(rows: list[ThesisRow], section: str, beginning: str) -> ThesisRow:
    """Return the only row that matches."""
    (row,) = (row for row in rows if row.section == section and row.quantity.startswith(beginning))
    return row
