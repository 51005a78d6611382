"""Growth of the processor time with the number of joints and with the rate: straight lines and their residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.figure import Figure
from posor.reporting.figure_style import BLUE, GREY, ORANGE, style_axes, to_png

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

By = Literal["joints", "rate"]
LABELS: dict[By, str] = {"joints": "joints", "rate": "rate [Hz]"}
OVERLOADED = 0.01
"""Share of lost ticks from which a point is left out of the lines: the machine is overloaded."""
MIN_POINTS = 2


@dataclass(frozen=True)
class GrowthLine:
    """A straight line through the points that are not overloaded."""

    at: list[float]  # joints or rates [Hz] of these points, (n,)
    cores_at_zero: float  # intercept [cores]
    cores_each: float  # slope [cores per joint or per hertz]
    residuals_cores: list[float]  # residuals of these points [cores], (n,)


def select_series(points: Sequence[dict[str, Any]], by: By, other: int) -> list[dict[str, Any]]:
    """Return the points with ``other`` joints or hertz, sorted by the other quantity, ``by``."""
    fixed = "rate" if by == "joints" else "joints"
    return sorted((point for point in points if point[fixed] == other), key=lambda point: point[by])


def fit_line(points: Sequence[dict[str, Any]], by: By) -> GrowthLine | None:
    """Return the least-squares line through the points that are not overloaded; None: too few points."""
    usable = [point for point in points if not is_overloaded(point)]
    if len(usable) < MIN_POINTS:
        return None
    at, cores = np.array([[point[by], point["cpu_cores"]] for point in usable], dtype=float).T
    slope, zero = np.polyfit(at, cores, 1)
    return GrowthLine(at.tolist(), float(zero), float(slope), (cores - zero - slope * at).tolist())


def is_overloaded(point: dict[str, Any]) -> bool:
    """Return whether a point lost so many ticks that its processor time is not comparable."""
    return bool(point["lost"] >= OVERLOADED * point["expected"])


def draw_growth(points: Sequence[dict[str, Any]], joints: int, rate: int) -> bytes:
    """Return a picture (PNG): cores against joints at one rate and against rate for one arm, residuals below."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", height_ratios=(3, 1))
    columns: tuple[tuple[By, int, str], ...] = (
        ("joints", rate, f"{rate} Hz"),
        ("rate", joints, f"{joints} joints"),
    )
    for (by, other, title), (above, below) in zip(columns, axes.T, strict=True):
        _draw_series(above, below, select_series(points, by, other), by)
        above.set_title(f"All nodes in one process, {title}")
        below.set_xlabel(LABELS[by])
    axes[0, 0].set_ylabel("processor time [cores]")
    axes[1, 0].set_ylabel("residual [cores]")
    return to_png(figure)


def _draw_series(above: Axes, below: Axes, points: Sequence[dict[str, Any]], by: By) -> None:
    fit = fit_line(points, by)
    if fit is not None:
        ends = np.array([0.0, max(fit.at)])
        above.plot(ends, fit.cores_at_zero + fit.cores_each * ends, color=BLUE, lw=1.0, label="straight line")
        below.vlines(fit.at, 0.0, fit.residuals_cores, color=BLUE)
        below.plot(fit.at, fit.residuals_cores, "o", color=BLUE, ms=4)
    below.axhline(0.0, color=GREY, lw=0.8)
    for overloaded, marker, colour, label in ((False, "o", BLUE, "measured"), (True, "x", ORANGE, "overloaded")):
        shown = [point for point in points if is_overloaded(point) is overloaded]
        if shown:
            cores = [point["cpu_cores"] for point in shown]
            above.plot([point[by] for point in shown], cores, marker, color=colour, label=label)
    above.set_ylim(bottom=0.0)
    if points:
        above.legend(frameon=False)
    for ax in (above, below):
        style_axes(ax)
