"""Report page of calibration campaigns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from posor.reporting.html_page import (
    Cell,
    Section,
    bullet_list,
    definition_list,
    paragraph,
    render_page,
    table,
)
from posor.uncertainty.first_order import ContributionKind

from posor_lab.campaign.campaign_plots import plot_budgets, plot_residuals, plot_truth
from posor_lab.campaign.campaign_report import all_findings
from posor_lab.campaign.parameter_coverage import measuring_steps
from posor_lab.campaign.validation_set import FREEDOMS
from posor_lab.reports.findings import COMPARISON_HEADINGS, findings_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.calibration.fit_record import Instrument

    from posor_lab.campaign.campaign_report import CampaignReport
    from posor_lab.campaign.campaign_series import FamilyCoverage, SeriesCoverage

AS_BUILT = "as built, not measured"
NO_REFERENCE = "no reference"
MEASURED_BY = (
    "A parameter is measured by the step that lowered its standard uncertainty most; later steps state it again. If at "
    "least 95 % of the standard uncertainty as built is left, no step has measured it. Method, bag and uncertainties "
    "of the instruments are listed with the fits."
)
SPREAD = (
    "Spread: root of chi-square over the degrees of freedom, 1 if the stated uncertainties of the readings are right. "
    "Probability: of a chi-square at least as large, if they are right."
)
NOTES = (
    (
        "Simulated: each POSOR is drawn from the uncertainties of its calibration as built, so the truth of every "
        "parameter is known. Scans have the noise of the electronics and a converter of 16 bits; each reference has an "
        "error of its stated standard uncertainty, at each dwell or, in motion, at each reading. Quantities that are "
        "stated but not measured have smaller errors: the heights of 3_spacing, stated to 1 mm, scatter by 20 µm; the "
        "heights and angles of 6_rays have no error."
    ),
    (
        "Every procedure ran on a rosbag2 bag by the code of the command line, each from the file of the step before; "
        "bags, files, verdicts and tables are beside this page."
    ),
    (
        "Uncertainties are standard uncertainties, k = 1 (JCGM 100); 95 % intervals are 1.96 of them. A procedure's "
        "uncertainty includes that of the parameters it takes as known; the records of the file hold the correlations."
    ),
    "Errors without noise are those of scans without noise and converter: they come from the calibration.",
    (
        "Budget bars: the noise of single readings, and the reduction of the standard uncertainty of the freedom if "
        "one quantity were known exactly, as the root of the difference of the squares: contributions of correlated "
        "quantities would exceed the total. The longest bars are the first to improve."
    ),
    (
        "Validation poses are drawn over the whole range; no procedure has used them. The errors of one calibration "
        "are common to all of them: within one campaign they are not independent of one another."
    ),
    (
        "The share of campaigns whose interval contains the truth is itself uncertain. Findings state one standard "
        "deviation by the scatter of the campaigns. Plot and table show its 95 % interval of Clopper and Pearson, "
        "for as many independent cases as scatter like the campaigns, since the parameters of one campaign are not "
        "independent of one another."
    ),
)


def campaign_page(reports: Sequence[CampaignReport], provenance: Mapping[str, str]) -> str:
    """Return the self-contained page."""
    findings = all_findings(reports)
    sections = [Section("Findings", findings_table(findings, COMPARISON_HEADINGS))]
    for report in reports:
        sections += _posor_sections(report)
    sections += [Section("Notes", bullet_list(NOTES)), Section("Provenance", definition_list(provenance))]
    return render_page(
        f"Calibration of {' and '.join(report.truth.name for report in reports)}, simulated campaigns",
        findings.sentence,
        holds=findings.holds,
        sections=tuple(sections),
    )


def _posor_sections(report: CampaignReport) -> list[Section]:
    name = report.truth.name
    coverage = Markup() if report.coverage is None else _coverage_tables(report.coverage)
    return [
        Section(f"{name}: comparison with the truth", coverage, plot_truth(report)),
        Section(f"{name}: parameters", _parameter_table(report)),
        Section(f"{name}: fits and their residuals", _fit_table(report), plot_residuals(report)),
        Section(f"{name}: error budget and validation poses", _budget_table(report), plot_budgets(report)),
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
        rows.append(
            [
                parameter.name,
                *known,
                _to_uncertainty(parameter.estimate, parameter.sigma),
                f"{parameter.sigma:#.2g}",
                parameter.unit,
                _to_uncertainty(parameter.truth, parameter.sigma),
                Cell(f"{parameter.normalised_error:+.2f}", "holds" if parameter.inside else "fails"),
                *measured,
            ]
        )
    outside, count = sum(not parameter.inside for parameter in report.parameters), len(report.parameters)
    text = (
        f"Errors beyond the 95 % interval are marked: {outside} of {count}. {0.05 * count:.0f} are expected by chance; "
        "the findings judge the largest."
    )
    return paragraph(text) + paragraph(MEASURED_BY) + table(header, rows)


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
        instruments = "; ".join(
            f"{instrument.name}: {_format_sigmas(instrument, done.step.unit)}" for instrument in record.instruments
        )
        rows += [
            [
                done.step.name,
                f"{record.procedure}: {record.method}",
                instruments or NO_REFERENCE,
                fit,
                f"{figures.readings} of {figures.parameters} parameters",
                f"{figures.spread:.3f}",
                f"{figures.probability:.2g}",
                f"{figures.outliers}",
                Cell(f"{record.recording.name} {record.recording.sha256}", "wrapped"),
                record.date,
            ]
            for fit, figures in record.residuals.items()
        ]
    warnings = [f"{done.step.name}: {warning}" for done in report.steps for warning in done.outcome.warnings]
    notes = paragraph(SPREAD) + paragraph("Warnings of the procedures about their data:") + bullet_list(warnings)
    return table(header, rows) + notes


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
    tables = [table(header, map(_family_row, families)) for families in (coverage.families, coverage.claims)]
    return (
        paragraph(text)
        + paragraph("In the file at the end:")
        + tables[0]
        + paragraph("When each procedure stated them:")
        + tables[1]
    )


def _family_row(family: FamilyCoverage) -> list[str]:
    low, high = family.interval
    inside = f"{100.0 * family.inside.value:.1f} %, {100.0 * low:.1f} % to {100.0 * high:.1f} %"
    return [family.name, str(family.count), inside, f"{family.worst[0]}: {100.0 * family.worst[1]:.1f} %"]
