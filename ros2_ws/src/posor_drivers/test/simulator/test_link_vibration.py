# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Links that oscillate, beams that follow, and the accelerometers of a simulated arm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.chain.arm_file import load_arm_file
from posor.chain.beam_vibration import BeamVibrations
from posor.chain.joint_measurements import MeasuredJoint
from posor.errors import CalibrationError
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.numerics.stamps import tick_stamp_ns
from posor.ros_names import IMU
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.sources.simulated_source import SimulatedParameters, SimulatedSource
from posor_lab.harness.beams import quantity
from posor_lab.harness.case_tables import refusal
from posor_lab.vibration.vibrating_arm import write_vibrating_arm

RATE, FREQUENCY, AMPLITUDE = 1000, 30.0, 250e-6
FIRST = 100_000 * RATE


def write_arm(folder: Path, joint: str = "shoulder", **changes: Any) -> Path:
    """Write five_axis with accelerometers, whose link after a joint oscillates."""
    path = write_vibrating_arm(load_arm_file("five_axis"), folder)
    arm = yaml.safe_load(path.read_text(encoding="utf-8"))
    scenario = yaml.safe_load(Path(arm["scenario"]).read_text(encoding="utf-8"))
    own = {"frequency": quantity(FREQUENCY, "Hz"), "amplitude": quantity(AMPLITUDE, "m")}
    scenario["vibrations"] = {joint: {**own, "direction": quantity([0.3, 1.0, 1.0], "1"), **changes}}
    (folder / "scenario.yaml").write_text(json.dumps(scenario), encoding="utf-8")
    path.write_text(json.dumps({**arm, "scenario": "scenario.yaml"}), encoding="utf-8")
    return path


def test_the_dynamic_chain_follows_the_beams_that_the_link_shakes(tmp_path: Path) -> None:
    path = write_arm(tmp_path)
    still, arm = (
        ArmSimulation(load_arm_file(path), Imperfections.only("sag", *own), RATE) for own in ((), ("vibration",))
    )
    ticks = np.arange(FIRST, FIRST + 500)  # the arm rests
    truth, at_rest = arm.truth(ticks), still.truth(ticks)
    moved = truth.specific_forces["upper_arm"] - at_rest.specific_forces["upper_arm"]
    largest = np.sqrt(2.0 * np.mean(np.sum(np.square(moved), axis=2), axis=0))
    places = arm.chain.beams[1].entry.sag.gimbals.array / 0.762  # type: ignore[union-attr]  # gimbals over length
    np.testing.assert_allclose(largest, places * AMPLITUDE * (2.0 * np.pi * FREQUENCY) ** 2, rtol=0.01)
    estimator = arm.chain.estimator()
    vibrations, errors = BeamVibrations(arm.chain.beams, estimator), []
    for n, tick in enumerate(ticks.tolist()):
        stamp_ns = int(tick_stamp_ns(tick, RATE))
        for name, reading in arm.accelerations(tick).items():
            vibrations.add(name, stamp_ns, (reading[0], reading[1], reading[2]))
        vibrations.update(stamp_ns)
        measured = {joint: MeasuredJoint(seen[n]) for joint, seen in truth.T_parent_child.items()}
        estimator.set_measurements(measured)
        assert estimator.estimate(stamp_ns)
        static = arm.chain.estimate(measured).T_base_endpoint.translation
        true = truth.endpoint.translations[n]
        errors.append((np.linalg.norm(static - true), np.linalg.norm(estimator.pose[:3] - true)))
    assert not vibrations.reason
    static_rms, dynamic_rms = np.sqrt(np.mean(np.square(errors[-60:]), axis=0))
    assert static_rms > 20e-6
    assert dynamic_rms < 0.1 * static_rms


def test_the_driver_of_the_last_joint_publishes_the_readings_before_its_scan(tmp_path: Path) -> None:
    parameters = SimulatedParameters(arm=str(write_arm(tmp_path)), joint="wrist_yaw", rate=RATE, latency=False)
    source = SimulatedSource(parameters, MessageTypes())
    topics = {topic.name: topic.type_name for topic in source.open()}
    messages = list(source.read_tick(FIRST))
    found = [message for message in messages if topics[message.topic] == IMU]
    assert messages[: len(found)] == found
    arm = ArmSimulation(load_arm_file(tmp_path / "arm.yaml"), parameters, RATE)
    for message, (name, reading) in zip(found, arm.accelerations(FIRST).items(), strict=True):
        values = installed_schema(IMU).values(message.data)
        assert message.topic.endswith(f"/acceleration/{name}")
        assert [values[f"linear_acceleration.{axis}"] for axis in "xyz"] == reading.tolist()
        assert (values["header.frame_id"], values["orientation_covariance"][0]) == (name, -1.0)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"joint": "hip"}, "joint 'hip'; expected one of base_swivel, shoulder"),
        ({"frequency": quantity(30.03, "Hz")}, "frequency 30.03 Hz; expected a whole number of periods in 10 s"),
        ({"amplitude": quantity(0.25, "m")}, "amplitude 0.25 m; expected at most 0.01 m (in um or mm?)"),
        ({"direction": quantity([1.0, 0.0, 0.0], "1")}, "a link without length, or a direction along the link"),
    ],
)
def test_a_vibration_that_cannot_be_is_refused(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    path = write_arm(tmp_path, **changes)
    error = refusal(CalibrationError, ArmSimulation, load_arm_file(path), Imperfections(), RATE)
    assert sentence in str(error)
