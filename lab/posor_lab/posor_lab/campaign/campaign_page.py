# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Report page of calibration campaigns: tables and interactive plots."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Cell, Section, bullet_list, definition_list, paragraph, render_page, table
from posor.reporting.plot import Plot
from posor.uncertainty.first_order import ContributionKind
from scipy.stats import chi2, norm

from posor_lab.accuracy.consistency import REGION_LIMIT
from posor_lab.campaign.campaign_report import all_findings
from posor_lab.campaign.campaign_series import CLAIM
from posor_lab.campaign.parameter_coverage import QUANTILE_95, measuring_steps
from posor_lab.campaign.validation_set import FREEDOMS
from posor_lab.lab_output import page_notes
from posor_lab.reports.findings import COMPARISON_HEADINGS, findings_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.fit_record import Instrument
    from posor_calibration.least_squares import Fit
    from posor_calibration.procedure import Figure, Outcome

    from posor_lab.campaign.campaign_report import CampaignReport
    from posor_lab.campaign.campaign_series import FamilyCoverage, SeriesCoverage

AS_BUILT = "as built, not measured"
NO_REFERENCE = "no reference"
STYLES = ((BLUE, "circle"), (ORANGE, "square"), (GREEN, "triangle"), (LIGHT_BLUE, "diamond"))
BARS = 5  # largest quantities, and readings, drawn for each freedom
MANY = 500  # from this number on, residuals are drawn as small points
NEGLIGIBLE = 0.03
"""Residuals over standard uncertainty below this belong to freedoms without a reference and are not drawn."""
FAINT = 0.02  # readings with less than this share of the loudest reading's noise are not drawn
WITH_UNIT = {  # procedures whose own charts show residuals in their unit, and the titles
    "gap_linearisation": "Gap probes: residuals of the linearisation",
    "diode_map": "Diodes: residuals of the maps",
}


def campaign_page(reports: Sequence[CampaignReport], provenance: Mapping[str, str]) -> str:
    """Return the self-contained page."""
    findings = all_findings(reports)
    sections = [Section("Findings", findings_table(findings, COMPARISON_HEADINGS))]
    for report in reports:
        sections += _posor_sections(report)
    notes = bullet_list(page_notes("calibration")["notes"])
    sections += [Section("Notes", notes), Section("Provenance", definition_list(provenance))]
    title = f"Calibration of {' and '.join(report.truth.name for report in reports)}, simulated campaigns"
    return render_page(title, findings.sentence, holds=findings.holds, sections=sections)


def _posor_sections(report: CampaignReport) -> list[Section]:
    name, coverage = report.truth.name, Markup()
    against_truth = [_plot_parameter_errors(report), _plot_pose_errors(report), _plot_quantiles(report)]
    if report.coverage is not None:
        coverage = _coverage_tables(report.coverage)
        against_truth.append(_plot_coverage(report.coverage))
    budgets = [_plot_budget(report, freedom) for freedom in range(len(FREEDOMS))]
    return [
        Section(f"{name}: comparison with the truth", coverage, against_truth),
        Section(f"{name}: parameters", _parameter_table(report)),
        Section(f"{name}: fits and their residuals", _fit_table(report), _plot_residuals(report)),
        Section(f"{name}: error budget and validation poses", _budget_table(report), budgets),
    ]


def _parameter_table(report: CampaignReport) -> Markup:
    header = (
        *("parameter", "as built", "sigma", "found", "sigma", "unit", "truth", "error / sigma"),
        *("measured by", "with", "date"),
    )
    steps = measuring_steps(report.truth.as_built, [done.calibration for done in report.steps])
    rows: list[list[str | Cell]] = []
    for parameter in report.parameters:
        before, before_sigma = parameter.before
        known = [_to_uncertainty(before, before_sigma), f"{before_sigma:#.2g}"] if before_sigma > 0.0 else [""] * 2
        if before_sigma == 0.0:
            known = [f"{before:.6g}", "exact"]
        measured = [AS_BUILT, "", ""]
        if parameter.name in steps:
            done, record = report.steps[steps[parameter.name]], report.calibration.fits[steps[parameter.name]]
            measured = [f"{done.step.name}: {record.procedure}", done.step.instrument or NO_REFERENCE, record.date]
        found, true = (_to_uncertainty(value, parameter.sigma) for value in (parameter.estimate, parameter.truth))
        error = Cell(f"{parameter.normalised_error:+.2f}", "holds" if parameter.inside else "fails")
        sigma, unit = f"{parameter.sigma:#.2g}", parameter.unit
        rows.append([parameter.name, *known, found, sigma, unit, true, error, *measured])
    outside, count = sum(not parameter.inside for parameter in report.parameters), len(report.parameters)
    text = (
        f"Errors beyond the 95 % interval are marked: {outside} of {count}. {0.05 * count:.0f} are expected by chance; "
        "the findings judge the largest."
    )
    return paragraph(text) + paragraph(page_notes("calibration")["measured_by"]) + table(header, rows)


