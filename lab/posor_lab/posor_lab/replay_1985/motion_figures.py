"""Figures of a replayed motion test, as figures 8.8 to 8.14 of the thesis: motion and error of each angle, endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from posor.reporting.figure_style import (
    BLUE,
    GREY,
    LIGHT_BLUE,
    MICRON,
    ORANGE,
    style_axes,
    to_png,
    unique_legend_entries,
)

from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.printed_results import PredictedError, PrintedColumns

MEANING: Mapping[Angle, str] = {
    "alpha": "alpha, twist about the beam (gap probes)",
    "beta": "beta, turn to the side (gap probes)",
    "theta": "theta, turn upwards or down (diodes)",
}
DIRECTIONS = ("x, along the beam", "y, side to side", "z, vertical")
STYLE: Mapping[str, dict[str, Any]] = {
    "posor": {"color": BLUE, "marker": "o", "ms": 4.0, "lw": 1.4, "label": "POSOR, replayed"},
    "printed": {
        "color": ORANGE,
        "marker": "s",
        "ms": 7.0,
        "mfc": "none",
        "mew": 1.3,
        "lw": 0.0,
        "label": "POSOR, as printed in 1985",
    },
    "estimated": {
        "color": BLUE,
        "marker": "o",
        "ms": 7.5,
        "mfc": "white",
        "mew": 1.5,
        "lw": 0.0,
        "label": "estimated reading",
    },
    "truth": {"color": GREY, "ls": "--", "marker": "x", "ms": 4.0, "lw": 1.0, "label": "machining centre"},
}


def draw_motion_test(
    test: MotionTest, title: str, printed: PrintedColumns | None, predictions: Mapping[Angle, PredictedError]
) -> bytes:
    """Return a picture (PNG) of all curves: one column for each angle, and the displacement of the endpoint below.

    Args:
        test: The replayed test.
        title: Heading.
        printed: The printed result table; it is drawn if it has as many steps.
        predictions: Predicted error of each angle.

    """
    figure = Figure(figsize=(13.0, 10.2), layout="constrained")
    figure.suptitle(title, fontsize=14, fontweight="bold")
    rows = figure.subplots(3, 3, sharex=True)
    same = printed is not None and len(printed.posor) == len(test.steps)
    for column, angle in enumerate(ANGLES):
        shown = printed.posor[:, column] if printed is not None and same else None
        _plot_motion(rows[0][column], test, angle, shown)
        _plot_error(rows[1][column], test, angle, shown, predictions.get(angle))
        _plot_displacement(rows[2][column], test, column)
    figure.legend(
        *unique_legend_entries([axes for row in rows for axes in row]),
        loc="outside lower center",
        ncols=6,
        frameon=False,
        fontsize=10,
    )
    return to_png(figure)


def _plot_motion(axes: Axes, test: MotionTest, angle: Angle, printed: FloatArray | None) -> None:
    column = ANGLES.index(angle)
    axes.set_title(MEANING[angle], fontsize=11)
    axes.plot(test.numbers, test.truth_angles[:, column] / URAD, **STYLE["truth"])
    if printed is not None:
        axes.plot(test.numbers, printed / URAD, **STYLE["printed"])
    axes.plot(test.numbers, test.posor_angles[:, column] / URAD, **STYLE["posor"])
    _mark_steps_without_pose(axes, test)
    _label_axes(axes, f"{angle} [µrad]" if column else f"motion\n{angle} [µrad]", test)


def _plot_error(
    axes: Axes, test: MotionTest, angle: Angle, printed: FloatArray | None, predicted: PredictedError | None
) -> None:
    column = ANGLES.index(angle)
    measured = test.truth_angles[:, column]
    axes.axhline(0.0, color=GREY, lw=0.8)
    if predicted is not None:
        width = predicted.half_width(measured) / URAD
        axes.fill_between(
            test.numbers, -width, width, color=LIGHT_BLUE, alpha=0.3, lw=0.0, label="predicted error (section 8.4)"
        )
        axes.text(
            0.02,
            0.02,
            f"predicted: {predicted.terms.split(' (')[0].replace('; ', ', ')} µrad",
            transform=axes.transAxes,
            fontsize=7.5,
            color="#444444",
            bbox={"facecolor": "white", "alpha": 0.7, "lw": 0.0, "pad": 1.0},
        )
    if printed is not None:
        axes.plot(test.numbers, (printed - measured) / URAD, **STYLE["printed"])
    axes.plot(test.numbers, test.angle_errors[:, column] / URAD, **STYLE["posor"])
    estimated = test.has_pose & ~test.fully_measured(angle)
    if estimated.any():
        numbers = np.array(test.numbers)[estimated]
        axes.plot(numbers, test.angle_errors[estimated, column] / URAD, **STYLE["estimated"])
    _mark_steps_without_pose(axes, test)
    axes.margins(y=0.12)
    _label_axes(axes, "error [µrad]" if column else "POSOR - machining centre\nerror [µrad]", test)


def _plot_displacement(axes: Axes, test: MotionTest, axis: int) -> None:
    axes.set_title(DIRECTIONS[axis], fontsize=11)
    axes.plot(test.numbers, test.truth_displacement[:, axis] / MICRON, **STYLE["truth"])
    axes.plot(test.numbers, test.endpoint_displacement[:, axis] / MICRON, **STYLE["posor"])
    _mark_steps_without_pose(axes, test)
    axes.set_xlabel("step")
    _label_axes(axes, "displacement [µm]" if axis else "endpoint (not judged: other lever)\ndisplacement [µm]", test)


def _mark_steps_without_pose(axes: Axes, test: MotionTest) -> None:
    for step in test.steps:
        if not step.has_pose:
            axes.axvspan(
                step.number - 0.4,
                step.number + 0.4,
                facecolor="none",
                edgecolor="#999999",
                hatch="////",
                lw=0.0,
                label="no pose",
            )


def _label_axes(axes: Axes, label: str, test: MotionTest) -> None:
    axes.set_ylabel(label, fontsize=9.5)
    axes.set_xlim(min(test.numbers) - 0.6, max(test.numbers) + 0.6)
    axes.set_xticks(test.numbers[:: 1 + len(test.numbers) // 16])
    style_axes(axes)
