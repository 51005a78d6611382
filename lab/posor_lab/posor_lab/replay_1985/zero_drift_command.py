# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Digital zero-drift search on the recorded tests of 1985, compared with the shifts of the thesis (8.3.1, table 8.1).

``./run posor_lab zero_drift_1985`` prints, for YMO and YZMO, the zero shifts with uncertainty and correlations,
and the remaining errors of alpha and beta. It fails if these are larger than with the shifts of the thesis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.bags.calibration_recording import Reference, load_recording
from posor.calibration.calibration_file import load_calibration
from posor.calibration.quantity import Quantity
from posor.estimation.posor import Posor
from posor.model.native_coordinates import native_from_rotation
from posor.reporting.command_line_parser import CommandLineParser
from posor_calibration.attitude_fit import ANGLES, deviation_from_first, read_reference_attitude
from posor_calibration.procedures.zero_drift import NAME, ZeroDriftOptions, find_zero_drift
from rich.console import Console
from scipy.constants import inch

from posor_lab.harness.rig_files import bag_path, calibration_path
from posor_lab.lab_output import page_notes
from posor_lab.replay_1985.motion_test import TRUTH_LEVER
from posor_lab.reports.findings import Finding, Findings, exit_code_of_findings, judge, print_findings
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

    from posor_lab.harness.rig_files import Bag

TRUTH = Reference("/truth/machining_centre", (2e-4 * inch,))
"""The machining centre, accurate to 0.0002 in (section 8.2)."""
TESTS: Mapping[Bag, tuple[float | None, float]] = {"ymo": (None, 4.0), "yzmo": (3.0, 7.0)}
"""Standard deviations of alpha and beta [urad] that section 8.4 states for its own shifts; None: not stated."""
_HEADINGS = {"computed": "found shifts", "stated": "thesis says", "limit": "limit", "source": "source"}


def search_zero_shifts(test: Bag, calibration: Calibration, recording: Recording) -> tuple[Findings, list[str]]:
    """Search the zero shifts of one test.

    Returns remaining errors, compared with those of the shifts in the calibration; and lines with the shifts.
    """
    options = ZeroDriftOptions(lever=TRUTH_LEVER, session=test, first_sigma=0.0)
    outcome = find_zero_drift(recording, calibration, options)
    fit = outcome.fits[NAME]
    old = calibration.sessions[test].zero_shifts
    (new,) = outcome.replacements
    shifts = Quantity(value=new.value, sigma=new.sigma, unit="V")
    session = calibration.sessions[test].model_copy(update={"zero_shifts": shifts})
    changed = calibration.model_copy(update={"sessions": {**calibration.sessions, test: session}})
    before, after = (_remaining_deviations(each.for_session(test), recording) / URAD for each in (calibration, changed))
    texts = page_notes("motion_test")["findings"]["zero_drift"]
    findings = []
    for angle, left, known, stated in zip(ANGLES, after, before, TESTS[test], strict=False):
        text, holds = "" if stated is None else f"{stated:g} urad", bool(left <= known)
        findings.append(
            judge(texts, holds=holds, test=test.upper(), angle=angle, after=left, before=known, stated=text)
        )
    lines = [f"{test.upper()}: {outcome.method}"]
    for k, name in enumerate(fit.names):
        thesis = "" if old is None else f" (thesis {old.array[k]:+.3f} V)"
        lines.append(f"  {name}: {fit.values[k]:+.4f} V +- {fit.sigmas[k]:.4f} V{thesis}")
    pairs = [(i, j) for i in range(len(fit.names)) for j in range(i)]
    correlations = ", ".join(f"{j + 1} and {i + 1}: {fit.correlations[i, j]:+.2f}" for i, j in pairs)
    lines += [f"  correlations of the shifts of probes {correlations}", *(f"  {text}" for text in outcome.warnings)]
    return Findings(tuple(findings)), lines


def _remaining_deviations(calibration: Calibration, recording: Recording) -> FloatArray:
    """Return the standard deviations of alpha and beta [rad] over every step that gives a pose, (2,)."""
    estimates = Posor(calibration).estimate_all(recording.scans)
    angles = np.array([native_from_rotation(rotation) for rotation in estimates.rotations])
    reference = read_reference_attitude(recording, TRUTH.topic, lever=TRUTH_LEVER, twist_sigma=0.0, longest_gap_s=0.0)
    errors = (angles - reference.angles)[np.isfinite(angles).all(axis=1), :2]
    return deviation_from_first(errors - errors[0])


def main() -> int:
    """Run the program; return 1 if a search leaves more error than the shifts of the thesis."""
    return exit_code_of_findings(_run)


def _run() -> Findings:
    CommandLineParser(prog="zero_drift_1985", description=__doc__.splitlines()[0]).parse_args()
    console = Console()
    findings: list[Finding] = []
    calibration = load_calibration(calibration_path("section84"))
    for test in TESTS:
        recording = load_recording(bag_path(test), references=[TRUTH])
        found, lines = search_zero_shifts(test, calibration, recording)
        findings += found.findings
        for line in lines:
            console.print(line, soft_wrap=True, markup=False, highlight=False)
    combined = Findings(tuple(findings))
    print_findings(combined, console, "Errors left by the zero shifts found", _HEADINGS)
    return combined