def _to_uncertainty(value: float, sigma: float) -> str:
    """Return a number to the second digit of its standard uncertainty."""
    digits = int(np.floor(np.log10(max(abs(value), sigma))) - np.floor(np.log10(sigma))) + 2
    return f"{value + 0.0:#.{digits}g}".rstrip(".")  # never -0.0


def _fit_table(report: CampaignReport) -> Markup:
    header = (
        *("step", "procedure and method", "instrument, its standard uncertainty", "fit", "residuals"),
        *("spread", "probability", "outliers", "bag, SHA-256", "date"),
    )
    rows: list[list[str | Cell]] = []
    for done, record in zip(report.steps, report.calibration.fits, strict=True):
        instruments = "; ".join(f"{each.name}: {_format_sigmas(each, done.step.unit)}" for each in record.instruments)
        head = (done.step.name, f"{record.procedure}: {record.method}", instruments or NO_REFERENCE)
        bag = Cell(f"{record.recording.name} {record.recording.sha256}", "wrapped")
        for fit, figures in record.residuals.items():
            readings = f"{figures.readings} of {figures.parameters} parameters"
            quality = (f"{figures.spread:.3f}", f"{figures.probability:.2g}", f"{figures.outliers}")
            rows.append([*head, fit, readings, *quality, bag, record.date])
    warnings = [f"{done.step.name}: {warning}" for done in report.steps for warning in done.outcome.warnings]
    notes = (page_notes("calibration")["spread"], "Warnings of the procedures about their data:")
    return table(header, rows) + Markup().join(map(paragraph, notes)) + bullet_list(warnings)


def _format_sigmas(instrument: Instrument, unit: str) -> str:
    """Return the different standard uncertainties of an instrument; ``unit``: of a single number."""
    units = [unit] if len(instrument.sigmas) == 1 else ["m"] * 3 + ["rad"] * 3
    texts = [f"{round(1e6 * sigma, 6):g} µ{unit}" for sigma, unit in zip(instrument.sigmas, units, strict=False)]
    return ", ".join(dict.fromkeys(texts))


def _budget_table(report: CampaignReport) -> Markup:
    budget, rms = report.budget, report.validation.root_mean_squares()
    header = ("standard uncertainty, root mean square", *(f"{freedom} [µ{unit}]" for freedom, unit in FREEDOMS.items()))
    lines = (
        ("budget in the middle of the range: noise", budget.root_sum_square(ContributionKind.RANDOM)[:6]),
        ("budget in the middle: calibration, with its correlations", report.calibration_sigmas),
        ("budget in the middle: total", budget.sigmas[:6]),
        ("budget at the validation poses", rms["budget"]),
        ("errors at the validation poses", rms["errors"]),
        ("part of the calibration in that budget", rms["budget_of_calibration"]),
        ("errors there of scans without noise", rms["errors_without_noise"]),
        ("errors of the POSOR as built", rms["errors_as_built"]),
    )
    return table(header, [[text, *(f"{1e6 * value:.3g}" for value in values)] for text, values in lines])


def _coverage_tables(coverage: SeriesCoverage) -> Markup:
    header = ("parameters", "count", "within their 95 % interval, and 95 % interval of that share", "worst of them")
    band = " to ".join(f"{100.0 * end:.1f} %" for end in coverage.binomial_band)
    text = (
        f"{coverage.campaigns} campaigns. The share of a single parameter with a right interval is between {band} "
        "with a probability of 95 %."
    )
    final, claimed = (table(header, map(_family_row, families)) for families in (coverage.families, coverage.claims))
    titles = map(paragraph, ("In the file at the end:", "When each procedure stated them:"))
    return paragraph(text) + next(titles) + final + next(titles) + claimed


