"""What a reader of the report has to know: where the numbers come from and how far they can be trusted."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from posor_estimator.core.calibration.model import TiltAngle

from posor_bringup.motion import DIODES_ESTIMATED, PROBES_ESTIMATED

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor_estimator.core.calibration.model import Calibration

    from posor_bringup.expectations import Bag, CalibrationName
    from posor_bringup.motion import MotionTest

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
    "All values are incremental: the value at step 1 is taken off. Standard deviation as in the thesis: root of the "
    "sum of squared errors of steps 2 to N over N - 2, N being the number of steps that gave a pose."
)
_MEASURED = (
    "By the machining centre, beta = -atan(y / 31.43 in) and theta = -atan(z / 31.43 in); alpha is zero, since the "
    "tests do not twist the beam."
)
_SCAN = (
    "The listings survive in a poor scan. Damaged digits of the input record were repaired from neighbouring steps and "
    "from the printed results, so agreement with these is not independent of the repairs in every step."
)
_LAG = (
    "tilt_angle: previous_scan. The 1985 program turned the target plane's tilt and the rays by the theta of the step "
    "before. The calibration file asks for the same, since it is to reproduce the printed tables; the exact model is "
    "this_scan."
)
_REBUILT = (
    "The contact currents in the bag were rebuilt from the recorded ratios with a nominal total, which cancels. The "
    "1985 diode maps are lost; the calibration holds local fits derived from the records themselves."
)
_ENDPOINT = (
    "The endpoint is 33.4 in from the POSOR's origin; the machining centre read at a scribed line 31.43 in from its "
    "pivot. The two displacements therefore differ, by about 6 % from the levers and further by the motion of the "
    "POSOR's origin itself; of x, along the beam, the thesis gives no POSOR result at all. They are shown side by side "
    "without a judgement; only angles are judged."
)
_BAND = (
    "The band is the error that section 8.4 predicts for this test: constant terms added up, the increasing term in "
    "proportion to the motion. It presumes compensated zero shifts, as in calibration 'section84'."
)
_ZMO = (
    "In this test beta exceeds the machining centre's by a nearly constant 60 urad from step 2 on. All three probes "
    "support the readings of step 1, so no digit was changed for it."
)


def provenance(bag: Path, calibration: Calibration, path: Path, identity: Mapping[str, str]) -> dict[str, str]:
    """Return what was replayed with what, term and text.

    Args:
        bag: Folder of the bag.
        calibration: Content of the calibration file.
        path: The calibration file.
        identity: What the POSOR node said in its diagnostics.

    """
    files = ", ".join(f"{file.name} (SHA-256 {_sha256(file)})" for file in sorted(bag.glob("*.mcap")))
    terms = {
        "bag": f"{bag.name}: {files}",
        "calibration": f"{calibration.name}, from {path.name}",
        "calibration hash, as the POSOR node gave it": identity["calibration_hash"],
        "session": identity["session"],
        "source": calibration.provenance.source,
        "made from": calibration.provenance.method,
    }
    for number, note in enumerate(calibration.provenance.notes, start=1):
        terms[f"note {number} of the calibration file"] = note
    return terms


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def notes(bag: Bag, test: MotionTest, calibration: Calibration) -> list[str]:
    """Return what has to be known to judge the figures."""
    told = [
        f"{_INCREMENTAL} {_MEASURED}",
        f"{_SCAN} {_estimated(test)}",
        _REBUILT,
        _ENDPOINT,
        _BAND,
    ]
    if calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN:
        told.insert(2, _LAG)
    if bag == "zmo":
        told.append(_ZMO)
    return told


def _estimated(test: MotionTest) -> str:
    """Return which steps were replayed with readings that had no legible digit."""
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
