"""Interactive plots of a motion test, as figures 8.8 to 8.14 of the thesis: each angle, its error, the endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, MICRON, ORANGE
from posor.reporting.plot import Plot

from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.printed_results import PredictedError, PrintedColumns

MEANING: Mapping[Angle, str] = {
    "alpha": "alpha, twist about the beam (gap probes)",
    "beta": "beta, turn to the side (gap probes)",
    "theta": "theta, turn upwards or down (diodes)",
}
DIRECTIONS = ("x, along the beam", "y, side to side", "z, vertical")
REPLAYED, PRINTED, MEASURED = "POSOR, replayed", "POSOR, as printed in 1985", "machining centre"
PREDICTED = "predicted error, section 8.4"


def plot_angles(
    test: MotionTest, printed: PrintedColumns | None, predictions: Mapping[Angle, PredictedError]
) -> list[Plot]:
    """Return a plot of each angle, then one of the error of each angle.

    Args:
        test: The motion test.
        printed: The printed result table; it is drawn if it has as many steps.
        predictions: Predicted error of each angle.

    """
    motions, errors = [], []
    for column, angle in enumerate(ANGLES):
        same = printed is not None and len(printed.posor) == len(test.steps)
        shown = printed.posor[:, column] / URAD if printed is not None and same else None
        measured = test.truth_angles[:, column] / URAD
        motion = Plot(MEANING[angle], "step", f"{angle} [µrad]")
        _plot_measured(motion, test, measured)
        _plot_printed(motion, test, shown)
        _plot_posor(motion, test, test.posor_angles[:, column] / URAD, {})
        motions.append(motion)
        error = Plot(f"{angle}: POSOR less machining centre", "step", "error [µrad]", x_of=motion)
        error.zero()
        extra = {}
        if angle in predictions:
            width = predictions[angle].half_width(test.truth_angles[:, column]) / URAD
            error.band(PREDICTED, test.numbers, -width, width, LIGHT_BLUE)
            extra[f"{PREDICTED} [µrad]"] = width
        _plot_printed(error, test, None if shown is None else shown - measured)
        values = test.angle_errors[:, column] / URAD
        _plot_posor(error, test, values, extra)
        estimated = test.has_pose & ~test.fully_measured(angle)
        if estimated.any():
            error.mark("estimated reading", np.array(test.numbers)[estimated], values[estimated], BLUE)
        errors.append(error)
    return motions + errors


def plot_displacements(test: MotionTest) -> list[Plot]:
    """Return a plot of the displacement of the endpoint along each axis."""
    plots: list[Plot] = []
    for axis, name in enumerate(DIRECTIONS):
        plot = Plot(f"Endpoint: {name}", "step", "displacement [µm]", x_of=plots[0] if plots else None)
        _plot_measured(plot, test, test.truth_displacement[:, axis] / MICRON)
        _plot_posor(plot, test, test.endpoint_displacement[:, axis] / MICRON, {})
        plots.append(plot)
    return plots


def _plot_measured(plot: Plot, test: MotionTest, values: FloatArray) -> None:
    plot.curve(MEASURED, test.numbers, values, GREY, dash="dashed", marker="x")


def _plot_printed(plot: Plot, test: MotionTest, values: FloatArray | None) -> None:
    if values is not None:
        plot.curve(PRINTED, test.numbers, values, ORANGE, dash=None, marker="square", size=9.0, filled=False)


def _plot_posor(plot: Plot, test: MotionTest, values: FloatArray, extra: Mapping[str, FloatArray]) -> None:
    """Plot a curve of the POSOR; the status of each step, such as an estimated reading, is shown under the pointer."""
    status = [step.status for step in test.steps]
    plot.curve(REPLAYED, test.numbers, values, BLUE, marker="circle", extra={**extra, "status": status})
    if not test.has_pose.all():
        plot.strips("no pose", [step.number for step in test.steps if not step.has_pose], 0.4)
