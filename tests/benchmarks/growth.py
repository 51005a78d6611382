"""How the cost grows with the number of joints and with the rate: straight lines through it, and what they leave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.figure import Figure
from posor_estimator.reporting.drawing import BLUE, GREY, ORANGE, png, tidy

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

By = Literal["joints", "rate"]
LABELS: dict[By, str] = {"joints": "joints", "rate": "rate [Hz]"}
FULL = 0.01
"""Share of ticks lost from which on a point says nothing of the cost: the machine is full."""
LEAST = 2
"""Points that make a line."""


@dataclass(frozen=True)
class Line:
    """A straight line through the points that hold: ``cores`` is at zero, ``slope`` in cores for each joint or hertz.

    Attributes:
        residuals: Of these points, in the order of ``at`` [cores], (n,).

    """

    at: list[float]
    cores: float
    slope: float
    residuals: list[float]

    def told(self) -> dict[str, Any]:
        """Return it for the JSON file."""
        return {
            "at": self.at,
            "cores_at_zero": self.cores,
            "cores_each": self.slope,
            "residuals_cores": self.residuals,
        }


def series(points: Sequence[dict[str, Any]], by: By, other: int) -> list[dict[str, Any]]:
    """Return the points that differ in one quantity only, in its order; ``other`` is what the other one is."""
    fixed = "rate" if by == "joints" else "joints"
    return sorted((point for point in points if point[fixed] == other), key=lambda point: point[by])


def line(points: Sequence[dict[str, Any]], by: By) -> Line | None:
    """Return the line through the points that hold, by least squares; None: too few for one."""
    good = [point for point in points if holds(point)]
    if len(good) < LEAST:
        return None
    at, cores = np.array([[point[by], point["cpu_cores"]] for point in good], dtype=float).T
    slope, zero = np.polyfit(at, cores, 1)
    return Line(at.tolist(), float(zero), float(slope), (cores - zero - slope * at).tolist())


def holds(point: dict[str, Any]) -> bool:
    """Return whether a point lost next to nothing."""
    return bool(point["lost"] < FULL * point["expected"])


def figure(points: Sequence[dict[str, Any]], joints: int, rate: int) -> bytes:
    """Return the picture (PNG): cost against joints at one rate and against rate with one arm, residuals below."""
    drawing = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = drawing.subplots(2, 2, sharex="col", height_ratios=(3, 1))
    columns: tuple[tuple[By, int, str], ...] = (
        ("joints", rate, f"{rate} Hz"),
        ("rate", joints, f"{joints} joints"),
    )
    for (by, other, title), (above, below) in zip(columns, axes.T, strict=True):
        _draw(above, below, series(points, by, other), by)
        above.set_title(f"All nodes in one process, {title}")
        below.set_xlabel(LABELS[by])
    axes[0, 0].set_ylabel("processor time [cores]")
    axes[1, 0].set_ylabel("residual [cores]")
    return png(drawing)


def _draw(above: Axes, below: Axes, points: Sequence[dict[str, Any]], by: By) -> None:
    fit = line(points, by)
    if fit is not None:
        ends = np.array([0.0, max(fit.at)])
        above.plot(ends, fit.cores + fit.slope * ends, color=BLUE, lw=1.0, label="straight line")
        below.vlines(fit.at, 0.0, fit.residuals, color=BLUE)
        below.plot(fit.at, fit.residuals, "o", color=BLUE, ms=4)
    below.axhline(0.0, color=GREY, lw=0.8)
    for holding, marker, colour, label in ((True, "o", BLUE, "measured"), (False, "x", ORANGE, "lost scans: full")):
        chosen = [point for point in points if holds(point) is holding]
        if chosen:
            cores = [point["cpu_cores"] for point in chosen]
            above.plot([point[by] for point in chosen], cores, marker, color=colour, label=label)
    above.set_ylim(bottom=0.0)
    if points:
        above.legend(frameon=False)
    for ax in (above, below):
        tidy(ax)