def _family_row(family: FamilyCoverage) -> list[str]:
    low, high = family.interval
    inside = f"{100.0 * family.inside.value:.1f} %, {100.0 * low:.1f} % to {100.0 * high:.1f} %"
    return [family.name, str(family.count), inside, f"{family.worst.name}: {100.0 * family.worst.within_95:.1f} %"]


def _plot_residuals(report: CampaignReport) -> list[Plot]:
    """Return a plot of the residuals of each procedure, and of the profile of a bumpy ring."""
    outcomes_by_procedure: dict[str, list[Outcome]] = {}
    for done in report.steps:
        outcomes_by_procedure.setdefault(done.step.procedure, []).append(done.outcome)
    plots = []
    for procedure, outcomes in outcomes_by_procedure.items():
        charts = [chart for outcome in outcomes for chart in outcome.figures]
        if procedure == "bundle":
            plots.append(_plot_histogram(outcomes[0].fits[procedure]))
        elif procedure in WITH_UNIT:
            plots.append(_plot_chart(WITH_UNIT[procedure], _merge_charts(charts)))
        elif procedure == "target_plane":
            plots.append(_plot_chart("Target plane: apparent alpha, before and after", charts[0]))
        else:
            plots.append(_plot_normalised_residuals(procedure, outcomes[0].fits))
        if procedure == "ring_profile":
            plots.append(_plot_chart("Bumpy ring: change of its profile, no residuals", charts[0], line=True))
    return plots


def _merge_charts(charts: Sequence[Figure]) -> Figure:
    """Return charts of the same quantities as one; each series is named by the title of its chart and its own name."""
    if len(charts) == 1:
        return charts[0]
    series = {}
    for n, chart in enumerate(charts):
        head = chart.title.split(":")[0].split()[-1] if ":" in chart.title else str(n + 1)
        single = len(chart.series) == 1
        series.update({head if single else f"{head} {name}": points for name, points in chart.series.items()})
    return replace(charts[0], series=series)


def _plot_chart(title: str, chart: Figure, *, line: bool = False) -> Plot:
    plot = Plot(title, *(label.replace("[u", "[µ") for label in (chart.x_label, chart.y_label)))
    plot.zero()
    for (name, (x, y)), (colour, marker) in zip(chart.series.items(), cycle(STYLES), strict=False):
        style: dict[str, Any] = {"dash": "solid"} if line else {"dash": None, "marker": marker}
        plot.curve(name or "series", x, y, colour, size=5, **style)
    return plot


def _plot_normalised_residuals(procedure: str, fits: Mapping[str, Fit]) -> Plot:
    """Plot the residuals of the fits of a procedure, named by the last word of their names.

    A fit with a free pose for each scan has nearly zero residuals in the freedoms without a reference: not drawn.
    """
    title = f"{procedure.replace('_', ' ').capitalize()}: residuals"
    plot = Plot(title, f"number of the residual, below {NEGLIGIBLE:g} not drawn", "residual / standard uncertainty")
    plot.zero()
    for (name, fit), (colour, marker) in zip(fits.items(), cycle(STYLES), strict=False):
        shown = np.flatnonzero(np.abs(fit.residuals) > NEGLIGIBLE)
        size = 5.0 if len(shown) < MANY else 2.0
        plot.curve(name.split()[-1], shown + 1, fit.residuals[shown], colour, dash=None, marker=marker, size=size)
    return plot


def _plot_histogram(fit: Fit) -> Plot:
    plot = Plot(f"Bundle: {len(fit.residuals)} residuals", "residual / standard uncertainty", "density")
    edges = np.linspace(-4.0, 4.0, 33)
    density, _ = np.histogram(np.clip(fit.residuals, -4.0, 4.0), edges, density=True)
    plot.histogram("residuals", edges, density, LIGHT_BLUE)
    x = np.linspace(-4.0, 4.0, 81)
    deviation = np.sqrt(np.mean(np.square(fit.residuals)))
    plot.curve("standard normal", x, norm.pdf(x), GREY)
    plot.curve(f"normal, deviation {deviation:.2f}", x, norm.pdf(x, scale=deviation), ORANGE, dash="dashed")
    return plot


