# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of an error budget in words, tables, CSV and JSON, and as a self-contained page with interactive plots."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.model.native_coordinates import native_from_rotation
from posor.reporting.figure_style import BLUE, GREY, ORANGE
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page
from posor.reporting.plot import Plot
from posor.reporting.report_table import ReportTable
from posor.uncertainty.budget_quantities import NATIVE
from posor.uncertainty.first_order import ContributionKind

from posor_design.data_file import read_data
from posor_design.monte_carlo import COVERAGE
from posor_design.reliability_report import arm_json, arm_table, causes_table, reliability_json, reliability_table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.budget_quantities import Output
    from posor.uncertainty.first_order import ErrorBudget
    from posor.uncertainty.protection_level import ArmReliability
    from posor.uncertainty.reliability import Reliability

    from posor_design.monte_carlo import MonteCarlo, Validation

DISPLAY_UNITS: Mapping[str, tuple[float, str]] = {"m": (1e6, "µm"), "rad": (1e6, "µrad")}
"""Factor and name of the unit in which quantities of an SI unit are displayed."""
SUMMARISED_SHARE = 0.01  # contributions with smaller shares in all outputs are summed in one line
NEGLIGIBLE_SHARE = 1e-4  # smaller shares of a contribution in one output are not displayed
CSV_COLUMNS = ("rank", "contribution", "kind", "quantity", "unit", "standard_uncertainty", "share_of_variance")
DIFFERS = "the model is not linear over this uncertainty: use the interval of the draws, interval_95 in budget.json"
NOT_STABLE = "too few draws for this tolerance: use more, --draws"
BARS = 8  # number of contributions drawn for each output
COLOURS = {ContributionKind.RANDOM: ORANGE, ContributionKind.SYSTEMATIC: BLUE}
NAMES = {ContributionKind.RANDOM: "noise (random)", ContributionKind.SYSTEMATIC: "calibration (systematic)"}


def heading(output: Output) -> str:
    """Return the name of an output with its display unit."""
    return f"{output.name} [{DISPLAY_UNITS[output.unit][1]}]"


def format_number(value: float, output: Output) -> str:
    """Return a value [m, rad] in the display unit with three digits."""
    scaled = value * DISPLAY_UNITS[output.unit][0]
    return f"{scaled:#.3g}".rstrip(".") if scaled < 1e3 else f"{scaled:.0f}"  # noqa: PLR2004  three digits


