# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Report page of a replay: angles as in figures 8.8 to 8.14, comparison with the thesis, endpoint, steps."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.calibration_file import TiltAngle
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, MICRON, ORANGE
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page, table
from posor.reporting.plot import Plot

from posor_lab.lab_output import page_notes
from posor_lab.replay_1985.motion_test import ANGLES, Angle, MotionTest
from posor_lab.replay_1985.step_table import HEADER, LEGEND, step_row
from posor_lab.reports.findings import findings_table
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.motion_test import Angle, MotionTest
    from posor_lab.replay_1985.printed_results import PredictedError, PrintedColumns
    from posor_lab.reports.findings import Findings

MEANING: Mapping[Angle, str] = {
    "alpha": "alpha, twist about the beam (gap probes)",
    "beta": "beta, turn to the side (gap probes)",
    "theta": "theta, turn upwards or down (diodes)",
}
DIRECTIONS = ("x, along the beam", "y, side to side", "z, vertical")
REPLAYED, PRINTED, MEASURED = "POSOR, replayed", "POSOR, as printed in 1985", "machining centre"
PREDICTED = "predicted error, section 8.4"


def plot_angles(
    test: MotionTest,
    printed: PrintedColumns | None,
    predictions: Mapping[Angle, PredictedError],
    reasons: Mapping[Angle, str],
) -> list[Plot]:
    """Return a plot of each angle, then one of the error of each angle with its prediction.

    The printed result table is drawn if it has as many steps. ``reasons``: why an error leaves its prediction.
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
        values = test.angle_errors[:, column] / URAD
        if angle in predictions:
            width = predictions[angle].half_width(test.truth_angles[:, column]) / URAD
            error.band(PREDICTED, test.numbers, -width, width, LIGHT_BLUE)
            extra[f"{PREDICTED} [µrad]"] = width
            error.note = _outside(np.array(test.numbers)[np.abs(values) > width].tolist(), test, reasons.get(angle))
        _plot_printed(error, test, None if shown is None else shown - measured)
        _plot_posor(error, test, values, extra)
        estimated = test.has_pose & ~test.fully_measured(angle)
        if estimated.any():
            error.mark("estimated reading", np.array(test.numbers)[estimated], values[estimated], BLUE)
        errors.append(error)
    return motions + errors


def _outside(steps: Sequence[int], test: MotionTest, reason: str | None) -> str:
    """Return where an error leaves its band, and why."""
    if not steps:
        return ""
    known = [step.number for step in test.steps if step.has_pose]
    where = f"from step {steps[0]} on" if steps == known[-len(steps) :] else f"in step {', '.join(map(str, steps))}"
    return f"Outside the band {where}: {reason or 'the reason is not known'}."


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


HEADINGS: Mapping[str, str] = {"computed": "replay", "stated": "thesis", "limit": "limit", "source": "source"}
"""Headings of the comparison."""


def verdict_sentence(comparison: Findings) -> str:
    """Return the verdict on a comparison with the thesis."""
    return "The comparison holds." if comparison.holds else "The comparison does not hold."


def replay_page(
    title: str,
    *,
    test: MotionTest,
    comparison: Findings,
    printed: PrintedColumns | None,
    predictions: Mapping[Angle, PredictedError],
    reasons: Mapping[Angle, str],
    calibration: Calibration,
    provenance: Mapping[str, str],
) -> str:
    """Return the self-contained page.

    ``printed``: the printed result table that is drawn beside the test; ``reasons``: see ``plot_angles``.
    """
    steps = table(HEADER, [step_row(step, test.steps[0]) for step in test.steps])
    notes = page_notes("motion_test")
    bullets = {**notes["notes"], "scan": f"{notes['notes']['scan']} {_estimated_steps(test)}"}
    if calibration.tilt_angle is not TiltAngle.PREVIOUS_SCAN:
        del bullets["lag"]
    angles = plot_angles(test, printed, predictions, reasons)
    return render_page(
        title,
        verdict_sentence(comparison),
        holds=comparison.holds,
        sections=(
            Section("Angles and their errors", paragraph(notes["band"]), angles),
            Section("Comparison", findings_table(comparison, HEADINGS)),
            Section("Endpoint, not judged", paragraph(notes["endpoint"]), plot_displacements(test)),
            Section("Steps", paragraph(f"{LEGEND}. All values were received over ROS.") + steps),
            Section("Notes", bullet_list(bullets.values())),
            Section("Provenance", definition_list(provenance)),
        ),
    )


def replay_provenance(
    bag: Path, calibration: Calibration, calibration_path: Path, identity: Mapping[str, str]
) -> dict[str, str]:
    """Return terms and texts on the replayed bag and calibration; ``identity``: ``Replay.calibration_identity``."""
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(bag.glob("*.mcap"))}
    notes = enumerate(calibration.provenance.notes, start=1)
    return {
        "bag": f"{bag.name}: " + ", ".join(f"{name} (SHA-256 {digest})" for name, digest in digests.items()),
        "calibration": f"{calibration.name}, from {calibration_path.name}",
        "calibration hash, as the POSOR node gave it": identity["calibration_hash"],
        "session": identity["session"],
        "source": calibration.provenance.source,
        "made from": calibration.provenance.method,
        **{f"note {number} of the calibration file": note for number, note in notes},
    }


def _estimated_steps(test: MotionTest) -> str:
    """Return which steps were replayed with readings without a legible digit."""
    parts = []
    for name, flag, angles in (
        ("a gap probe", PROBES_ESTIMATED, "alpha and beta"),
        ("a diode", DIODES_ESTIMATED, "theta"),
    ):
        steps = [str(step.number) for step in test.steps if step.scan_status & flag]
        if steps:
            parts.append(
                f"In step {', '.join(steps)} a reading of {name} has no legible digit and was estimated: the step is "
                f"replayed and marked, and its {angles} not judged against printed columns."
            )
    return " ".join(parts) or "No reading of this test had to be estimated."
