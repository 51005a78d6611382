"""Interactive plots of a replayed motion test: motion and error of each angle, displacement of the endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, MICRON, ORANGE
from posor.reporting.plot import Plot

from posor_lab.replay_1985.motion_figures import DIRECTIONS, MEANING
from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.printed_results import PredictedError, PrintedColumns

REPLAYED, PRINTED, MEASURED = "POSOR, replayed", "POSOR, as printed in 1985", "machining centre"


def plot_angles(
    test: MotionTest, printed: PrintedColumns | None, predictions: Mapping[Angle, PredictedError]
) -> list[Plot]:
    """Return a plot of each angle, then one of the error of each angle; the arguments are those of the picture."""
    same = printed is not None and len(printed.posor) == len(test.steps)
    columns = {angle: printed.posor[:, i] if printed and same else None for i, angle in enumerate(ANGLES)}
    motions = [_plot_motion(test, angle, columns[angle]) for angle in ANGLES]
    errors = [
        _plot_error(test, angle, columns[angle], predictions.get(angle), motion)
        for angle, motion in zip(ANGLES, motions, strict=True)
    ]
    return motions + errors


def plot_displacements(test: MotionTest) -> list[Plot]:
    """Return a plot of the displacement of the endpoint along each axis."""
    plots: list[Plot] = []
    for axis, name in enumerate(DIRECTIONS):
        plot = Plot(f"Endpoint: {name}", "step", "displacement [µm]", x_of=plots[0] if plots else None)
        plot.curve(MEASURED, test.numbers, test.truth_displacement[:, axis] / MICRON, GREY, dash="dashed", marker="x")
        _plot_posor(plot, test, test.endpoint_displacement[:, axis] / MICRON)
        plots.append(plot)
    return plots


def _plot_motion(test: MotionTest, angle: Angle, printed: FloatArray | None) -> Plot:
    column = ANGLES.index(angle)
    plot = Plot(MEANING[angle], "step", f"{angle} [µrad]")
    plot.curve(MEASURED, test.numbers, test.truth_angles[:, column] / URAD, GREY, dash="dashed", marker="x")
    _plot_printed(plot, test, printed)
    _plot_posor(plot, test, test.posor_angles[:, column] / URAD)
    return plot


def _plot_error(
    test: MotionTest, angle: Angle, printed: FloatArray | None, predicted: PredictedError | None, motion: Plot
) -> Plot:
    column = ANGLES.index(angle)
    measured = test.truth_angles[:, column]
    plot = Plot(f"{angle}: POSOR less machining centre", "step", "error [µrad]", x_of=motion)
    plot.zero()
    extra = {}
    if predicted is not None:
        width = predicted.half_width(measured) / URAD
        plot.band("predicted error, section 8.4", test.numbers, -width, width, LIGHT_BLUE)
        extra["predicted error, section 8.4 [µrad]"] = width
    _plot_printed(plot, test, None if printed is None else printed - measured)
    values = test.angle_errors[:, column] / URAD
    _plot_posor(plot, test, values, extra)
    estimated = test.has_pose & ~test.fully_measured(angle)
    if estimated.any():
        plot.mark("estimated reading", np.array(test.numbers)[estimated], values[estimated], BLUE)
    return plot


def _plot_printed(plot: Plot, test: MotionTest, printed: FloatArray | None) -> None:
    if printed is not None:
        plot.curve(PRINTED, test.numbers, printed / URAD, ORANGE, dash=None, marker="square", size=9.0, filled=False)


def _plot_posor(
    plot: Plot, test: MotionTest, values: FloatArray, extra: Mapping[str, FloatArray] | None = None
) -> None:
    """Plot a curve of the POSOR; the status of each step, such as an estimated reading, is shown under the pointer."""
    status = [step.status for step in test.steps]
    plot.curve(REPLAYED, test.numbers, values, BLUE, marker="circle", extra={**(extra or {}), "status": status})
    if not test.has_pose.all():
        plot.strips("no pose", [step.number for step in test.steps if not step.has_pose], 0.4)
