# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Warm beams of a simulated arm: the endpoint moves with them, and their thermometers are published."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.chain.arm_file import load_arm_file
from posor.chain.joint_measurements import MeasuredJoint
from posor.messages.message_definitions import MessageTypes, installed_schema
from posor.ros_names import TEMPERATURE
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.sources.simulated_source import SimulatedParameters, SimulatedSource
from posor_lab.harness.beams import quantity

from ..three_joint_arm import JOINTS, refused, scenario, write_arm

REFERENCE, NAME = 293.0, "upper_arm"
PHASED = {NAME: {"offset": quantity(6.0, "K"), "amplitude": quantity(2.0, "K"), "periods": 2}}


def write_warm_arm(folder: Path) -> Path:
    """Write the arm with exact thermometers on all beams; one is warm, the others have the temperature of the URDF."""
    path = write_arm(folder, scenario({"temperatures": PHASED}))
    beams: dict[str, Any] = yaml.safe_load((folder / "beams.yaml").read_text(encoding="utf-8"))
    beams["version"] = 3
    for beam in beams["beams"]:
        thermometer = {"name": f"{beam['joint']}_skin", "reference": quantity(REFERENCE, "K")}
        thermometer |= {"uncertainty": quantity(0.0, "K"), "range": quantity([273.0, 313.0], "K")}
        thermometer |= {"rate": quantity(1.0, "K/s"), "age": quantity(10.0, "s")}
        temperature = {"coefficient": quantity(23e-6, "1/K"), "deviation": quantity(10.0, "K")}
        beam["temperature"] = temperature | {"spread": quantity(0.0, "K"), "thermometer": thermometer}
    (folder / "beams.yaml").write_text(yaml.safe_dump(beams), encoding="utf-8")
    return path


def test_the_endpoint_is_that_of_the_chain_at_the_temperatures_that_are_read(tmp_path: Path) -> None:
    arm = ArmSimulation(load_arm_file(write_warm_arm(tmp_path)), Imperfections.only("temperature", "sag"))
    ticks = np.array([0, 100, 200, 300])
    truth, estimator = arm.truth(ticks), arm.chain.estimator()
    for n, tick in enumerate(ticks.tolist()):
        readings = arm.temperatures(tick)
        change = 6.0 + 2.0 * np.sin(4.0 * np.pi * tick / arm.scenario.cycle_ticks)
        assert readings == pytest.approx({beam: REFERENCE + change * (beam == NAME) for beam in arm.thermometers})
        for index, beam in enumerate(arm.chain.beams):
            estimator.use_beam(index, beam.at_temperature(readings[beam.name]))
        estimator.set_measurements({joint: MeasuredJoint(truth.T_parent_child[joint][n]) for joint in JOINTS})
        assert estimator.estimate()
        np.testing.assert_allclose(estimator.pose[:3], truth.endpoint.translations[n], rtol=0.0, atol=1e-9)
        cold = arm.chain.estimate({joint: MeasuredJoint(truth.T_parent_child[joint][n]) for joint in JOINTS})
        error = np.linalg.norm(cold.T_base_endpoint.translation - truth.endpoint.translations[n])
        assert error == pytest.approx(change * 23e-6 * 0.6, rel=1e-3)
    assert arm.temperatures(101) == {}


def test_the_driver_of_the_last_joint_publishes_the_thermometers(tmp_path: Path) -> None:
    path, schema = write_warm_arm(tmp_path), installed_schema(TEMPERATURE)
    for joint, published in ((JOINTS[0], 0), (JOINTS[-1], 3)):
        source = SimulatedSource(SimulatedParameters(arm=str(path), joint=joint, temperature=False), MessageTypes())
        topics = {topic.name for topic in source.open() if topic.type_name == TEMPERATURE}
        messages = [message for message in source.read_tick(5 * source.rate) if message.topic in topics]
        assert len(topics) == len(messages) == published
        assert not any(message.topic in topics for message in source.read_tick(5 * source.rate + 1))
        for message in messages:
            values = schema.values(message.data)
            assert message.topic == f"/arm/temperature/{values['header.frame_id']}"
            assert (values["temperature"], values["header.stamp.sec"]) == (pytest.approx(REFERENCE - 273.15), 5)


def test_a_temperature_of_a_beam_without_a_coefficient_is_refused(tmp_path: Path) -> None:
    error = refused(tmp_path, scenario({"temperatures": PHASED}))
    assert (error.what, error.where) == (
        "there is no temperature of a beam 'upper_arm'",
        f"{tmp_path / 'scenario.yaml'}, key temperatures",
    )
