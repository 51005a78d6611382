# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of calibration as tables in a terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table as RichTable

from posor_calibration.drift_check import LARGEST_SIGMA
from posor_calibration.procedure import Table

if TYPE_CHECKING:
    from rich.console import Console

    from posor_calibration.calibration_comparison import Comparison
    from posor_calibration.drift_check import DriftCheck
    from posor_calibration.procedure import Outcome

WIDTH = 118
MAX_ROWS = 5  # rows of a table that are printed unless all are asked for


def print_table(table: Table, console: Console, *, every: bool = True) -> None:
    """Print a table."""
    drawn = RichTable(title=escape(table.title), title_justify="left")
    for index, (column, head) in enumerate(zip(table.columns, name_columns(table), strict=True)):
        numeric = all(isinstance(row[index], int | float) for row in table.rows)
        keep = column == "number"  # a key of the file that is to be copied
        drawn.add_column(escape(head), justify="right" if numeric else "left", overflow="fold", no_wrap=keep)
    shown = table.rows if every else table.rows[:MAX_ROWS]
    for row in shown:
        drawn.add_row(*(escape(format_cell(cell)) for cell in row))
    console.print(drawn)
    if len(shown) < len(table.rows):
        console.print(f"... and {len(table.rows) - len(shown)} more (--all shows them)")


def name_columns(table: Table) -> list[str]:
    """Return the headings of the columns with their units."""
    return [f"{column} [{unit}]" if unit else column for column, unit in zip(table.columns, table.units, strict=True)]


def format_cell(cell: float | str) -> str:
    """Return a cell of a table as text, numbers with six digits."""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)


def print_outcome(outcome: Outcome, console: Console) -> None:
    """Print the tables of a procedure, the quality of its fits, and its warnings."""
    console.print(escape(f"Method: {outcome.method}."))
    for table in outcome.tables:
        print_table(table, console)
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


def print_comparison(comparison: Comparison, console: Console, *, every: bool) -> None:
    """Print the differences of two calibrations; those without an uncertainty only if all are asked for."""
    shown = [d for d in comparison.differences if every or math.isfinite(d.sigmas)]
    if shown:
        unit = "sigmas of the first, from which the second was fitted" if comparison.descended else "sigmas of both"
        columns = ("number", "unit", "first", "sigma", "second", "sigma", "difference / sigma")
        rows = tuple(
            (d.name, d.unit, d.first, d.first_sigma, d.second, d.second_sigma, f"{d.sigmas:+.2f}") for d in shown
        )
        table = Table(f"Numbers that differ, in {unit}", columns, ("",) * len(columns), rows)
        print_table(table, console, every=every)
    for sentence in comparison.others:
        console.print(escape(sentence))
    console.print(f"{len(comparison.differences)} of {comparison.compared} numbers differ.")
    left_out = len(comparison.differences) - len(shown)
    if left_out:
        whose = "in the first" if comparison.descended else "in both"
        console.print(
            f"Left out: {left_out} that have no uncertainty {whose}, so no sigma to compare with (--all shows them)."
        )


def print_drift_check(check: DriftCheck, console: Console, *, every: bool) -> None:
    """Print whether a calibration explains a recording."""
    print_table(check.table, console, every=every)
    if check.below_noise:
        console.print(
            f"Of {check.below_noise} parameters only large drifts would show: this recording sees them less well than "
            f"to {LARGEST_SIGMA:g} stated sigmas."
        )
    console.print(
        f"Residuals against the readings' noise alone: {check.noise_ratio:.3f} (1: only noise). "
        f"Largest drift that passes: {check.limit:.2f} sigmas."
    )
    console.print(escape(check.verdict), style="green" if check.explains else "red")
