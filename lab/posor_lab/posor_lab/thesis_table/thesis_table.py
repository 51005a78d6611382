"""The table of the thesis: all rows by section, as text and as JSON."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor_lab.thesis_data import data_path
from posor_lab.thesis_table.figure_data import draw_figures
from posor_lab.thesis_table.row_file import RowFile
from posor_lab.thesis_table.thesis_row import Agreement

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from posor.reporting.plot import Plot

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
    """Compute the rows and figures of a file.

    Raises:
        PosorError: The file is invalid, or a calculation fails.

    """
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
