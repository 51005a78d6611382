"""A budget as one self-contained page with charts."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from posor_estimator.budget.tables import VALIDATION_HEADER, rows_of, validation_rows
from posor_estimator.budget.told import SCALES, heading
from posor_estimator.core.budget.first_order import Kind
from posor_estimator.reporting.document import (
    Picture,
    Section,
    cells,
    document,
    notes_list,
    table,
    terms_list,
)
from posor_estimator.reporting.drawing import BLUE, GREY, ORANGE, png, tidy

if TYPE_CHECKING:
    from posor_estimator.budget.told import ToldBudget

BARS = 8
"""Largest contributions drawn for each judged quantity."""
COLOURS = {Kind.RANDOM: ORANGE, Kind.SYSTEMATIC: BLUE}
COLUMNS = 3

NOTES = (
    "Standard uncertainties, k = 1, of first order: the measurement model's own derivatives (JCGM 100, 5.1 and 5.2).",
    (
        "Random: noise of a reading, new in every scan. Systematic: what is calibrated, the same in all scans until "
        "the next calibration. Shares are of the summed variances."
    ),
    (
        "Draws: raw readings with noise, and calibrated numbers, drawn as normal; the estimator solves each draw "
        "(JCGM 101). The first order is valid where the ends of both 95 % intervals agree within half a unit of the "
        "uncertainty's first significant digit (clause 8), and the draws have settled to a fifth of that."
    ),
)


def draw(told: ToldBudget) -> bytes:
    """Return a picture (PNG): for each judged quantity its largest contributions as bars, and the total."""
    outputs = told.budget.outputs
    lines = -(-len(outputs) // COLUMNS)
    figure = Figure(figsize=(15.0, 3.6 * lines), layout="constrained")
    all_axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for axes in all_axes[len(outputs) :]:
        axes.set_visible(False)
    for i, (axes, output) in enumerate(zip(all_axes, outputs, strict=False)):
        scale, unit = SCALES[output.unit]
        largest = sorted(told.budget.contributions, key=lambda part: part.effects[i], reverse=True)[:BARS]
        axes.barh(
            [part.name for part in largest],
            [scale * part.effects[i] for part in largest],
            color=[COLOURS[part.kind] for part in largest],
        )
        axes.axvline(scale * told.budget.sigmas[i], color=GREY, lw=1.2, ls="--")
        axes.axvline(scale * told.drawn.sigmas[i], color=GREY, lw=1.2, ls=":")
        axes.invert_yaxis()
        axes.set_title(f"{output.name}: {scale * told.budget.sigmas[i]:.3g} {unit}", fontsize=11)
        axes.tick_params(axis="y", labelsize=8)
        axes.set_xlabel(unit, fontsize=9)
        tidy(axes)
    figure.suptitle("blue: calibrated, orange: noise; dashed: total of first order, dotted: total of the draws")
    return png(figure)


def page(told: ToldBudget) -> str:
    """Return the page; it refers to nothing outside itself."""
    header = ("quantity", "kind", *(heading(output) for output in told.budget.outputs))
    rows = [cells([name, kind, *line]) for name, kind, line in rows_of(told)]
    notes = list(NOTES)
    if told.together:
        notes.append(told.together)
    if told.budget.unstated:
        notes.append(f"Taken as exact, since no uncertainty is stated: {', '.join(told.budget.unstated)}.")
    terms = {
        "calibration": f"{told.calibration} (SHA-256 of its content {told.content_hash})",
        "session": told.session or "none",
        "pose": told.pose,
        "draws": f"{told.drawn.trials} used, {told.drawn.lost} without a pose, seed {told.seed}",
    }
    return document(
        f"Error budget of {told.calibration}",
        told.verdict,
        holds=told.holds,
        picture=Picture(draw(told), "Bars: the largest contributions to each judged quantity"),
        sections=(
            Section("What to improve first", table(header, rows)),
            Section(
                "First order against draws",
                table(VALIDATION_HEADER, [cells(row) for row in validation_rows(told)]),
            ),
            Section("Notes", notes_list(notes)),
            Section(
                "Provenance", terms_list(terms) + f"<p>{escape('Figures in SI units: budget.csv, budget.json.')}</p>"
            ),
        ),
    )
