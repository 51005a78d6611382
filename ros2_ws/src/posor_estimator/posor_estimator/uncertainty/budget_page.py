"""An error budget as a self-contained HTML page with charts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from posor_estimator.reporting.figure_style import BLUE, GREY, ORANGE, style_axes, to_png
from posor_estimator.reporting.html_page import (
    Section,
    bullet_list,
    definition_list,
    image,
    paragraph,
    render_page,
    table,
)
from posor_estimator.uncertainty.budget_report import DISPLAY_UNITS, VALIDATION_HEADER, heading
from posor_estimator.uncertainty.first_order import Kind
from posor_estimator.uncertainty.reliability_report import (
    ARM_HEADER,
    RELIABILITY_HEADER,
    arm_rows,
    protection_note,
    reliability_note,
    reliability_rows,
)

if TYPE_CHECKING:
    from posor_estimator.uncertainty.budget_report import BudgetReport

BARS = 8
"""Number of contributions drawn for each output."""
COLOURS = {Kind.RANDOM: ORANGE, Kind.SYSTEMATIC: BLUE}
COLUMNS = 3

NOTES = (
    "Standard uncertainties, k = 1, of first order: derivatives of the measurement model (JCGM 100, 5.1 and 5.2).",
    (
        "Random: noise of a reading, new in every scan. Systematic: a calibrated quantity, the same in all scans until "
        "the next calibration. Shares are of the summed variances."
    ),
    (
        "Draws: reading noise and calibrated values from normal distributions; the estimator solves each draw (JCGM "
        "101). The first order is valid if the ends of both 95 % intervals agree within half a unit of the first "
        "significant digit of the uncertainty (clause 8), and the draws are stable to a fifth of that."
    ),
)


def draw_contributions(report: BudgetReport) -> bytes:
    """Return a figure (PNG): the largest contributions to each output as bars, and its total."""
    outputs = report.budget.outputs
    lines = -(-len(outputs) // COLUMNS)
    figure = Figure(figsize=(15.0, 3.6 * lines), layout="constrained")
    all_axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for axes in all_axes[len(outputs) :]:
        axes.set_visible(False)
    for i, (axes, output) in enumerate(zip(all_axes, outputs, strict=False)):
        scale, unit = DISPLAY_UNITS[output.unit]
        largest = sorted(report.budget.contributions, key=lambda part: part.effects[i], reverse=True)[:BARS]
        axes.barh(
            [part.name for part in largest],
            [scale * part.effects[i] for part in largest],
            color=[COLOURS[part.kind] for part in largest],
        )
        axes.axvline(scale * report.budget.sigmas[i], color=GREY, lw=1.2, ls="--")
        axes.axvline(scale * report.drawn.sigmas[i], color=GREY, lw=1.2, ls=":")
        axes.invert_yaxis()
        axes.set_title(f"{output.name}: {scale * report.budget.sigmas[i]:.3g} {unit}", fontsize=11)
        axes.tick_params(axis="y", labelsize=8)
        axes.set_xlabel(unit, fontsize=9)
        style_axes(axes)
    figure.suptitle("blue: calibrated, orange: noise; dashed: total of first order, dotted: total of the draws")
    return to_png(figure)


def render_budget_page(report: BudgetReport) -> str:
    """Return the page as HTML without external references."""
    header = ("quantity", "kind", *(heading(output) for output in report.budget.outputs))
    rows = [[name, kind, *line] for name, kind, line in report.contribution_rows()]
    notes = [note for note in (*NOTES, report.correlation_note, report.exact_note) if note]
    terms = {
        "calibration": f"{report.calibration} (SHA-256 of its content {report.content_hash})",
        "session": report.session or "none",
        "pose": report.pose_text,
        "draws": f"{report.drawn.trials} used, {report.drawn.lost} without a pose, seed {report.seed}",
    }
    return render_page(
        f"Error budget of {report.calibration}",
        report.verdict,
        holds=report.holds,
        picture=image(draw_contributions(report), "Bars: the largest contributions to each output"),
        sections=(
            Section("What to improve first", table(header, rows)),
            Section(
                "First order against draws",
                table(VALIDATION_HEADER, report.validation_rows()),
            ),
            *_reliability_sections(report),
            Section("Notes", bullet_list(notes)),
            Section("Provenance", definition_list(terms) + paragraph("Figures in SI units: budget.csv, budget.json.")),
        ),
    )


def _reliability_sections(report: BudgetReport) -> list[Section]:
    body = table(RELIABILITY_HEADER, reliability_rows(report.reliability))
    sections = [Section("Minimal detectable biases", body + paragraph(reliability_note(report.reliability)))]
    if report.arm is not None:
        body = table(ARM_HEADER, arm_rows(report.arm)) + paragraph(protection_note(report.arm))
        sections.append(Section("Protection level of the endpoint", body))
    return sections
