"""The pictures of a calibration campaign: residuals, error budget, and all of it judged by the truth."""

from __future__ import annotations

from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from posor_estimator.core.budget.first_order import Kind
from posor_estimator.reporting.drawing import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE, png, tidy
from scipy.stats import chi2, norm

from posor_bringup.campaign.fresh import FREEDOMS
from posor_bringup.campaign.judged import WITHIN_95
from posor_bringup.campaign.many import CLAIM

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.procedure import Figure, Outcome

    from posor_bringup.campaign.many import Coverage
    from posor_bringup.campaign.told import Told

STYLES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (LIGHT_BLUE, "D"))
WIDE, TALL = (15.0, 8.6), (15.0, 12.0)
"""Of pictures [inch]."""
SMALL, TITLE = 9, 11
"""Of letters [pt]."""
BARS = 5
"""Calibrated quantities, and readings, drawn for each freedom: those that matter most."""
MANY = 500
"""Residuals from which on their points are small."""
NOTHING = 0.03
"""Residual over its standard uncertainty: one below is mostly that of a freedom that no reference tells."""
FAINT = 0.02
"""Of the loudest reading's noise: what a quieter one does is not drawn."""
LINE = 24
"""Letters of a quantity's name in a line."""
WITH_UNIT = {
    "gap_linearisation": "Gap probes: residuals of the linearisation",
    "diode_map": "Diodes: residuals of the maps",
}
"""Procedures whose own charts show residuals in their unit, and what to say above."""


def draw(told: Told) -> dict[str, bytes]:
    """Return the pictures (PNG) by what they show: ``residuals``, ``budget``, ``truth``."""
    name = f"{told.plant.name}, simulated campaign of seed {told.plant.seed}"
    return {"residuals": _residuals(told, name), "budget": _budgets(told, name), "truth": _truth(told, name)}


def _residuals(told: Told, name: str) -> bytes:
    figure = Drawing(figsize=TALL, layout="constrained")
    figure.suptitle(f"{name}: residuals, those without a unit over their standard uncertainties")
    steps: dict[str, list[Outcome]] = {}
    for bag in told.bagged:
        steps.setdefault(bag.step.procedure, []).append(bag.outcome)
    free = iter(figure.subplots(3, 3).ravel())
    for procedure, outcomes in steps.items():
        charts = [chart for outcome in outcomes for chart in outcome.figures]
        if procedure == "bundle":
            _histogram(next(free), outcomes[0].fits[procedure])
        elif procedure in WITH_UNIT:
            _points(next(free), WITH_UNIT[procedure], _joined(charts))
        elif procedure == "target_plane":
            _points(next(free), "Target plane: alpha that is none, before and after", charts[0])
        else:
            _normalised(next(free), procedure, outcomes[0].fits)
        if procedure == "ring_profile":
            _points(next(free), "Bumpy ring: change of its profile, no residuals", charts[0], line=True)
    for rest in free:
        rest.set_visible(False)
    return _finished(figure)


def _budgets(told: Told, name: str) -> bytes:
    figure = Drawing(figsize=WIDE, layout="constrained")
    figure.suptitle(f"{name}: budget of one scan in the middle of the range")
    for n, one in enumerate(figure.subplots(2, 3).ravel()):
        _budget(one, told, n)
    return _finished(figure)


def _truth(told: Told, name: str) -> bytes:
    figure = Drawing(figsize=WIDE, layout="constrained")
    figure.suptitle(f"{name}: judged by the truth")
    many = ["coverage"] if told.coverage else []
    axes = figure.subplot_mosaic([["pulls", "errors", *many], ["pulls", "quantiles", *many]])
    _pulls(axes["pulls"], told)
    _errors(axes["errors"], told)
    _quantiles(axes["quantiles"], told)
    if told.coverage:
        _coverage(axes["coverage"], told.coverage)
    return _finished(figure)


def _finished(figure: Drawing) -> bytes:
    for axes in figure.axes:
        tidy(axes)
        axes.title.set_fontsize(TITLE)
    return png(figure)


def _joined(figures: Sequence[Figure]) -> Figure:
    """Return several charts of the same quantities as one, each series by its chart's title and its own name."""
    first = figures[0]
    if len(figures) == 1:
        return first
    series = {}
    for n, figure in enumerate(figures):
        head = figure.title.split(":")[0].split()[-1] if ":" in figure.title else str(n + 1)
        alone = len(figure.series) == 1
        series.update({head if alone else f"{head} {name}": points for name, points in figure.series.items()})
    return replace(first, series=series)


