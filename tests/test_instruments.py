"""Instruments from the wire to the endpoint: servers of simulated devices, drivers and nodes, short trials."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from posor_validation.instruments.device_trials import TRIALS, DeviceTrial
from posor_validation.instruments.trial_run import run_trial
from posor_validation.instruments.trials_command import main

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("ros_domain")

SECONDS = 3.0
SHORT = {"capaNCDT 3.9 kHz, 1 kHz scans": 200, "SCPI scanner, 5 Hz": 5}
"""Scans per second of the trials that run here, which a loaded host can follow."""


@pytest.mark.parametrize("trial", [trial for trial in TRIALS if trial.name in SHORT], ids=lambda trial: trial.name)
def test_readings_of_devices_give_the_true_endpoint(trial: DeviceTrial, tmp_path: Path) -> None:
    short = replace(trial, rate=SHORT[trial.name], seconds=SECONDS)
    figures = run_trial(short, tmp_path, lambda: False)
    print(f"simulated: {figures}")
    assert figures.poses >= 0.5 * SHORT[trial.name] * SECONDS
    assert figures.inside_region >= 0.93
    assert figures.poses_in_stall == 0
    assert figures.back_after_s > 0.0


def test_an_unknown_trial_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["instruments_trials", "--trials", "none"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("instruments_trials: --trials none; expected part of one of stream, 1 kHz; capaNCDT")
