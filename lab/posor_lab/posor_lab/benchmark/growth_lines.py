# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Growth of the processor time with the number of joints and with the rate: straight lines and their residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from markupsafe import Markup
from posor.reporting.figure_style import BLUE, ORANGE
from posor.reporting.html_page import Section, render_page

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.reporting.plot import Plot

By = Literal["joints", "rate"]
LABELS: dict[By, str] = {"joints": "joints", "rate": "rate [Hz]"}
OVERLOADED = 0.01  # share of lost ticks from which a point is left out of the lines: the machine is overloaded
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


def growth_page(points: Sequence[dict[str, Any]], joints: int, rate: int) -> str:
    """Return a page: cores against joints at one rate and against rate for one arm, residuals below."""
    series: tuple[tuple[By, int, str], ...] = (("joints", rate, "Hz"), ("rate", joints, "joints"))
    sections = [
        Section(f"All nodes in one process, {other} {unit}", Markup(), _plots(select_series(points, by, other), by))
        for by, other, unit in series
    ]
    count = sum(map(is_overloaded, points))
    verdict = f"{len(points)} graphs measured, {count} overloaded."
    return render_page("Growth of the processor time", verdict, holds=count == 0, sections=sections)


def _plots(points: Sequence[dict[str, Any]], by: By) -> list[Plot]:
    from posor.reporting.plot import Plot  # noqa: PLC0415  takes a second to load

    above = Plot(f"processor time by {by}", LABELS[by], "processor time [cores]")
    below = Plot(f"residuals by {by}", LABELS[by], "residual [cores]", x_of=above)
    if (fit := fit_line(points, by)) is not None:
        ends = np.array([0.0, max(fit.at)])
        above.curve("straight line", ends, fit.cores_at_zero + fit.cores_each * ends, BLUE)
        below.curve("residual", fit.at, fit.residuals_cores, BLUE, dash=None, marker="circle")
    below.zero()
    above.zero()
    for overloaded, marker, colour, name in ((False, "circle", BLUE, "measured"), (True, "x", ORANGE, "overloaded")):
        shown = [point for point in points if is_overloaded(point) is overloaded]
        at, cores = [point[by] for point in shown], [point["cpu_cores"] for point in shown]
        if shown:
            above.curve(name, at, cores, colour, dash=None, marker=marker)
    return [above, below]
