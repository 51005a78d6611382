"""Figures of a calibration campaign: residuals, error budget, comparison with the truth."""

from __future__ import annotations

from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from posor_estimator.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE, style_axes, to_png
from posor_estimator.uncertainty.first_order import Kind
from scipy.stats import chi2, norm

from posor_validation.campaign.campaign_series import CLAIM
from posor_validation.campaign.parameter_coverage import QUANTILE_95
from posor_validation.campaign.validation_set import FREEDOMS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from posor_estimator.identification.least_squares import Fit
    from posor_estimator.identification.procedure import Figure, Outcome

    from posor_validation.campaign.campaign_report import CampaignReport
    from posor_validation.campaign.campaign_series import SeriesCoverage

STYLES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (LIGHT_BLUE, "D"))
WIDE, TALL = (15.0, 8.6), (15.0, 12.0)
"""Sizes of the figures [inch]."""
SMALL, TITLE = 9, 11
"""Font sizes [pt]."""
BARS = 5
"""Largest quantities, and readings, drawn for each freedom."""
MANY = 500
"""From this number on, residuals are drawn as small points."""
NEGLIGIBLE = 0.03
"""Residuals over standard uncertainty below this belong to freedoms without a reference and are not drawn."""
FAINT = 0.02
"""Readings with less than this share of the loudest reading's noise are not drawn."""
LINE_WIDTH = 24
"""Letters of a quantity's name in a line."""
WITH_UNIT = {
    "gap_linearisation": "Gap probes: residuals of the linearisation",
    "diode_map": "Diodes: residuals of the maps",
}
"""Procedures whose own charts show residuals in their unit, and the titles."""


def draw_campaign(report: CampaignReport) -> dict[str, bytes]:
    """Return the figures (PNG) by name: ``residuals``, ``budget``, ``truth``."""
    name = f"{report.truth.name}, simulated campaign of seed {report.truth.seed}"
    return {
        "residuals": _draw_residuals(report, name),
        "budget": _draw_budgets(report, name),
        "truth": _draw_truth(report, name),
    }


def _new_figure(size: tuple[float, float], title: str) -> Drawing:
    figure = Drawing(figsize=size, layout="constrained")
    figure.suptitle(title)
    return figure


def _styled_png(figure: Drawing) -> bytes:
    for axes in figure.axes:
        style_axes(axes)
        axes.title.set_fontsize(TITLE)
    return to_png(figure)


def _draw_residuals(report: CampaignReport, name: str) -> bytes:
    figure = _new_figure(TALL, f"{name}: residuals, those without a unit over their standard uncertainties")
    outcomes_by_procedure: dict[str, list[Outcome]] = {}
    for done in report.steps:
        outcomes_by_procedure.setdefault(done.step.procedure, []).append(done.outcome)
    free_axes = iter(figure.subplots(3, 3).ravel())
    for procedure, outcomes in outcomes_by_procedure.items():
        charts = [chart for outcome in outcomes for chart in outcome.figures]
        if procedure == "bundle":
            _plot_histogram(next(free_axes), outcomes[0].fits[procedure])
        elif procedure in WITH_UNIT:
            _plot_chart(next(free_axes), WITH_UNIT[procedure], _merge_charts(charts))
        elif procedure == "target_plane":
            _plot_chart(next(free_axes), "Target plane: apparent alpha, before and after", charts[0])
        else:
            _plot_normalised_residuals(next(free_axes), procedure, outcomes[0].fits)
        if procedure == "ring_profile":
            _plot_chart(next(free_axes), "Bumpy ring: change of its profile, no residuals", charts[0], line=True)
    for unused in free_axes:
        unused.set_visible(False)
    return _styled_png(figure)


def _draw_budgets(report: CampaignReport, name: str) -> bytes:
    figure = _new_figure(WIDE, f"{name}: budget of one scan in the middle of the range")
    for freedom, axes in enumerate(figure.subplots(2, 3).ravel()):
        _plot_budget(axes, report, freedom)
    return _styled_png(figure)


def _draw_truth(report: CampaignReport, name: str) -> bytes:
    figure = _new_figure(WIDE, f"{name}: comparison with the truth")
    coverage_column = ["coverage"] if report.coverage else []
    axes = figure.subplot_mosaic(
        [["parameters", "errors", *coverage_column], ["parameters", "quantiles", *coverage_column]]
    )
    _plot_parameter_errors(axes["parameters"], report)
    _plot_pose_errors(axes["errors"], report)
    _plot_quantiles(axes["quantiles"], report)
    if report.coverage:
        _plot_coverage(axes["coverage"], report.coverage)
    return _styled_png(figure)


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


