"""The picture of a calibration campaign: residuals, truth against estimate, budget, fresh poses, coverage."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure as Drawing
from posor_estimator.reporting.drawing import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE, png, tidy
from scipy.stats import chi2, norm

from posor_bringup.campaign.fresh import FREEDOMS
from posor_bringup.campaign.judged import WITHIN_95
from posor_bringup.campaign.many import CLAIM
from posor_bringup.campaign.told import NOISE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from posor_estimator.core.calibrate.procedure import Figure

    from posor_bringup.campaign.told import Told

STYLES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (LIGHT_BLUE, "D"))
BARS = 5
"""Quantities drawn for each freedom, those that matter most."""
SHORT = 30
"""Letters of a quantity's name that are drawn."""


def draw(told: Told, title: str) -> bytes:
    """Return the picture (PNG)."""
    figure = Drawing(figsize=(16.0, 22.0), layout="constrained")
    figure.suptitle(title, fontsize=15)
    axes = figure.subplots(5, 3)
    by_step = {bag.step.procedure: bag.outcome for bag in told.bagged}
    linearised = by_step["gap_linearisation"].figures
    _points(axes[0, 0], "Gap probes: residuals of the linearisation", _joined(linearised))
    across = "diode_map" if "diode_map" in by_step else "ring_profile"
    shown = [figure for bag in told.bagged if bag.step.procedure == across for figure in bag.outcome.figures]
    titles = {"diode_map": "Diodes: residuals of the maps", "ring_profile": "Bumpy ring: change of the profile"}
    _points(axes[0, 1], titles[across], _joined(shown), line=across == "ring_profile")
    _histogram(axes[0, 2], told)
    _points(axes[1, 0], "Zero drift: error of alpha", by_step["zero_drift"].figures[0])
    _points(axes[1, 1], "Target plane: alpha that is none", by_step["target_plane"].figures[0])
    _pulls(axes[1, 2], told)
    for n, one in enumerate(axes[2:4].ravel()):
        _budget(one, told, n)
    _errors(axes[4, 0], told)
    _quantiles(axes[4, 1], told)
    _coverage(axes[4, 2], told)
    for one in axes.ravel():
        tidy(one)
    return png(figure)


def _joined(figures: Sequence[Figure]) -> Figure:
    """Return several charts of the same quantities as one, each series by its chart's title and its own name."""
    first = figures[0]
    if len(figures) == 1:
        return first
    series = {}
    for n, figure in enumerate(figures):
        head = figure.title.split(":")[0] if ":" in figure.title else str(n + 1)
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
    axes.set(title=title, xlabel=figure.x_label, ylabel=figure.y_label)
    if any(figure.series):
        axes.legend(fontsize=8, ncols=2)


def _histogram(axes: Axes, told: Told) -> None:
    found = next(bag.outcome for bag in told.bagged if bag.step.procedure == "bundle").fits["bundle"]
    at = np.linspace(-4.0, 4.0, 33)
    axes.hist(np.clip(found.residuals, -4.0, 4.0), at.tolist(), density=True, color=LIGHT_BLUE, label="residuals")
    fine = np.linspace(-4.0, 4.0, 200)
    seen = np.sqrt(np.mean(np.square(found.residuals)))
    axes.plot(fine, norm.pdf(fine), color=GREY, label="standard normal")
    axes.plot(fine, norm.pdf(fine, scale=seen), color=ORANGE, ls="--", label=f"normal, deviation {seen:.2f}")
    axes.set(title=f"Bundle: {len(found.residuals)} residuals", xlabel="residual / standard uncertainty")
    axes.legend(fontsize=8)


def _pulls(axes: Axes, told: Told) -> None:
    families = list(dict.fromkeys(number.family for number in told.numbers))
    for number in told.numbers:
        colour = BLUE if number.inside else ORANGE
        axes.plot(number.pull, families.index(number.family), "o", ms=4, alpha=0.7, color=colour)
    axes.axvspan(-WITHIN_95, WITHIN_95, color="#eeeeee", zorder=0)
    axes.axvline(0.0, color=GREY, lw=0.8)
    axes.set_yticks(range(len(families)), families, fontsize=7.5)
    axes.invert_yaxis()
    reach = max(3.5, 1.1 * max(abs(number.pull) for number in told.numbers))
    axes.set(title="Estimate less truth, each number", xlabel="stated standard uncertainties", xlim=(-reach, reach))


