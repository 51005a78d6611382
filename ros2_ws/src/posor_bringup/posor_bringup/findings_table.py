"""Prints the findings at the end of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from posor_bringup.findings import Verdict

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console

    from posor_bringup.findings import Finding, Findings

_STYLES = {Verdict.HOLDS: "green", Verdict.FAILS: "bold red", Verdict.SHOWN: "dim"}


def print_findings(findings: Findings, console: Console, title: str, headings: Mapping[str, str]) -> None:
    """Print every finding, a table in a terminal, else one line each with its remark.

    Args:
        findings: What to print.
        console: Where.
        title: Above the table.
        headings: What the columns between the quantity and the verdict are called, by attribute of ``Finding``.

    """
    if not console.is_terminal:
        for finding in findings.findings:
            console.print(_line(finding, headings), soft_wrap=True, markup=False, highlight=False)
        return
    table = Table(title=title, header_style="bold")
    for name in ("quantity", *headings.values(), "verdict"):
        table.add_column(name, overflow="fold")
    for finding in findings.findings:
        style = _STYLES[finding.verdict]
        shown = [getattr(finding, attribute) for attribute in headings]
        table.add_row(finding.what, *shown, f"[{style}]{finding.verdict.value}[/]")
    console.print(table)


def _line(finding: Finding, headings: Mapping[str, str]) -> str:
    parts = [f"{finding.verdict.value:<10}  {finding.what}: {finding.computed}"]
    for attribute, heading in headings.items():
        text = getattr(finding, attribute)
        if text and attribute != "computed":
            parts.append(text if attribute == "source" else f"{heading} {text}")
    return "; ".join([*parts, *filter(None, [finding.remark])])