def _legend_on_top(axes: Axes) -> None:
    axes.margins(y=0.22)  # space for the legend
    axes.legend(fontsize=SMALL, ncols=4, loc="upper center", columnspacing=1.0, handletextpad=0.3)


def _plot_chart(axes: Axes, title: str, chart: Figure, *, line: bool = False) -> None:
    for (name, (x, y)), (colour, marker) in zip(chart.series.items(), STYLES * 3, strict=False):
        if line:
            axes.plot(x, y, color=colour, lw=0.9, label=name or None)
        else:
            axes.plot(x, y, ls="", marker=marker, ms=3.5, alpha=0.75, color=colour, label=name or None)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.locator_params(axis="x", nbins=7)
    x_label, y_label = (label.replace("[u", "[µ") for label in (chart.x_label, chart.y_label))
    axes.set(title=title, xlabel=x_label, ylabel=y_label)
    if len(chart.series) > 1:
        _legend_on_top(axes)


def _plot_normalised_residuals(axes: Axes, procedure: str, fits: Mapping[str, Fit]) -> None:
    """Plot the residuals of the fits of a procedure, labelled by the last word of their names.

    A fit with a free pose for each scan has nearly zero residuals in the freedoms without a reference: not drawn.
    """
    for (name, fit), (colour, marker) in zip(fits.items(), STYLES * 3, strict=False):
        shown = np.flatnonzero(np.abs(fit.residuals) > NEGLIGIBLE)
        size = 3.5 if len(shown) < MANY else 1.5
        label, residuals = name.split()[-1], fit.residuals[shown]
        axes.plot(shown + 1, residuals, ls="", marker=marker, ms=size, alpha=0.75, color=colour, label=label)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.set(
        title=f"{procedure.replace('_', ' ').capitalize()}: residuals",
        xlabel=f"number of the residual, below {NEGLIGIBLE:g} not drawn",
        ylabel="over its standard uncertainty",
    )
    if len(fits) > 1:
        _legend_on_top(axes)


def _plot_histogram(axes: Axes, fit: Fit) -> None:
    bins = np.linspace(-4.0, 4.0, 33)
    axes.hist(np.clip(fit.residuals, -4.0, 4.0), bins.tolist(), density=True, color=LIGHT_BLUE, label="residuals")
    x = np.linspace(-4.0, 4.0, 200)
    deviation = np.sqrt(np.mean(np.square(fit.residuals)))
    axes.plot(x, norm.pdf(x), color=GREY, label="standard normal")
    axes.plot(x, norm.pdf(x, scale=deviation), color=ORANGE, ls="--", label=f"normal, deviation {deviation:.2f}")
    title = f"Bundle: {len(fit.residuals)} residuals"
    axes.set(title=title, xlabel="residual / standard uncertainty", ylim=(0.0, 0.6))
    axes.legend(fontsize=SMALL, loc="upper left")


def _plot_parameter_errors(axes: Axes, report: CampaignReport) -> None:
    families = list(dict.fromkeys(parameter.family for parameter in report.parameters))
    for parameter in report.parameters:
        colour = BLUE if parameter.inside else ORANGE
        row = families.index(parameter.family)
        axes.plot(parameter.normalised_error, row, "o", ms=4, alpha=0.7, color=colour)
    axes.axvspan(-QUANTILE_95, QUANTILE_95, color="#eeeeee", zorder=0)
    axes.axvline(0.0, color=GREY, lw=0.8)
    axes.set_yticks(range(len(families)), families, fontsize=SMALL)
    axes.invert_yaxis()
    reach = max(3.5, 1.1 * max(abs(parameter.normalised_error) for parameter in report.parameters))
    axes.set(title="Estimate less truth, each parameter", xlabel="stated standard uncertainties", xlim=(-reach, reach))


