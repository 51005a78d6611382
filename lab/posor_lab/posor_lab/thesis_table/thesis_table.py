"""The table of the thesis: all rows by section, as text and as JSON."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor_lab.thesis_table.thesis_row import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.reporting.plot import Plot

    from posor_lab.thesis_table.thesis_row import ThesisRow

SUBJECTS = {
    "structure_rows": "Robot structures: chapters 1, 2 and 9",
    "sensor_rows": "Sensors and interferometers: chapters 3, 4, 5 and 7",
    "budget_rows": "Error budgets: chapters 5 and 7",
    "beam_rows": "Measuring beams: chapter 6",
    "gimbal_rows": "Gimbals: chapters 6 and 7",
    "air_bearing_rows": "Aerostatic bearings: chapters 6 and 7",
    "bearing_rows": "Ball bearings: chapter 6",
    "stage_rows": "Stages and setups: chapters 7 and 8",
    "motion_test_rows": "Motion tests: chapter 8",
    "arm_rows": "Arms: chapter 9",
}
"""Subject of each module of rows; a module has the functions ``rows`` and ``plots``."""
_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class Subject:
    """The rows of one subject by section, and its figures."""

    title: str
    rows: tuple[ThesisRow, ...]
    plots: tuple[Plot, ...]


def compute_subjects() -> list[Subject]:
    """Compute all rows and figures.

    Raises:
        PosorError: A calculation fails.

    """
    subjects = []
    for name, title in SUBJECTS.items():
        module = import_module(f"posor_lab.thesis_table.{name}")
        subjects.append(Subject(title, tuple(sorted(module.rows(), key=_order)), tuple(module.plots())))
    return subjects


def all_rows(subjects: Iterable[Subject]) -> list[ThesisRow]:
    """Return the rows of all subjects by section, appendices after the sections of their chapter."""
    return sorted((row for subject in subjects for row in subject.rows), key=_order)


def _order(row: ThesisRow) -> tuple[int, bool, list[int]]:
    """Return the place of a row: chapter, sections before appendices, numbers of the section."""
    numbers = [int(digits) for digits in _DIGITS.findall(row.section)]
    return numbers[0], row.section.startswith("App"), numbers


def summary(rows: Iterable[ThesisRow]) -> str:
    """Return one sentence on how many rows agree."""
    number = Counter(row.verdict for row in rows)
    return (
        f"{number.total()} rows: {number[Verdict.AGREES]} agree within 2 % or rounding, {number[Verdict.DIFFERS]} "
        f"differ for the reason stated, {number[Verdict.NOT_LEGIBLE]} are not legible in print."
    )


def format_cells(row: ThesisRow) -> tuple[str, ...]:
    """Return a row as text: section, quantity, printed and computed number, unit, difference, verdict, reason."""
    return (
        row.section,
        row.quantity,
        row.printed,
        f"{row.computed:.5g}",
        "" if row.unit == "1" else row.unit,
        _format_difference(row),
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
                "reason": row.reason,
            }
            for row in rows
        ]
    }
