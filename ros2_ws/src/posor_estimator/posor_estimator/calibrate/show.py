"""What a calibration found, as tables in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table as Shown

if TYPE_CHECKING:
    from rich.console import Console

    from posor_estimator.core.calibrate.compare import Comparison
    from posor_estimator.core.calibrate.explain import Explained
    from posor_estimator.core.calibrate.procedure import Outcome, Table

WIDTH = 118
MOST = 40
"""Lines of a table beyond which the rest is only counted, unless all are asked for."""


def show_table(table: Table, console: Console, *, every: bool = True) -> None:
    """Print one table."""
    drawn = Shown(title=escape(table.title), title_justify="left")
    numeric = [all(isinstance(row[index], int | float) for row in table.rows) for index in range(len(table.columns))]
    for column, unit, right in zip(table.columns, table.units, numeric, strict=True):
        head = escape(f"{column} [{unit}]" if unit else column)
        drawn.add_column(head, justify="right" if right else "left", overflow="fold")
    shown = table.rows if every else table.rows[:MOST]
    for row in shown:
        drawn.add_row(*(escape(number(cell)) for cell in row))
    console.print(drawn)
    if len(shown) < len(table.rows):
        console.print(f"... and {len(table.rows) - len(shown)} more (--all shows them)")


def number(cell: float | str) -> str:
    """Return a cell of a table as text, numbers to six digits."""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)


def show_outcome(outcome: Outcome, console: Console, *, every: bool) -> None:
    """Print the tables of a procedure, how well its fits fit, and what to know before trusting them."""
    console.print(escape(f"Method: {outcome.method}."))
    for table in outcome.tables:
        show_table(table, console, every=every)
    for what, fit in outcome.fits.items():
        console.print(
            escape(
                f"{what}: {len(fit.residuals)} residuals, {len(fit.names)} parameters; root of chi-square over "
                f"{fit.freedoms} degrees of freedom {fit.spread:.3f}, probability {fit.probability:.2g}; "
                f"{int(fit.outliers().sum())} outliers."
            )
        )
    for warning in outcome.warnings:
        console.print(escape(f"Note: {warning}"), style="yellow")


def show_comparison(comparison: Comparison, console: Console, *, every: bool) -> None:
    """Print how two calibrations differ."""
    if comparison.differences:
        of = "sigmas of the first, from which the second was fitted" if comparison.descended else "sigmas of both"
        drawn = Shown(title=f"Numbers that differ, in {of}", title_justify="left")
        for column in ("number", "unit", "first", "sigma", "second", "sigma", "difference / sigma"):
            text = column in {"number", "unit"}
            drawn.add_column(column, justify="left" if text else "right", overflow="fold", no_wrap=column == "number")
        shown = comparison.differences if every else comparison.differences[:MOST]
        for d in shown:
            cells = (d.name, d.unit, d.first, d.first_sigma, d.second, d.second_sigma)
            drawn.add_row(*(escape(number(cell)) for cell in cells), f"{d.sigmas:+.2f}")
        console.print(drawn)
        if len(shown) < len(comparison.differences):
            console.print(f"... and {len(comparison.differences) - len(shown)} more (--all shows them)")
    for sentence in comparison.others:
        console.print(escape(sentence))
    console.print(f"{len(comparison.differences)} of {comparison.compared} numbers differ.")


def show_explained(explained: Explained, console: Console, *, every: bool) -> None:
    """Print how well a calibration explains a recording."""
    show_table(explained.table, console, every=every)
    console.print(
        f"Residuals against the readings' noise alone: {explained.noise_ratio:.3f} (1: nothing but noise). "
        f"Largest drift that passes: {explained.limit:.2f} sigmas."
    )
    console.print(escape(explained.verdict), style="green" if explained.explains else "red")
