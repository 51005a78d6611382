"""Digital zero-drift search on the recorded tests of 1985, beside the shifts that the thesis found (8.3.1, table 8.1).

``./run posor_bringup zero_drift_1985``: for YMO and YZMO prints the zero shifts with uncertainty and correlations, and
the errors of alpha and beta that they leave. It fails where these are larger than with the shifts of the thesis.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.bags import Reference, load_recording
from posor_estimator.core.calibrate.attitude_fit import deviation
from posor_estimator.core.calibrate.orientation import ANGLES, orientation_at
from posor_estimator.core.calibrate.zero_drift import NAME, ZeroDriftOptions, find_zero_drift
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.native import native_from_rotation
from posor_estimator.core.posor import Posor
from posor_estimator.errors import PosorError
from posor_estimator.reporting.command_line import Parser
from rich.console import Console

from posor_bringup.findings import Finding, Findings, Verdict
from posor_bringup.findings_table import print_findings
from posor_bringup.installed import bag_path, calibration_path
from posor_bringup.motion import INCH, TRUTH_LEVER
from posor_bringup.thesis import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

    from posor_bringup.expectations import Bag

TRUTH = Reference("/truth/machining_centre", (2e-4 * INCH,))
"""The machining centre, accurate to .0002 in (section 8.2)."""
TESTS: Mapping[Bag, Mapping[str, float | None]] = {
    "ymo": {"alpha": None, "beta": 4.0},
    "yzmo": {"alpha": 3.0, "beta": 7.0},
}
"""What section 8.4 says is left with its own shifts: standard deviation [urad]."""
_HEADINGS = {"computed": "found shifts", "stated": "thesis says", "limit": "limit", "source": "source"}


def search(test: Bag, calibration: Calibration, recording: Recording) -> tuple[Findings, list[str]]:
    """Search the zero shifts of one test.

    Returns:
        The errors left, against those left by the shifts that the calibration has; and lines that tell the shifts.

    """
    options = ZeroDriftOptions(lever=TRUTH_LEVER, session=test, first_sigma=0.0)
    outcome = find_zero_drift(recording, calibration, options)
    fit = outcome.fits[NAME]
    old = calibration.sessions[test].zero_shifts
    (new,) = outcome.replacements
    shifts = Quantity(value=new.value, sigma=new.sigma, unit="V")
    session = calibration.sessions[test].model_copy(update={"zero_shifts": shifts})
    changed = calibration.model_copy(update={"sessions": {**calibration.sessions, test: session}})
    before, after = (_deviations(one.for_session(test), recording) for one in (calibration, changed))
    findings = [
        _finding(test, angle, before[i] / URAD, after[i] / URAD, TESTS[test][angle])
        for i, angle in enumerate(ANGLES[:2])
    ]
    lines = [f"{test.upper()}: {outcome.method}"]
    for k, name in enumerate(fit.names):
        was = "" if old is None else f" (thesis {old.array[k]:+.3f} V)"
        lines.append(f"  {name}: {fit.values[k]:+.4f} V +- {fit.sigmas[k]:.4f} V{was}")
    pairs = [(i, j) for i in range(len(fit.names)) for j in range(i)]
    said = ", ".join(f"{j + 1} and {i + 1}: {fit.correlations[i, j]:+.2f}" for i, j in pairs)
    lines += [f"  correlations of the shifts of probes {said}", *(f"  {warning}" for warning in outcome.warnings)]
    return Findings(tuple(findings)), lines


def _deviations(calibration: Calibration, recording: Recording) -> FloatArray:
    """Return the standard deviations of alpha and beta [rad] over every step that gives a pose, (2,)."""
    found = Posor(calibration).locate_all(recording.scans)
    angles = np.array([native_from_rotation(rotation) for rotation in found.rotations])
    reference = orientation_at(
        recording, recording.scans.stamps_ns, TRUTH.topic, lever=TRUTH_LEVER, twist_sigma=0.0, longest_gap_s=0.0
    )
    errors = (angles - reference.angles)[np.isfinite(angles).all(axis=1), :2]
    return deviation(errors - errors[0])


def _finding(test: Bag, angle: str, before: float, after: float, stated: float | None) -> Finding:
    return Finding(
        f"{test.upper()}, {angle}: error against machining centre, standard deviation",
        f"{after:.2f} urad",
        "" if stated is None else f"{stated:g} urad",
        f"at most {before:.2f} urad, as with the shifts of table 8.1",
        "section 8.4",
        Verdict.of(holds=after <= before),
        "",
    )


def main() -> int:
    """Print what the search finds; 1 where it leaves more error than the shifts of the thesis."""
    Parser(prog="zero_drift_1985", description=__doc__.splitlines()[0]).parse_args()
    console = Console()
    findings: list[Finding] = []
    try:
        calibration = load_calibration(calibration_path("section84"))
        for test in TESTS:
            found, lines = search(test, calibration, load_recording(bag_path(test), references=[TRUTH]))
            findings += found.findings
            for line in lines:
                console.print(line, soft_wrap=True, markup=False, highlight=False)
    except PosorError as complaint:
        sys.stderr.write(f"{complaint}\n")
        return complaint.exit_code
    every = Findings(tuple(findings))
    print_findings(every, console, "Errors left by the zero shifts found", _HEADINGS)
    return 0 if every.holds else 1
