"""Report page of a replay: comparison with the thesis, steps, notes, provenance."""

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

from posor_lab.replay_1985.step_table import HEADER, LEGEND, step_row
from posor_lab.reports.findings import findings_table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.reporting.plot import Plot
    from posor_bringup.installed import Bag, CalibrationName

    from posor_lab.replay_1985.motion_test import MotionTest
    from posor_lab.reports.findings import Findings

HEADINGS: Mapping[str, str] = {"computed": "replay", "stated": "thesis", "limit": "limit", "source": "source"}
"""Headings of the comparison."""
MOTIONS: Mapping[Bag, str] = {
    "ymo": "Y motion, side to side",
    "yzmo": "diagonal motion, Y and Z together",
    "zmo": "Z motion, up and down",
}
STATES: Mapping[CalibrationName, str] = {
    "printed": "as in the printed tables, zero shifts not compensated",
    "section84": "as in section 8.4, zero shifts compensated",
}

_INCREMENTAL = (
    "All values are relative to step 1. Standard deviation as in the thesis: root of the "
    "sum of squared errors of steps 2 to N over N - 2, N being the number of steps that gave a pose."
)
_MEASURED = (
    "By the machining centre, beta = -atan(y / 798.3 mm) and theta = -atan(z / 798.3 mm), 31.43 in in the listings; "
    "alpha is zero, since the tests do not twist the beam."
)
_SCAN = (
    "The listings survive in a poor scan. Damaged digits of the input record were repaired from neighbouring steps and "
    "from the printed results, so agreement with these is not independent of the repairs in every step."
)
_LAG = (
    "tilt_angle: previous_scan. The 1985 program turned the target plane's tilt and the rays by the theta of the step "
    "before. The calibration file has the same setting, to reproduce the printed tables; the exact model is this_scan."
)
_REBUILT = (
    "The contact currents in the bag were rebuilt from the recorded ratios with a nominal total, which cancels. The "
    "1985 diode maps are lost; the calibration holds local fits derived from the records themselves."
)
_ENDPOINT = (
    "The endpoint is 848 mm (33.4 in) from the POSOR's origin; the machining centre read at a scribed line 798 mm "
    "(31.43 in) from its pivot. The two displacements therefore differ, by about 6 % from the levers and further by "
    "the motion of the "
    "POSOR's origin itself; of x, along the beam, the thesis gives no POSOR result at all. They are shown side by "
    "side; only angles are judged."
)
_BAND = (
    "The band is the error that section 8.4 predicts for this test: constant terms added up, the increasing term in "
    "proportion to the motion. It holds for compensated zero shifts, as in calibration 'section84'."
)


def replay_page(
    title: str,
    *,
    test: MotionTest,
    comparison: Findings,
    angles: Sequence[Plot],
    displacements: Sequence[Plot],
    notes: Sequence[str],
    provenance: Mapping[str, str],
) -> str:
    """Return the self-contained page.

    Args:
        title: Heading.
        test: The replayed test.
        comparison: Its comparison with the thesis.
        angles: Plots of the angles and their errors.
        displacements: Plots of the endpoint.
        notes: Notes on how to read the figures.
        provenance: Terms and texts.

    """
    steps = table(HEADER, [step_row(step, test.steps[0]) for step in test.steps], "numbers")
    return render_page(
        title,
        "The comparison holds." if comparison.holds else "The comparison does not hold.",
        holds=comparison.holds,
        sections=(
            Section("Angles and their errors", paragraph(_BAND), angles),
            Section("Comparison", findings_table(comparison, HEADINGS)),
            Section("Endpoint, not judged", paragraph(_ENDPOINT), displacements),
            Section("Steps", paragraph(f"{LEGEND}. All values were received over ROS.") + steps),
            Section("Notes", bullet_list(notes)),
            Section("Provenance", definition_list(provenance)),
        ),
    )


def replay_provenance(
    bag: Path, calibration: Calibration, calibration_path: Path, identity: Mapping[str, str]
) -> dict[str, str]:
    """Return terms and texts on the replayed bag and calibration.

    Args:
        bag: Folder of the bag.
        calibration: Content of the calibration file.
        calibration_path: The calibration file.
        identity: ``Replay.calibration_identity``.

    """
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(bag.glob("*.mcap"))}
    terms = {
        "bag": f"{bag.name}: " + ", ".join(f"{name} (SHA-256 {digest})" for name, digest in digests.items()),
        "calibration": f"{calibration.name}, from {calibration_path.name}",
        "calibration hash, as the POSOR node gave it": identity["calibration_hash"],
        "session": identity["session"],
        "source": calibration.provenance.source,
        "made from": calibration.provenance.method,
    }
    notes = enumerate(calibration.provenance.notes, start=1)
    return terms | {f"note {number} of the calibration file": note for number, note in notes}


def replay_notes(test: MotionTest, calibration: Calibration) -> list[str]:
    """Return notes on how to read the figures."""
    lag = [_LAG] if calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN else []
    return [
        f"{_INCREMENTAL} {_MEASURED}",
        f"{_SCAN} {_estimated_steps(test)}",
        *lag,
        _REBUILT,
    ]


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
