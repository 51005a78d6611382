# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a commissioning on small recordings: kinds of findings, missing steps, repeated steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import design
from posor.estimation.forward import simulate
from posor_calibration.commissioning.commissioning_recording import CommissioningRecording, RecordedStep
from posor_calibration.commissioning.file_checks import check_gates
from posor_calibration.commissioning.motion_checks import check_encoder
from posor_calibration.commissioning.plan import CommissioningSettings, Step, probes_of, steps_of
from posor_calibration.commissioning.plug_checks import check_cover, check_lift, check_scale

LIFT = 2e-4
HOME = [0.0, 0.0, 7.35e-4, 0.0, 0.0, 0.0, 1.0]
CALIBRATION = design("triad_diodes", motion=True)
SETTINGS = CommissioningSettings()
REST, STEP = RecordedStep(Step("rest", "elbow"), 0, 20_000_000), RecordedStep(Step("lift"), 21_000_000, 40_000_000)


def recording_with(change: dict[str, float], *, calibration: Calibration = CALIBRATION) -> CommissioningRecording:
    """Return 20 scans at rest and 20 scans in which probes read other gaps [m], or diodes a share of their light."""
    scans = simulate(calibration, [HOME] * 40, rate=1000.0, seed=3)
    probes, names = probes_of(calibration), [diode.name for diode in calibration.sensors[1].diodes]  # type: ignore[attr-defined]
    volts, currents = scans.gap_voltages.copy(), scans.diode_currents.copy()
    for name, size in change.items():
        if name in probes:
            slope = probes[name][2].volts_to_gap.array[1]
            volts[20:, probes[name][1]] += size / slope
        else:
            currents[20:, names.index(name)] *= 1.0 - size
    scans = scans.with_fields({"gap_voltages": volts, "diode_currents": currents})
    return CommissioningRecording({"elbow": scans}, {}, [REST], None, "", "test")


def linear(calibration: Calibration) -> Calibration:
    """Return a calibration whose probes are linear."""
    content = calibration.model_dump(mode="json")
    for probe in content["sensors"][0]["probes"]:
        probe["volts_to_gap"] |= {"value": [7.35e-4, -1.18e-4], "sigma": [3e-8, 1e-8]}
    return calibration_from(content)


PLAIN = linear(CALIBRATION)


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"gap_1": LIFT}, ""),
        ({"gap_2": LIFT}, "exchanged"),
        ({"gap_1": LIFT, "gap_2": LIFT}, "exchanged"),
        ({"gap_1": -LIFT}, "sign"),
        ({"gap_1": 1.05 * LIFT}, "scale"),
        ({"gap_1": LIFT / 25.4}, "scale"),
        ({"gap_1": 0.01 * LIFT}, "missing"),
        ({}, "missing"),
    ],
)
def test_a_lift_names_what_is_wrong(change: dict[str, float], kind: str) -> None:
    step = replace(STEP, step=Step("lift", "elbow", "gap_1", LIFT, 1e-6))
    recording = recording_with(change, calibration=PLAIN)
    check, lift = check_lift(recording, {"elbow": PLAIN}, REST, step)
    assert (check.kind, check.verdict) == (kind, "failed" if kind else "passed"), check.found
    assert (lift is None) == (kind in {"exchanged", "missing"})
    if lift is not None:
        assert lift.ratio == pytest.approx(change["gap_1"] / LIFT, abs=2e-3)


def test_the_unit_of_all_probes_is_known_better_than_that_of_one() -> None:
    step = replace(STEP, step=Step("lift", "elbow", "gap_1", LIFT, 1e-6))
    check, lift = check_lift(recording_with({"gap_1": 1.0254 * LIFT}, calibration=PLAIN), {"elbow": PLAIN}, REST, step)
    assert lift is not None
    assert check_scale("elbow", [lift] * 3).kind == "scale"
    assert "millimetres" not in check.found
    inch = check_lift(recording_with({"gap_1": LIFT / 25.4}, calibration=PLAIN), {"elbow": PLAIN}, REST, step)[0]
    assert inch.found.endswith("perhaps millimetres read as inches")


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        ({"diode_1": 1.0}, ""),
        ({"diode_2": 1.0}, "exchanged"),
        ({"diode_1": 1.0, "diode_2": 1.0}, "exchanged"),
        ({"diode_1": 0.2}, "missing"),
    ],
)
def test_a_covered_diode_must_be_dark_alone(change: dict[str, float], kind: str) -> None:
    step = replace(STEP, step=Step("cover", "elbow", "diode_1"))
    assert check_cover(recording_with(change), {"elbow": CALIBRATION}, REST, step).kind == kind


def test_too_few_scans_and_missing_steps_are_failures() -> None:
    step = RecordedStep(Step("cover", "elbow", "diode_1"), 10**12, 10**12 + 1)
    recording = recording_with({})
    assert check_cover(recording, {"elbow": CALIBRATION}, REST, step).kind == "missing"
    assert recording.find(Step("sweep", "elbow")) is None
    again = replace(REST, begin_ns=5)
    assert replace(recording, steps=[REST, again]).find(Step("rest", "elbow", size=1.0)) == again


ANGLES = np.linspace(-0.3, 0.3, 50)


@pytest.mark.parametrize(
    ("angles", "encoder", "kind"),
    [
        (ANGLES, ANGLES, ""),
        (ANGLES + 2.0 * math.pi, ANGLES, ""),
        (ANGLES, -ANGLES, "sign"),
        (ANGLES, ANGLES / 1.02, "scale"),
        (ANGLES, ANGLES + 0.003, "zero"),
        (0.5 * ANGLES, 0.5 * ANGLES, "range"),
        (ANGLES, np.full(50, np.nan), "missing"),
        (np.full(50, np.nan), ANGLES, "range"),
    ],
)
def test_an_encoder_must_have_sign_scale_and_zero_of_theta(angles: np.ndarray, encoder: np.ndarray, kind: str) -> None:
    check = check_encoder("elbow: encoder", angles, encoder, SETTINGS)
    assert (check.kind, check.verdict) == (kind, "failed" if kind else "passed")


def test_without_an_encoder_theta_is_not_checked() -> None:
    assert check_encoder("elbow: encoder", ANGLES, None, SETTINGS).verdict == "not_checked"


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "passed"), (1e4, "failed"), (0.0, "not_checked")])
def test_a_gate_that_lets_anything_pass_is_found(factor: float, verdict: str) -> None:
    content = CALIBRATION.model_dump(mode="json")
    content["motion"]["translation"]["value"] *= factor
    if not factor:
        del content["motion"]
    scans = recording_with({}).scans["elbow"]
    assert check_gates("elbow", calibration_from(content), scans).verdict == verdict


def test_the_steps_are_each_plug_then_the_sweep_then_the_postures() -> None:
    steps = steps_of({"elbow": CALIBRATION}, replace(SETTINGS, postures=2))
    channels = [(step.action, step.channel) for step in steps]
    assert channels == [
        ("rest", ""),
        *(("lift", f"gap_{n}") for n in (1, 2, 3)),
        *(("cover", f"diode_{n}") for n in (1, 2)),
        ("sweep", ""),
        ("posture", "1"),
        ("posture", "2"),
    ]
    assert len({step.instruction for step in steps}) == len(steps) - 1