@dataclass(frozen=True)
class BudgetReport:
    """Everything that tables, files and page of a budget display."""

    calibration: str  # name of the calibration
    content_hash: str  # hash of its content
    session: str  # name of the applied session; empty: none
    budget: ErrorBudget  # first-order budget
    drawn: MonteCarlo  # Monte Carlo result
    validations: tuple[Validation, ...]  # validation of the first order by the draws, for each output
    seed: int  # seed of the draws
    reliability: Reliability  # minimal detectable biases of the readings
    # reliability of an arm and protection level of its endpoint; None: no arm is given
    arm: ArmReliability | None = None

    @property
    def holds(self) -> bool:
        """Whether the first order is valid for every output."""
        return all(validation.holds for validation in self.validations)

    @property
    def verdict(self) -> str:
        """Result of the validation (JCGM 101, clause 8) in words."""
        failing = [validation.name for validation in self.validations if not validation.holds]
        unstable = [validation.name for validation in self.validations if not validation.stable]
        if failing:
            sentence = f"First order and draws differ by more than the numerical tolerance in {', '.join(failing)}."
        else:
            sentence = "First order and draws agree within the numerical tolerance (JCGM 101, clause 8)."
        if unstable:
            sentence += f" The draws are not yet stable to a fifth of it in {', '.join(unstable)}: use more draws."
        return sentence

    @property
    def correlation_note(self) -> str:
        """Meaning of the contributions of correlated quantities; empty if there are none."""
        names = self.budget.correlated
        if not names:
            return ""
        return (
            f"The calibration states correlations of {len(names)} quantities, such as {names[0]}. Each contribution is "
            "that of one quantity with all others exact; correlated contributions do not add up to the full "
            "covariance, and large ones may cancel."
        )

    @property
    def exact_note(self) -> str:
        """Names of the quantities without a stated uncertainty; empty if there are none."""
        names = self.budget.without_uncertainty
        return f"Taken as exact, no uncertainty is stated: {', '.join(names)}." if names else ""

    @property
    def pose_text(self) -> str:
        """The pose in native coordinates."""
        T = self.budget.T_R_T
        x, y, gap = (f"{1e3 * value:.4f}" for value in T.translation)
        alpha, beta, theta = (f"{1e3 * value:.3f}" for value in native_from_rotation(T.rotation))
        return f"x {x}, y {y}, gap {gap} mm; alpha {alpha}, beta {beta}, theta {theta} mrad"

    def contributions(self) -> ReportTable:
        """Return name, kind and cells of each contribution, of the summary of small ones, and of the totals."""
        budget = self.budget

        def cells(effects: FloatArray, shares: FloatArray | None = None) -> list[str]:
            numbers = [format_number(effect, output) for effect, output in zip(effects, budget.outputs, strict=True)]
            if shares is None:
                return [cell for number in numbers for cell in (number, "")]
            return [
                cell
                for number, share in zip(numbers, shares, strict=True)
                for cell in (("-", "-") if share < NEGLIGIBLE_SHARE else (number, f"{100.0 * share:.1f}"))
            ]

        rows: list[list[str]] = []
        small = []
        for part, share in zip(budget.contributions, budget.shares(), strict=True):
            if share.max() < SUMMARISED_SHARE:
                small.append((part.effects, share))
            else:
                rows.append([part.name, str(part.kind), *cells(part.effects, share)])
        if small:
            effects, shares = (np.array(column) for column in zip(*small, strict=True))
            total = np.sqrt(np.sum(np.square(effects), axis=0))
            rows.append([f"{len(small)} more, each below 1 %", "", *cells(total, np.sum(shares, axis=0))])
        totals = [
            *([f"all {kind}", str(kind), *cells(budget.root_sum_square(kind))] for kind in ContributionKind),
            ["root sum square", "total", *cells(budget.root_sum_square())],
            ["full covariance", "total", *cells(budget.sigmas)],
            [f"Monte Carlo, {self.drawn.trials} draws", "total", *cells(self.drawn.sigmas)],
        ]
        return ReportTable(
            "What to improve first: uncertainty and share of the variance",
            ("quantity", "kind", *(name for output in budget.outputs for name in (heading(output), "%"))),
            rows + totals,
            rule_before=len(rows),
        )

    def validation(self, *, remarks: bool = False) -> ReportTable:
        """Return the validation of each output; ``remarks``: with reason and remedy where it fails or is not stable."""
        rows = []
        for output, each in zip(self.budget.outputs, self.validations, strict=True):
            numbers = (format_number(value, output) for value in (each.tolerance, each.low, each.high))
            remark = "; ".join(filter(None, ["" if each.holds else DIFFERS, "" if each.stable else NOT_STABLE]))
            verdicts = "yes" if each.stable else "not yet", "holds" if each.holds else "differs"
            rows.append([heading(output), *numbers, *verdicts, *([remark] if remarks else [])])
        header = ("quantity", "numerical tolerance", "d low", "d high", "stable", "first order")
        title = f"First order against draws: ends of the {100 * COVERAGE:g} % intervals (JCGM 101, clause 8)"
        return ReportTable(title, (*header, "remark") if remarks else header, rows)

    def reliability_tables(self) -> list[ReportTable]:
        """Return the minimal detectable biases, and with an arm the protection level of its endpoint."""
        tables = [reliability_table(self.reliability), causes_table(self.reliability)]
        return [*tables, arm_table(self.arm)] if self.arm else tables

    def as_csv(self) -> str:
        """Return the contributions in order of rank, SI units."""
        text = StringIO()
        writer = csv.writer(text)
        writer.writerow(CSV_COLUMNS)
        parts = zip(self.budget.contributions, self.budget.shares(), strict=True)
        for rank, (part, shares) in enumerate(parts, start=1):
            for output, effect, share in zip(self.budget.outputs, part.effects, shares, strict=True):
                row = (rank, part.name, part.kind, output.name, output.unit, f"{effect:.9g}", f"{share:.9g}")
                writer.writerow(row)
        return text.getvalue()

    def as_json(self) -> dict[str, Any]:
        """Return everything by name, SI units."""
        budget, drawn = self.budget, self.drawn
        native = [*budget.T_R_T.translation, *native_from_rotation(budget.T_R_T.rotation)]
        quantities = {
            output.name: {
                "unit": output.unit,
                "value": float(budget.values[i]),
                "random": float(budget.root_sum_square(ContributionKind.RANDOM)[i]),
                "systematic": float(budget.root_sum_square(ContributionKind.SYSTEMATIC)[i]),
                "root_sum_square": float(budget.root_sum_square()[i]),
                "full_covariance": float(budget.sigmas[i]),
                "monte_carlo": {
                    "mean": float(drawn.means[i]),
                    "standard_uncertainty": float(drawn.sigmas[i]),
                    "interval_95": [float(drawn.low[i]), float(drawn.high[i])],
                },
                "validation": {
                    "numerical_tolerance": validation.tolerance,
                    "d_low": validation.low,
                    "d_high": validation.high,
                    "stable": validation.stable,
                    "holds": validation.holds,
                },
            }
            for i, (output, validation) in enumerate(zip(budget.outputs, self.validations, strict=True))
        }
        names = [output.name for output in budget.outputs]
        return {
            "calibration": self.calibration,
            "content_hash": self.content_hash,
            "session": self.session,
            "pose": dict(zip((name for name, _ in NATIVE), map(float, native), strict=True)),
            "quantities": quantities,
            "covariance": budget.covariance.tolist(),
            "contributions": [
                {
                    "rank": rank,
                    "name": part.name,
                    "kind": str(part.kind),
                    "standard_uncertainty": dict(zip(names, part.effects.tolist(), strict=True)),
                }
                for rank, part in enumerate(budget.contributions, start=1)
            ],
            "taken_as_exact": list(budget.without_uncertainty),
            "vary_together": list(budget.correlated),
            "draws": {"seed": self.seed, "used": drawn.trials, "without_a_pose": drawn.lost},
            "reliability": reliability_json(self.reliability),
            "arm": None if self.arm is None else arm_json(self.arm),
        }


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
                effects = [scale * part.effects[i] for part in parts]
                plot.bars(NAMES[kind], effects, [part.name for part in parts], colour)
        plot.vertical(f"total, first order {total:.3g}", total)
        plot.vertical(f"total, draws {drawn:.3g}", drawn, GREY, "dotted")
        plots.append(plot)
    return plots


def render_budget_page(report: BudgetReport) -> str:
    """Return the page as HTML without external references."""
    notes = [note for note in (*read_data("page_notes")["budget"], report.correlation_note, report.exact_note) if note]
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