def _plot_parameter_errors(report: CampaignReport) -> Plot:
    families = list(dict.fromkeys(parameter.family for parameter in report.parameters))
    title = "Estimate less truth, each parameter"
    plot = Plot(title, "stated standard uncertainties", "parameters", categories=families)
    for name, inside, colour in (("within the 95 % interval", True, BLUE), ("outside", False, ORANGE)):
        shown = [parameter for parameter in report.parameters if parameter.inside is inside]
        if shown:
            errors, names = [each.normalised_error for each in shown], [each.name for each in shown]
            rows, extra = [each.family for each in shown], {"parameter": names}
            plot.curve(name, errors, rows, colour, dash=None, marker="circle", extra=extra)
    for limit in (-QUANTILE_95, QUANTILE_95):
        plot.vertical("95 % interval", limit)
    return plot


def _plot_budget(report: CampaignReport, freedom: int) -> Plot:
    noises = {part.name: part.effects for part in report.budget.contributions if part.kind is ContributionKind.RANDOM}
    loudest = max(effects[freedom] for effects in noises.values())
    noises = {name: effects for name, effects in noises.items() if effects[freedom] > FAINT * loudest}
    systematic, total = 1e6 * report.calibration_sigmas[freedom], 1e6 * report.budget.sigmas[freedom]
    noise = np.sqrt(max(total**2 - systematic**2, 0.0))
    name, unit = list(FREEDOMS.items())[freedom]
    groups = []
    for label, effects, colour in (
        (f"noise, in all {noise:.2g} µ{unit}", noises, ORANGE),
        (f"calibration, in all {systematic:.2g} µ{unit}", report.gains, BLUE),
    ):
        largest = sorted(effects, key=lambda part, effects=effects: -effects[part][freedom])[:BARS]  # type: ignore[misc]
        groups.append((label, {part: 1e6 * float(effects[part][freedom]) for part in largest}, colour))
    lengths = {part: length for _, group, _ in groups for part, length in group.items()}
    title, order = f"{name}: {total:.2g} µ{unit}", sorted(lengths, key=lambda part: -lengths[part])
    plot = Plot(title, f"reduction if known exactly [µ{unit}]", "quantity", categories=order)
    for label, group, colour in groups:
        plot.bars(label, list(group.values()), list(group), colour)
    return plot


def _plot_pose_errors(report: CampaignReport) -> Plot:
    rms = report.validation.root_mean_squares()
    title = f"Errors at {report.validation.located.sum()} validation poses"
    plot = Plot(title, "root mean square [µm, µrad]", "freedom", categories=list(FREEDOMS), x_log=True)
    for key, colour, marker, label in (
        ("errors_as_built", GREY, "x", "as built"),
        ("errors", BLUE, "circle", "calibrated"),
        ("budget", LIGHT_BLUE, "square", "budget"),
        ("errors_without_noise", ORANGE, "diamond", "calibrated, without noise"),
        ("budget_of_calibration", GREEN, "triangle", "its part of the budget"),
    ):
        plot.curve(label, 1e6 * rms[key], list(FREEDOMS), colour, dash=None, marker=marker, size=9, filled=False)
    return plot


def _plot_quantiles(report: CampaignReport) -> Plot:
    values = np.sort(report.validation.normalised_squares[report.validation.located])
    expected = chi2.ppf((np.arange(len(values)) + 0.5) / len(values), len(FREEDOMS))
    plot = Plot("Squared error over the budget, all six freedoms", "quantile of chi-square, 6", "found")
    plot.curve("validation poses of this campaign", expected, values, BLUE, dash=None, marker="circle")
    reach = 1.05 * max(float(expected[-1]), float(values[-1]), REGION_LIMIT)
    plot.curve("right budget, independent errors", [0.0, reach], [0.0, reach], GREY)
    plot.horizontal("95 % region", REGION_LIMIT, ORANGE)
    return plot


def _plot_coverage(coverage: SeriesCoverage) -> Plot:
    names = [family.name for family in coverage.families]
    low, high = 100.0 * np.array([family.interval for family in coverage.families]).T
    title = f"Truth within 95 %, {coverage.campaigns} campaigns"
    plot = Plot(title, "parameters within [%]", "parameters", categories=names)
    plot.intervals("95 % interval of the share", low, high, names, LIGHT_BLUE)
    shares = [100.0 * family.inside.value for family in coverage.families]
    extra = {"interval from [%]": low, "interval to [%]": high}
    plot.curve("share", shares, names, BLUE, dash=None, marker="circle", extra=extra)
    for end in CLAIM:
        plot.vertical("accepted on the average", 100.0 * end)
    return plot
