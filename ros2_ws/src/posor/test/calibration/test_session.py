# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a session replaces in a calibration, and what it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import refusal

from .calibration_content import at, write, zero_shifts


def test_a_session_replaces_zero_shifts_and_maps(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["section84"])
    yzmo, zmo = whole.for_session("yzmo"), whole.for_session("zmo")
    assert zero_shifts(yzmo) == [-0.06, 0.18, 0.14]
    assert zero_shifts(zmo) == [0.0, 0.2, 0.3]
    assert [calibration.sensors[1].map for calibration in (yzmo, zmo)] == ["B", "A"]  # type: ignore[attr-defined]
    # The rest stands, and so does the calibration that the session was taken from.
    assert yzmo.sensors[0].probes[0].tip == whole.sensors[0].probes[0].tip  # type: ignore[attr-defined]
    assert zero_shifts(whole) == [0.0, 0.2, 0.3]


def test_a_session_keeps_all_other_values(content: Any, file: Path) -> None:
    content["sessions"]["ymo"] = {"note": "nothing new"}
    write(file, content)
    whole = load_calibration(file)
    assert whole.for_session("ymo").sensors == whole.sensors


def test_the_empty_session_is_the_calibration_itself(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["printed"])
    assert whole.for_session("") is whole


def test_each_session_has_a_hash_of_its_own(rig_calibrations: dict[str, Path]) -> None:
    whole = load_calibration(rig_calibrations["section84"])
    assert len({whole.for_session(name).content_hash for name in ("", "ymo", "yzmo", "zmo")}) == 4


def test_the_uncertainty_of_a_zero_shift_comes_from_the_session(content: Any, file: Path) -> None:
    shifts = {"value": [0.1, 0.2, 0.3], "sigma": [0.01, 0.02, 0.03], "unit": "V"}
    content["sessions"]["ymo"]["zero_shifts"] = shifts
    write(file, content)
    probes = load_calibration(file).for_session("ymo").sensors[0].probes  # type: ignore[attr-defined]
    assert [float(probe.zero_shift.sigmas) for probe in probes] == [0.01, 0.02, 0.03]


def test_an_unknown_session_is_refused(rig_calibrations: dict[str, Path]) -> None:
    error = refusal(CalibrationError, load_calibration(rig_calibrations["printed"]).for_session, "ymx")
    assert str(error) == "calibration 'slocum1985_printed': session 'ymx' is unknown; expected ymo, yzmo, zmo."


@pytest.mark.parametrize(
    ("where", "key", "value", "sentence"),
    [
        ("sessions.ymo.zero_shifts", "value", [0.0, 0.2], "2 values; expected 3, one for each gap probe."),
        ("sessions.ymo", "diode_map", "C", "'C'; expected one of A, B."),
    ],
)
def test_a_session_that_does_not_fit_is_refused(
    where: str, key: str, value: object, sentence: str, content: Any, file: Path
) -> None:
    at(content, where)[key] = value
    write(file, content)
    assert str(refusal(CalibrationError, load_calibration(file).for_session, "ymo")).endswith(sentence)