def _points(axes: Axes, title: str, figure: Figure, *, line: bool = False) -> None:
    for (name, (x, y)), (colour, marker) in zip(figure.series.items(), STYLES * 3, strict=False):
        if line:
            axes.plot(x, y, color=colour, lw=0.9, label=name or None)
        else:
            axes.plot(x, y, ls="", marker=marker, ms=3.5, alpha=0.75, color=colour, label=name or None)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.locator_params(axis="x", nbins=7)
    axes.set(title=title, xlabel=_written(figure.x_label), ylabel=_written(figure.y_label))
    if len(figure.series) > 1:
        axes.margins(y=0.22)  # the legend's place
        axes.legend(fontsize=SMALL, ncols=4, loc="upper center", columnspacing=1.0, handletextpad=0.3)


def _written(label: str) -> str:
    return label.replace("[u", "[µ")


def _normalised(axes: Axes, procedure: str, fits: Mapping[str, Fit]) -> None:
    """Draw what the fits of a procedure leave, after all that they found along, by the last word of their names.

    A fit that finds a pose for each scan has residuals that say nothing, of freedoms that the reference leaves open: a
    band of nearly zero, which is not drawn.
    """
    for (name, found), (colour, marker) in zip(fits.items(), STYLES * 3, strict=False):
        left = np.flatnonzero(np.abs(found.residuals) > NOTHING)
        size = 3.5 if len(left) < MANY else 1.5
        values, word = found.residuals[left], name.split()[-1]
        axes.plot(left + 1, values, ls="", marker=marker, ms=size, alpha=0.75, color=colour, label=word)
    axes.axhline(0.0, color=GREY, lw=0.8)
    words = procedure.replace("_", " ").capitalize()
    axes.set(
        title=f"{words}: residuals",
        xlabel=f"residual's number, below {NOTHING:g} not drawn",
        ylabel="over its standard uncertainty",
    )
    if len(fits) > 1:
        axes.margins(y=0.22)  # the legend's place
        axes.legend(fontsize=SMALL, ncols=4, loc="upper center", columnspacing=1.0, handletextpad=0.3)


def _histogram(axes: Axes, found: Fit) -> None:
    at = np.linspace(-4.0, 4.0, 33)
    axes.hist(np.clip(found.residuals, -4.0, 4.0), at.tolist(), density=True, color=LIGHT_BLUE, label="residuals")
    fine = np.linspace(-4.0, 4.0, 200)
    seen = np.sqrt(np.mean(np.square(found.residuals)))
    axes.plot(fine, norm.pdf(fine), color=GREY, label="standard normal")
    axes.plot(fine, norm.pdf(fine, scale=seen), color=ORANGE, ls="--", label=f"normal, deviation {seen:.2f}")
    title = f"Bundle: {len(found.residuals)} residuals"
    axes.set(title=title, xlabel="residual / standard uncertainty", ylim=(0.0, 0.6))
    axes.legend(fontsize=SMALL, loc="upper left")


def _pulls(axes: Axes, told: Told) -> None:
    families = list(dict.fromkeys(number.family for number in told.numbers))
    for number in told.numbers:
        colour = BLUE if number.inside else ORANGE
        axes.plot(number.pull, families.index(number.family), "o", ms=4, alpha=0.7, color=colour)
    axes.axvspan(-WITHIN_95, WITHIN_95, color="#eeeeee", zorder=0)
    axes.axvline(0.0, color=GREY, lw=0.8)
    axes.set_yticks(range(len(families)), families, fontsize=SMALL)
    axes.invert_yaxis()
    reach = max(3.5, 1.1 * max(abs(number.pull) for number in told.numbers))
    axes.set(title="Estimate less truth, each number", xlabel="stated standard uncertainties", xlim=(-reach, reach))


