# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The zero-drift search on the recorded tests of 1985: less error than the thesis' own shifts leave."""

from __future__ import annotations

import re

import numpy as np
import pytest
from posor.bags.calibration_recording import load_recording
from posor.calibration.calibration_file import load_calibration
from posor_calibration.procedures.zero_drift import NAME, ZeroDriftOptions, find_zero_drift
from posor_lab.harness.rig_files import Bag, bag_path, calibration_path
from posor_lab.replay_1985.zero_drift_command import TESTS, TRUTH, main, search_zero_shifts
from posor_lab.thesis_data import URAD

LEFT = {("ymo", "alpha"): 1.95, ("ymo", "beta"): 2.65, ("yzmo", "alpha"): 1.82, ("yzmo", "beta"): 5.65}
"""Standard deviation [urad] that the shifts found leave, over every step that gives a pose."""
THESIS = {("ymo", "alpha"): 14.7, ("ymo", "beta"): 4.26, ("yzmo", "alpha"): 2.62, ("yzmo", "beta"): 7.43}
"""The same for the shifts of table 8.1."""


@pytest.mark.parametrize("test", TESTS)
def test_less_error_than_the_shifts_of_the_thesis(test: Bag) -> None:
    calibration = load_calibration(calibration_path("section84"))
    findings, lines = search_zero_shifts(test, calibration, load_recording(bag_path(test), references=[TRUTH]))
    assert findings.holds
    for finding, angle in zip(findings.findings, ("alpha", "beta"), strict=True):
        assert finding.computed.endswith(" urad")
        assert float(finding.computed.split()[0]) == pytest.approx(LEFT[test, angle], abs=0.03)
        assert float(finding.limit.split()[2]) == pytest.approx(THESIS[test, angle], abs=0.05)
    assert any(line.startswith("  correlations of the shifts of probes") for line in lines)


def test_shifts_agree_with_the_thesis_within_their_uncertainty() -> None:
    calibration = load_calibration(calibration_path("section84"))
    recording = load_recording(bag_path("ymo"), references=[TRUTH])
    options = ZeroDriftOptions(lever=31.43 * 0.0254, session="ymo", first_sigma=0.0)
    fit = find_zero_drift(recording, calibration, options).fits[NAME]
    assert np.max(np.abs(fit.values - [0.0, 0.1, 0.24]) / fit.sigmas) < 2.5
    assert fit.spread * 17e-6 / URAD < 5.0  # the stage stood stiller than the thesis dares to say


def test_the_program_prints_shifts_and_errors(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["zero_drift_1985"])
    assert main() == 0
    out = capsys.readouterr().out
    assert "YMO, beta: error against machining centre, standard deviation: 2.65 urad" in out
    assert re.search(r"zero shift of probe_3: \+0\.217\d V \+- 0\.01\d\d V \(thesis \+0\.240 V\)", out)


def test_an_unknown_option_is_refused_in_one_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["zero_drift_1985", "--shifts"])
    assert main() == 2
    assert capsys.readouterr().err.startswith("zero_drift_1985: unrecognized arguments: --shifts; expected options")
