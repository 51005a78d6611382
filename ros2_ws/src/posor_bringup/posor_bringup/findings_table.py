"""Prints the comparison at the end of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from posor_bringup.comparison import Verdict

if TYPE_CHECKING:
    from rich.console import Console

    from posor_bringup.comparison import Comparison, Finding

_STYLES = {Verdict.HOLDS: "green", Verdict.FAILS: "bold red", Verdict.SHOWN: "dim"}


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print every finding: a table in a terminal, else one line each."""
    if not console.is_terminal:
        for finding in comparison.findings:
            console.print(_line(finding), soft_wrap=True, markup=False, highlight=False)
        return
    table = Table(title="comparison with the thesis", header_style="bold")
    for name in ("quantity", "replay", "thesis", "limit", "source", "verdict"):
        table.add_column(name, overflow="fold")
    for finding in comparison.findings:
        style = _STYLES[finding.verdict]
        table.add_row(
            finding.what,
            finding.computed,
            finding.stated,
            finding.limit,
            finding.source,
            f"[{style}]{finding.verdict.value}[/]",
        )
    console.print(table)


def _line(finding: Finding) -> str:
    parts = [
        f"{finding.verdict.value:<10}  {finding.what}: {finding.computed}",
        finding.limit and f"limit {finding.limit}",
        finding.stated and f"thesis {finding.stated}",
        finding.source,
        finding.remark,
    ]
    return "; ".join(part for part in parts if part)
