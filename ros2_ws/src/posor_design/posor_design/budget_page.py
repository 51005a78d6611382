"""An error budget as a self-contained HTML page with interactive plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.reporting.figure_style import BLUE, GREY, ORANGE
from posor.reporting.html_page import (
    Section,
    bullet_list,
    definition_list,
    paragraph,
    render_page,
    table,
)
from posor.reporting.plot import Plot
from posor.uncertainty.first_order import ContributionKind

from posor_design.budget_report import DISPLAY_UNITS, VALIDATION_HEADER, heading
from posor_design.reliability_report import (
    ARM_HEADER,
    RELIABILITY_HEADER,
    arm_rows,
    protection_note,
    reliability_note,
    reliability_rows,
)

if TYPE_CHECKING:
    from markupsafe import Markup

    from posor_design.budget_report import BudgetReport

BARS = 8
"""Number of contributions drawn for each output."""
COLOURS = {ContributionKind.RANDOM: ORANGE, ContributionKind.SYSTEMATIC: BLUE}
NAMES = {ContributionKind.RANDOM: "noise (random)", ContributionKind.SYSTEMATIC: "calibration (systematic)"}

DIFFERS = "the model is not linear over this uncertainty: use the interval of the draws, interval_95 in budget.json"
NOT_STABLE = "too few draws for this tolerance: use more, --draws"
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
        sections=(
            Section("What to improve first", table(header, rows), plot_contributions(report)),
            Section("First order against draws", _validation_table(report)),
            *_reliability_sections(report),
            Section("Notes", bullet_list(notes)),
            Section("Provenance", definition_list(terms) + paragraph("Figures in SI units: budget.csv, budget.json.")),
        ),
    )


def _validation_table(report: BudgetReport) -> Markup:
    """Return the validation, with the reason and the remedy beside each output that does not hold or is not stable."""
    rows = [
        [*row, "; ".join(filter(None, ["" if each.holds else DIFFERS, "" if each.stable else NOT_STABLE]))]
        for row, each in zip(report.validation_rows(), report.validations, strict=True)
    ]
    return table((*VALIDATION_HEADER, "remark"), rows)


def _reliability_sections(report: BudgetReport) -> list[Section]:
    body = table(RELIABILITY_HEADER, reliability_rows(report.reliability))
    sections = [Section("Minimal detectable biases", body + paragraph(reliability_note(report.reliability)))]
    if report.arm is not None:
        body = table(ARM_HEADER, arm_rows(report.arm)) + paragraph(protection_note(report.arm))
        sections.append(Section("Protection level of the endpoint", body))
    return sections
