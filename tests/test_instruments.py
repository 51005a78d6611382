# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Instruments from the wire to the endpoint: servers of simulated devices, drivers and nodes, short trials."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from posor.arm_names import find_arm
from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor_bringup.arms import load_checked_arm
from posor_drivers.instruments.instruments_command import main as instruments
from posor_drivers.instruments.instruments_file import load_instruments
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.faults.device_run import DeviceRun
from posor_lab.faults.fault_table import FAULT_TABLE
from posor_lab.instruments.device_trials import TRIALS, DeviceTrial
from posor_lab.instruments.trial_run import run_trial
from posor_lab.instruments.trials_command import main as trials
from posor_ros.node_program import ros_context

pytestmark = pytest.mark.usefixtures("ros_domain")

SECONDS = 3.0
SHORT = {"capaNCDT 3.9 kHz, 1 kHz scans": 200, "SCPI scanner, 5 Hz": 5}
"""Scans per second of the trials that run here, which a loaded host can follow."""


@pytest.mark.parametrize("trial", [trial for trial in TRIALS if trial.name in SHORT], ids=lambda trial: trial.name)
def test_readings_of_devices_give_the_true_endpoint(trial: DeviceTrial, tmp_path: Path) -> None:
    short = replace(trial, rate=SHORT[trial.name], seconds=SECONDS)
    with ros_context(["instruments"]):
        figures = run_trial(short, tmp_path, lambda: False)
    print(f"simulated: {figures}")
    assert figures.poses >= 0.5 * SHORT[trial.name] * SECONDS
    if trial.slowness != 1.0:  # a loaded host delays every arrival, which counts while the arm moves fast
        assert figures.inside_region >= 0.8
        assert figures.rms_um < 1.5 * figures.stated_um
    assert figures.rms_um < 10.0 * figures.stated_um
    assert figures.poses_in_stall == 0
    assert figures.back_after_s is not None


def test_a_faulty_device_is_named_and_no_wrong_pose_published(tmp_path: Path) -> None:
    rows = [row for row in FAULT_TABLE if row.run == "devices" and ("counter" in row.name or "half" in row.name)]
    with ros_context(["faults"]):
        results = DeviceRun(rows, tmp_path, 1985).run()
    assert len(results) == 2
    for result in results:
        print(f"simulated: {result.row.name}: {result.seen}; named after {result.naming_s} s")
        assert result.naming_s is not None
        assert result.wrong_ok == 0


@cache
def simulation_of(arm: str) -> ArmSimulation:
    return ArmSimulation(load_checked_arm(arm))


STARTS = [["--device", kind] for kind in ("stream", "labjack", "labjack_stream", "nidaqmx", "scpi")]
STARTS += [["--probes", "capancdt_6200"]]


@pytest.mark.parametrize(
    ("arm", "arguments"),  # all kinds of devices for the arm with most channels
    [*(("six_axis", each) for each in STARTS), *(("five_axis", each) for each in STARTS[::5]), ("test_rig", STARTS[0])],
    ids=lambda value: value if isinstance(value, str) else value[1],
)
def test_a_starting_file_holds_every_reading(
    arm: str, arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert instruments(["start", str(find_arm(arm)), *arguments]) == 0
    path = tmp_path / "instruments.yaml"
    path.write_text(capsys.readouterr().out, encoding="utf-8")
    file, simulation = load_instruments(path), simulation_of(arm)
    for joint, readings in file.joints.items():
        scan = simulation.scans(joint, np.arange(1)).scans[0]
        assert len(readings.gap_voltages) == len(scan.gap_voltages)
        assert len(readings.ring_voltages) == len(scan.ring_voltages)
        assert len(readings.diode_currents) == scan.diode_currents.size
        assert readings.frame_id == simulation.arm.calibration(joint).frames.parent
    assert instruments(["list", str(path)]) == 0


RIG = str(find_arm("test_rig"))


@pytest.mark.parametrize(
    ("program", "arguments", "sentence"),
    [
        (
            trials,
            ["instruments_trials", "--trials", "none"],
            r"instruments_trials: --trials none; expected part of one .*",
        ),
        (
            instruments,
            ["start", RIG, "--device", "none"],
            r"instruments start: kind 'none'; expected one of capancdt_6200, labjack, .*, nidaqmx, scpi, stream\.",
        ),
        (
            instruments,
            ["start", RIG, "--device", "capancdt_6200"],
            r".*a capancdt_6200 has no channel for .*; expected another --device or --probes\.",
        ),
    ],
    ids=["trial", "kind", "channel"],
)
def test_an_unsuitable_option_is_refused(
    program: Callable[[list[str]], int], arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program(arguments) == 2
    assert re.fullmatch(sentence + "\n", capsys.readouterr().err)


def test_the_interpolation_error_goes_into_the_noise_of_the_calibrations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = load_arm_file("test_rig")
    assert instruments(["start", str(arm.path), "--device", "stream"]) == 0
    content = yaml.safe_load(capsys.readouterr().out)
    (joint,) = content["joints"].values()
    content["devices"]["joint1"]["rate"]["value"] = 100
    joint["gap_voltages"][1] |= {
        "scale": {"value": -2.0, "unit": "V/V"},
        "acceleration": {"value": 80.0, "unit": "V/s^2"},
    }
    joint["diode_currents"][3]["acceleration"] = {"value": 1e-3, "unit": "A/s^2"}
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert instruments(["noise", str(file), str(arm.path), "--output", str(tmp_path / "new")]) == 0
    said = capsys.readouterr().out
    assert "joint1 gap_1: noise 0.001 V at rest, 0.001 V in motion; no acceleration is stated" in said
    assert (
        "joint1 gap_2: noise 0.001 V at rest, 0.00153 V in motion; the interpolation error is at most 0.002 V" in said
    )
    paths = arm.calibrations["joint1"], tmp_path / "new" / "joint1.yaml"
    (_, old_diodes), (gaps, new_diodes) = (load_calibration(path).sensors for path in paths)
    assert isinstance(gaps, GapProbesCalibration)
    assert isinstance(old_diodes, DiodesCalibration)
    assert isinstance(new_diodes, DiodesCalibration)
    assert gaps.probes[1].noise.number == pytest.approx(np.hypot(1e-3, 2e-3 / np.sqrt(3.0)))
    old, new = old_diodes.diodes, new_diodes.diodes
    bound = 2.0 * 1e-3 * 0.01**2 / 8.0 / old[0].minimum_sum.number
    assert new[0].noise.array == pytest.approx(np.hypot(old[0].noise.array, bound / np.sqrt(3.0)))
    assert new[1].noise.value == old[1].noise.value
    assert instruments(["noise", str(file), str(arm.path), "--output", str(tmp_path / "new")]) != 0
    assert "joint1.yaml: exists already" in capsys.readouterr().err
    joint["gap_voltages"][1]["acceleration"]["unit"] = "m/s^2"
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert instruments(["noise", str(file), str(arm.path)]) != 0
    assert "acceleration in m/s^2; expected one number in V/s^2" in capsys.readouterr().err