def _plot_budget(axes: Axes, report: CampaignReport, freedom: int) -> None:
    noises = {part.name: part.effects for part in report.budget.contributions if part.kind is Kind.RANDOM}
    loudest = max(effects[freedom] for effects in noises.values())
    noises = {name: effects for name, effects in noises.items() if effects[freedom] > FAINT * loudest}
    bars = [
        (name, 1e6 * float(effects[freedom]), colour)
        for group, colour in ((noises, ORANGE), (report.gains, BLUE))
        for name, effects in sorted(group.items(), key=lambda item: -item[1][freedom])[:BARS]
    ]
    bars.sort(key=lambda bar: -bar[1])
    names, lengths, colours = zip(*bars, strict=True)
    drawn = axes.barh(range(len(bars)), lengths, color=colours)
    axes.bar_label(drawn, [_two_digits(length) for length in lengths], padding=3, fontsize=SMALL)
    axes.set_yticks(range(len(bars)), [fill(name, LINE_WIDTH) for name in names], fontsize=SMALL)
    axes.margins(x=0.16)  # space for the labels
    axes.locator_params(axis="x", nbins=5)
    axes.invert_yaxis()
    systematic, total = 1e6 * report.calibration_sigmas[freedom], 1e6 * report.budget.sigmas[freedom]
    noise = np.sqrt(max(total**2 - systematic**2, 0.0))
    name, unit = list(FREEDOMS.items())[freedom]
    axes.set(title=f"{name}: {_two_digits(total)} µ{unit}", xlabel=f"reduction if known exactly [µ{unit}]")
    labels = [f"noise, in all {_two_digits(noise)}", f"calibration, in all {_two_digits(systematic)}"]
    axes.legend([Patch(color=ORANGE), Patch(color=BLUE)], labels, fontsize=SMALL, loc="lower right")


def _two_digits(value: float) -> str:
    return f"{value:#.2g}".rstrip(".")


def _plot_pose_errors(axes: Axes, report: CampaignReport) -> None:
    rms, at = report.validation.root_mean_squares(), np.arange(len(FREEDOMS))
    for shift, key, colour, label in (
        (-0.32, "errors_as_built", GREY, "as built"),
        (-0.16, "errors", BLUE, "calibrated"),
        (0.0, "budget", LIGHT_BLUE, "budget"),
        (0.16, "errors_without_noise", ORANGE, "calibrated, without noise"),
        (0.32, "budget_of_calibration", GREEN, "its part of the budget"),
    ):
        axes.bar(at + shift, 1e6 * rms[key], 0.15, color=colour, label=label)
    axes.set_yscale("log")
    axes.set_xticks(at, list(FREEDOMS))
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 100.0)  # space for the legend
    count = int(report.validation.located.sum())
    axes.set(title=f"Errors at {count} validation poses", ylabel="root mean square [µm, µrad]")
    axes.legend(fontsize=SMALL, ncols=2, loc="upper center", columnspacing=1.0)


def _plot_quantiles(axes: Axes, report: CampaignReport) -> None:
    values = np.sort(report.validation.normalised_squares[report.validation.located])
    expected = chi2.ppf((np.arange(len(values)) + 0.5) / len(values), 6)
    limit = chi2.ppf(0.95, 6)
    axes.plot(expected, values, "o", ms=4, color=BLUE, label="validation poses of this campaign")
    reach = 1.05 * max(float(expected[-1]), float(values[-1]), limit)
    axes.plot([0.0, reach], [0.0, reach], color=GREY, lw=0.8, label="right budget, independent errors")
    axes.axhline(limit, color=ORANGE, ls="--", lw=1.0, label="95 % region")
    title = "Squared error over the budget, all six freedoms"
    axes.set(title=title, xlabel="quantile of chi-square, 6", ylabel="found")
    axes.legend(fontsize=SMALL)


def _plot_coverage(axes: Axes, coverage: SeriesCoverage) -> None:
    families = coverage.families
    at = np.arange(len(families))
    shares = np.array([100.0 * family.inside.value for family in families])
    ends = 100.0 * np.array([family.interval for family in families]).T
    axes.errorbar(shares, at, xerr=np.abs(ends - shares), fmt="o", ms=4, color=BLUE, capsize=2, lw=1.0, clip_on=False)
    axes.axvspan(100.0 * CLAIM[0], 100.0 * CLAIM[1], color="#eeeeee", zorder=0)
    axes.axvline(95.0, color=GREY, lw=0.8)
    axes.set_yticks(at, [family.name for family in families], fontsize=SMALL)
    axes.invert_yaxis()
    axes.set(
        title=f"Truth within 95 %, {coverage.campaigns} campaigns",
        xlabel="parameters within [%], and 95 % interval",
        xlim=(min(80.0, float(np.min(ends)) - 1.0), 100.5),
    )
