"""Report page of a replay: angles, comparison with the thesis, endpoint, steps, notes, provenance."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from posor.calibration.calibration_file import TiltAngle
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.reporting.html_page import (
    Section,
    bullet_list,
    definition_list,
    paragraph,
    render_page,
    table,
)

from posor_lab.output_files import page_notes
from posor_lab.replay_1985.motion_plots import plot_angles, plot_displacements
from posor_lab.replay_1985.step_table import HEADER, LEGEND, step_row
from posor_lab.reports.findings import findings_table

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration

    from posor_lab.replay_1985.motion_test import Angle, MotionTest
    from posor_lab.replay_1985.printed_results import PredictedError, PrintedColumns
    from posor_lab.reports.findings import Findings

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
    calibration: Calibration,
    provenance: Mapping[str, str],
) -> str:
    """Return the self-contained page.

    Args:
        title: Heading.
        test: The replayed test.
        comparison: Its comparison with the thesis.
        printed: Printed result table that is drawn beside the test, if there is one.
        predictions: Predicted error of each angle.
        calibration: Content of the calibration file.
        provenance: Terms and texts.

    """
    steps = table(HEADER, [step_row(step, test.steps[0]) for step in test.steps], "numbers")
    notes = page_notes("motion_test")
    bullets = {**notes["notes"], "scan": f"{notes['notes']['scan']} {_estimated_steps(test)}"}
    if calibration.tilt_angle is not TiltAngle.PREVIOUS_SCAN:
        del bullets["lag"]
    return render_page(
        title,
        verdict_sentence(comparison),
        holds=comparison.holds,
        sections=(
            Section("Angles and their errors", paragraph(notes["band"]), plot_angles(test, printed, predictions)),
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
