"""A budget as tables in a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from posor_estimator.budget.told import heading, number
from posor_estimator.core.budget.first_order import Kind
from posor_estimator.core.budget.validation import COVERAGE

if TYPE_CHECKING:
    from rich.console import Console

    from posor_estimator.budget.told import ToldBudget
    from posor_estimator.core.types import FloatArray

LEAST_SHARE = 0.01
"""Contributions with no larger share in any judged quantity are summed up in one line."""
NEGLIGIBLE = 1e-4
"""Share below which a contribution to one quantity is not shown."""


def print_budget(told: ToldBudget, console: Console) -> None:
    """Print contributions, totals, and the test by draws."""
    console.print(f"Error budget of '{told.calibration}'{f', session {told.session}' if told.session else ''}")
    console.print(f"at {told.pose}; standard uncertainties, k = 1")
    console.print(_contributions(told))
    console.print(_validations(told))
    console.print(told.verdict)
    if told.together:
        console.print(told.together)
    if told.budget.unstated:
        console.print(f"Taken as exact, no uncertainty is stated: {', '.join(told.budget.unstated)}.")
    if told.drawn.lost:
        console.print(f"{told.drawn.lost} of {told.drawn.trials + told.drawn.lost} draws gave no pose.")


def rows_of(told: ToldBudget) -> list[tuple[str, str, list[str]]]:
    """Return rows of name, kind and cells: the contributions, what is left, the totals."""
    budget = told.budget
    shares = budget.shares()

    def line(effects: FloatArray, of_total: FloatArray | None = None) -> list[str]:
        cells = [number(effect, output) for effect, output in zip(effects, budget.outputs, strict=True)]
        if of_total is None:
            return cells
        return [
            "-" if share < NEGLIGIBLE else f"{cell} {100.0 * share:3.0f} %"
            for cell, share in zip(cells, of_total, strict=True)
        ]

    rows = []
    small = []
    for part, share in zip(budget.contributions, shares, strict=True):
        if share.max() < LEAST_SHARE:
            small.append((part.effects, share))
        else:
            rows.append((part.name, str(part.kind), line(part.effects, share)))
    if small:
        effects = np.sqrt(np.sum([np.square(effect) for effect, _ in small], axis=0))
        rows.append((f"{len(small)} more, each below 1 %", "", line(effects, np.sum([s for _, s in small], axis=0))))
    rows.extend((f"all {kind}", str(kind), line(budget.root_sum_square(kind))) for kind in Kind)
    rows.append(("root sum square", "total", line(budget.root_sum_square())))
    rows.append(("full covariance", "total", line(budget.sigmas)))
    rows.append((f"Monte Carlo, {told.drawn.trials} draws", "total", line(told.drawn.sigmas)))
    return rows


def _contributions(told: ToldBudget) -> Table:
    table = Table(title="What to improve first: uncertainty and share of the variance", title_justify="left")
    table.add_column("quantity", overflow="fold")
    table.add_column("kind")
    for output in told.budget.outputs:
        table.add_column(heading(output), justify="right")
    for name, kind, cells in rows_of(told):
        if name == f"all {Kind.RANDOM}":
            table.add_section()
        table.add_row(name, kind, *cells)
    return table


def validation_rows(told: ToldBudget) -> list[list[str]]:
    """Return, for each judged quantity, tolerance, distances of the two intervals' ends, whether stable, verdict."""
    return [
        [
            heading(output),
            *(number(value, output) for value in (one.tolerance, one.low, one.high)),
            "yes" if one.stable else "not yet",
            "holds" if one.holds else "differs",
        ]
        for output, one in zip(told.budget.outputs, told.validations, strict=True)
    ]


VALIDATION_HEADER = ("quantity", "numerical tolerance", "d low", "d high", "stable", "first order")


def _validations(told: ToldBudget) -> Table:
    table = Table(
        title=f"First order against draws: ends of the {100 * COVERAGE:g} % intervals (JCGM 101, clause 8)",
        title_justify="left",
    )
    for name in VALIDATION_HEADER:
        table.add_column(name, justify="left" if name == "quantity" else "right")
    for row in validation_rows(told):
        table.add_row(*row)
    return table