def _budget(axes: Axes, told: Told, freedom: int) -> None:
    largest = sorted(told.gains, key=lambda one: told.gains[one][freedom], reverse=True)[:BARS]
    names = [one if len(one) <= SHORT else f"{one[: SHORT - 1]}…" for one in largest]
    colours = [ORANGE if one == NOISE else BLUE for one in largest]
    axes.barh(range(len(largest)), [1e6 * told.gains[one][freedom] for one in largest], color=colours)
    axes.set_yticks(range(len(largest)), names, fontsize=7.5)
    total = 1e6 * told.budget.sigmas[freedom]
    axes.axvline(total, color=GREY, ls="--", lw=1.2)
    axes.invert_yaxis()
    name, unit = list(FREEDOMS.items())[freedom]
    unit = f"µ{unit}"
    axes.set(
        title=f"Budget of {name}: {total:.3g} {unit} (dashed)",
        xlabel=f"taken away by knowing it exactly [{unit}]",
    )


def _errors(axes: Axes, told: Told) -> None:
    fresh, at = told.fresh, np.arange(len(FREEDOMS))
    for shift, values, colour, name in (
        (-0.27, fresh.before, GREY, "as built"),
        (0.0, fresh.errors, BLUE, "calibrated"),
        (0.27, fresh.sigmas, LIGHT_BLUE, "budget"),
    ):
        axes.bar(at + shift, 1e6 * np.sqrt(np.nanmean(np.square(values), axis=0)), 0.25, color=colour, label=name)
    axes.set_yscale("log")
    axes.set_xticks(at, list(FREEDOMS))
    count = int(np.isfinite(fresh.normalised).sum())
    axes.set(title=f"Errors at {count} fresh poses", ylabel="root mean square [µm, µrad]")
    axes.legend(fontsize=8)


def _quantiles(axes: Axes, told: Told) -> None:
    values = np.sort(told.fresh.normalised[np.isfinite(told.fresh.normalised)])
    expected = chi2.ppf((np.arange(len(values)) + 0.5) / len(values), 6)
    limit = chi2.ppf(0.95, 6)
    axes.plot(expected, values, "o", ms=4, color=BLUE, label="fresh poses of this campaign")
    reach = 1.05 * max(float(expected[-1]), float(values[-1]), limit)
    axes.plot([0.0, reach], [0.0, reach], color=GREY, lw=0.8, label="budget right, errors independent")
    axes.axhline(limit, color=ORANGE, ls="--", lw=1.0, label="95 % region")
    axes.set(
        title="Error squared over the budget, all six freedoms", xlabel="quantile of chi-square, 6", ylabel="found"
    )
    axes.legend(fontsize=8)


def _coverage(axes: Axes, told: Told) -> None:
    coverage = told.coverage
    if coverage is None:
        axes.text(0.5, 0.5, "no further campaigns were run", ha="center", transform=axes.transAxes)
        axes.set_axis_off()
        return
    families = coverage.families
    at = np.arange(len(families))
    parts = np.array([100.0 * family.inside.value for family in families])
    errors = np.array([200.0 * family.inside.sigma for family in families])
    axes.errorbar(parts, at, xerr=errors, fmt="o", ms=4, color=BLUE, capsize=2, lw=1.0)
    axes.axvspan(100.0 * CLAIM[0], 100.0 * CLAIM[1], color="#eeeeee", zorder=0)
    axes.axvline(95.0, color=GREY, lw=0.8)
    axes.set_yticks(at, [family.name for family in families], fontsize=7.5)
    axes.invert_yaxis()
    axes.set(
        title=f"{coverage.campaigns} campaigns: truth within the 95 % interval",
        xlabel="part of the numbers [%], two standard deviations",
        xlim=(min(80.0, float(np.min(parts - errors)) - 1.0), 101.5),
    )
