"""An error budget as a self-contained HTML page with interactive plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.reporting.figure_style import BLUE, GREY, ORANGE
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page
from posor.reporting.plot import Plot
from posor.uncertainty.first_order import ContributionKind

from posor_design.budget_report import DISPLAY_UNITS

if TYPE_CHECKING:
    from posor_design.budget_report import BudgetReport

BARS = 8  # number of contributions drawn for each output
COLOURS = {ContributionKind.RANDOM: ORANGE, ContributionKind.SYSTEMATIC: BLUE}
NAMES = {ContributionKind.RANDOM: "noise (random)", ContributionKind.SYSTEMATIC: "calibration (systematic)"}

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


def plot_contributions(report: BudgetReport) -> list[Plot]:
    """Return a plot for each output: its largest contributions as bars, and its totals."""
    plots = []
    for i, output in enumerate(report.budget.outputs):
        scale, unit = DISPLAY_UNITS[output.unit]
        total, drawn = scale * report.budget.sigmas[i], scale * report.drawn.sigmas[i]
        largest = sorted(report.budget.contributions, key=lambda part: part.effects[i], reverse=True)[:BARS]
        title, label = f"{output.name}: {total:.3g} {unit}", f"standard uncertainty [{unit}]"
        plot = Plot(title, label, "quantity", categories=[part.name for part in largest])
        for kind, colour in COLOURS.items():
            parts = [part for part in largest if part.kind is kind]
            if parts:
                plot.bars(
                    NAMES[kind], [scale * part.effects[i] for part in parts], [part.name for part in parts], colour
                )
        plot.vertical(f"total, first order {total:.3g}", total)
        plot.vertical(f"total, draws {drawn:.3g}", drawn, GREY, "dotted")
        plots.append(plot)
    return plots


def render_budget_page(report: BudgetReport) -> str:
    """Return the page as HTML without external references."""
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
        sections=(
            report.contributions().section("What to improve first", plot_contributions(report)),
            report.validation(remarks=True).section("First order against draws"),
            *(table.section(table.title) for table in report.reliability_tables()),
            Section("Notes", bullet_list(notes)),
            Section("Provenance", definition_list(terms) + paragraph("Figures in SI units: budget.csv, budget.json.")),
        ),
    )
