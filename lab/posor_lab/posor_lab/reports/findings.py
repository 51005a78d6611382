# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings of a run: each figure with its limit and verdict, printed in the terminal and shown on a page."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from posor.reporting.html_page import Cell, table
from posor.reporting.program_errors import reports_errors
from rich.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from markupsafe import Markup
    from rich.console import Console


@reports_errors
def exit_code_of_findings(program: Callable[[], Findings]) -> int:
    """Run ``program``; return 0 if its findings hold, 1 if not, or write a PosorError and return its exit code."""
    return int(not program().holds)


class Verdict(Enum):
    """Whether a figure is within its limit."""

    HOLDS = "holds"
    FAILS = "FAILS"
    NOT_JUDGED = "not judged"

    @staticmethod
    def of(*, holds: bool) -> Verdict:
        """Return the verdict on a judged figure."""
        return Verdict.HOLDS if holds else Verdict.FAILS


FIGURE_HEADINGS: Mapping[str, str] = {"computed": "figure", "limit": "limit"}
"""Headings for findings that are compared with their limits only."""
COMPARISON_HEADINGS: Mapping[str, str] = {  # headings for findings that are compared with expected values
    "computed": "found",
    "stated": "expected",
    "limit": "must be",
    "source": "source",
}
_CSS_CLASSES = {Verdict.HOLDS: "holds", Verdict.FAILS: "fails", Verdict.NOT_JUDGED: ""}
_STYLES = {Verdict.HOLDS: "green", Verdict.FAILS: "bold red", Verdict.NOT_JUDGED: "dim"}


@dataclass(frozen=True)
class Finding:
    """One figure as printable text."""

    quantity: str  # name of the figure
    computed: str  # value that the run gave
    stated: str = ""  # value to compare with: from the thesis, or predicted
    limit: str = ""  # range in which the figure holds; empty if it is not judged
    source: str = ""  # source of ``stated``
    verdict: Verdict = Verdict.NOT_JUDGED  # whether the figure holds
    remark: str = ""  # sample size, reason of the limit or of a surprising value
    if_fails: str = ""  # meaning of a failure

    @staticmethod
    def judged(quantity: str, computed: str, limit: str, *, holds: bool, **texts: str) -> Finding:
        """Return a figure with its limit and verdict; ``texts``: other fields."""
        return Finding(quantity, computed, limit=limit, verdict=Verdict.of(holds=holds), **texts)

    @staticmethod
    def none_of(quantity: str, count: int, **texts: str) -> Finding:
        """Return a count that must be 0."""
        return Finding.judged(quantity, f"{count}", "0", holds=count == 0, **texts)

    @property
    def comment(self) -> str:
        """The remark, and the meaning of a failure."""
        return "; ".join(filter(None, [self.remark, self.if_fails if self.verdict is Verdict.FAILS else ""]))


@dataclass(frozen=True)
class Findings:
    """All figures of a run."""

    findings: tuple[Finding, ...]

    @property
    def holds(self) -> bool:
        """Whether at least one figure was judged and none fails."""
        verdicts = {finding.verdict for finding in self.findings}
        return Verdict.FAILS not in verdicts and Verdict.HOLDS in verdicts

    @property
    def sentence(self) -> str:
        """The verdict on all figures."""
        return "Everything holds." if self.holds else "Not everything holds."


def judge(texts: Mapping[str, str], *, holds: bool | None = None, **values: object) -> Finding:
    """Return a finding whose texts are templates, by field, that values fill; ``holds``: None, it is not judged."""
    fields: dict[str, Any] = {field: text.format_map(values) for field, text in texts.items()}
    return Finding(**fields, verdict=Verdict.NOT_JUDGED if holds is None else Verdict.of(holds=holds))


def findings_table(findings: Findings, headings: Mapping[str, str]) -> Markup:
    """Return the findings as an HTML table.

    ``headings`` of the columns between quantity and verdict, by attribute of ``Finding``.
    """
    rows = [
        (
            finding.quantity,
            *(getattr(finding, attribute) for attribute in headings),
            finding.comment,
            Cell(finding.verdict.value, _CSS_CLASSES[finding.verdict]),
        )
        for finding in findings.findings
    ]
    return table(("quantity", *headings.values(), "remark", "verdict"), rows)


def print_findings(findings: Findings, console: Console, title: str, headings: Mapping[str, str]) -> None:
    """Print the findings: a table in a terminal, else one line for each finding, with its remark."""
    if not console.is_terminal:
        for finding in findings.findings:
            console.print(_format_line(finding, headings), soft_wrap=True, markup=False, highlight=False)
        return
    terminal_table = Table(title=title, header_style="bold")
    for name in ("quantity", *headings.values(), "verdict"):
        terminal_table.add_column(name, overflow="fold")
    for finding in findings.findings:
        verdict = f"[{_STYLES[finding.verdict]}]{finding.verdict.value}[/]"
        terminal_table.add_row(finding.quantity, *(getattr(finding, attribute) for attribute in headings), verdict)
    console.print(terminal_table)


def print_verdict(findings: Findings, console: Console) -> None:
    """Print the verdict on all figures."""
    console.print(findings.sentence, style="green" if findings.holds else "bold red")


def _format_line(finding: Finding, headings: Mapping[str, str]) -> str:
    """Return a finding as one line; empty attributes are left out."""
    parts = [f"{finding.verdict.value:<10}  {finding.quantity}: {finding.computed}"]
    for attribute, heading in headings.items():
        text = getattr(finding, attribute)
        if text and attribute != "computed":
            parts.append(text if attribute == "source" else f"{heading} {text}")
    return "; ".join([*parts, *filter(None, [finding.comment])])