def _budget(axes: Axes, told: Told, freedom: int) -> None:
    noises = {one.name: one.effects for one in told.budget.contributions if one.kind is Kind.RANDOM}
    loudest = max(effects[freedom] for effects in noises.values())
    noises = {name: effects for name, effects in noises.items() if effects[freedom] > FAINT * loudest}
    bars = [
        (name, 1e6 * float(effects[freedom]), colour)
        for those, colour in ((noises, ORANGE), (told.gains, BLUE))
        for name, effects in sorted(those.items(), key=lambda one: -one[1][freedom])[:BARS]
    ]
    bars.sort(key=lambda bar: -bar[1])
    names, lengths, colours = zip(*bars, strict=True)
    drawn = axes.barh(range(len(bars)), lengths, color=colours)
    axes.bar_label(drawn, [_two(length) for length in lengths], padding=3, fontsize=SMALL)
    axes.set_yticks(range(len(bars)), [fill(name, LINE) for name in names], fontsize=SMALL)
    axes.margins(x=0.16)  # the labels' place
    axes.locator_params(axis="x", nbins=5)
    axes.invert_yaxis()
    common, total = 1e6 * told.common[freedom], 1e6 * told.budget.sigmas[freedom]
    noise = np.sqrt(max(total**2 - common**2, 0.0))
    name, unit = list(FREEDOMS.items())[freedom]
    axes.set(title=f"{name}: {_two(total)} µ{unit}", xlabel=f"taken away by knowing it exactly [µ{unit}]")
    said = [f"noise, in all {_two(noise)}", f"calibration, in all {_two(common)}"]
    axes.legend([Patch(color=ORANGE), Patch(color=BLUE)], said, fontsize=SMALL, loc="lower right")


def _two(value: float) -> str:
    """Return two digits."""
    return f"{value:#.2g}".rstrip(".")


def _errors(axes: Axes, told: Told) -> None:
    fresh, at = told.fresh, np.arange(len(FREEDOMS))
    for shift, values, colour, name in (
        (-0.32, fresh.before, GREY, "as built"),
        (-0.16, fresh.errors, BLUE, "calibrated"),
        (0.0, fresh.sigmas, LIGHT_BLUE, "budget"),
        (0.16, fresh.still_errors, ORANGE, "calibrated, without noise"),
        (0.32, fresh.still_sigmas, GREEN, "its part of the budget"),
    ):
        axes.bar(at + shift, 1e6 * np.sqrt(np.nanmean(np.square(values), axis=0)), 0.15, color=colour, label=name)
    axes.set_yscale("log")
    axes.set_xticks(at, list(FREEDOMS))
    count = int(fresh.known.sum())
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 100.0)  # the legend's place
    axes.set(title=f"Errors at {count} fresh poses", ylabel="root mean square [µm, µrad]")
    axes.legend(fontsize=SMALL, ncols=2, loc="upper center", columnspacing=1.0)


def _quantiles(axes: Axes, told: Told) -> None:
    values = np.sort(told.fresh.normalised[told.fresh.known])
    expected = chi2.ppf((np.arange(len(values)) + 0.5) / len(values), 6)
    limit = chi2.ppf(0.95, 6)
    axes.plot(expected, values, "o", ms=4, color=BLUE, label="fresh poses of this campaign")
    reach = 1.05 * max(float(expected[-1]), float(values[-1]), limit)
    axes.plot([0.0, reach], [0.0, reach], color=GREY, lw=0.8, label="budget right, errors independent")
    axes.axhline(limit, color=ORANGE, ls="--", lw=1.0, label="95 % region")
    axes.set(
        title="Error squared over the budget, all six freedoms", xlabel="quantile of chi-square, 6", ylabel="found"
    )
    axes.legend(fontsize=SMALL)


def _coverage(axes: Axes, coverage: Coverage) -> None:
    families = coverage.families
    at = np.arange(len(families))
    parts = np.array([100.0 * family.inside.value for family in families])
    ends = np.array([[100.0 * end for end in family.interval] for family in families]).T
    axes.errorbar(parts, at, xerr=np.abs(ends - parts), fmt="o", ms=4, color=BLUE, capsize=2, lw=1.0, clip_on=False)
    axes.axvspan(100.0 * CLAIM[0], 100.0 * CLAIM[1], color="#eeeeee", zorder=0)
    axes.axvline(95.0, color=GREY, lw=0.8)
    axes.set_yticks(at, [family.name for family in families], fontsize=SMALL)
    axes.invert_yaxis()
    axes.set(
        title=f"Truth within 95 %, {coverage.campaigns} campaigns",
        xlabel="numbers within [%], and 95 % interval",
        xlim=(min(80.0, float(np.min(ends)) - 1.0), 100.5),
    )
