"""Tells a replay of 1985 as a page: the comparison with the thesis, the steps, where everything comes from."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from posor_bringup.document import Picture, Section, cells, document, findings_table, notes_list, table, terms_list
from posor_bringup.live_table import COLUMNS, LEGEND
from posor_bringup.live_table import cells as step_cells

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_bringup.findings import Findings
    from posor_bringup.motion import MotionTest

HEADINGS: Mapping[str, str] = {
    "computed": "replay",
    "stated": "thesis",
    "limit": "limit",
    "source": "source",
}
"""What the columns of the comparison are called."""


@dataclass(frozen=True)
class Report:
    """What the page tells.

    Attributes:
        title: Heading.
        test: The steps.
        comparison: The figures.
        picture: The curves (PNG).
        provenance: What was replayed with what: term and text.
        notes: What a reader has to know to judge the figures.

    """

    title: str
    test: MotionTest
    comparison: Findings
    picture: bytes
    provenance: Mapping[str, str]
    notes: Sequence[str]


def page(report: Report) -> str:
    """Return the page; it refers to nothing outside itself."""
    holds = report.comparison.holds
    first = report.test.steps[0]
    steps = table(
        ("step", *COLUMNS, "status"), [cells(step_cells(step, first)) for step in report.test.steps], "numbers"
    )
    return document(
        report.title,
        "The comparison holds." if holds else "The comparison does not hold.",
        holds=holds,
        picture=Picture(report.picture, "Curves of the replayed test: angles, errors and endpoint by step"),
        sections=(
            Section("Comparison", findings_table(report.comparison, HEADINGS)),
            Section("Steps", f"<p>{escape(LEGEND)}. All values were received over ROS.</p>\n{steps}"),
            Section("Notes", notes_list(report.notes)),
            Section("Provenance", terms_list(report.provenance)),
        ),
    )
