# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Thermometers of beams: chain_node follows them as the library does, and names those that it cannot use."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_temperatures import CELSIUS
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor_lab.harness.graph import Graph, set_stamp
from posor_msgs.msg import EndpointState
from sensor_msgs.msg import Temperature

from .chain_program import LOSSLESS, URDF, ChainRig, chain_node, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

BEAMS = """\
      spread: {value: 4.0, unit: K}
      gradient: {along: {value: 0.1, unit: K}, across: {value: 0.05, unit: K}, width: {value: 0.05, unit: m}}
      thermometer:
        name: skin
        reference: {value: 293.15, unit: K}
        uncertainty: {value: 0.05, unit: K}
        range: {value: [278.15, 308.15], unit: K}
        rate: {value: 0.01, unit: K/s}
        age: {value: 3.0, unit: s}
"""


def test_the_endpoint_follows_the_thermometer_and_is_degraded_without(tmp_path: Path) -> None:
    beams = tmp_path / "beams.yaml"
    former = Path(__file__).with_name("warm_beam.yaml").read_text(encoding="utf-8")
    beams.write_text(former.replace("version: 2", "version: 3") + BEAMS, encoding="utf-8")
    chain = load_chain(URDF, "endpoint", beams)
    parameters = {"urdf": str(URDF), "beams": str(beams), "temperature_topic": "shop", **LOSSLESS}
    with chain_node(**parameters) as node, Graph() as graph:
        rig = ChainRig(graph)
        transforms, readings = rig.joint_publisher("joint1"), graph.publisher(Temperature, "shop/skin")

        def answer(second: int, celsius: float | None) -> EndpointState:
            """Return the state of a scan two seconds after a reading."""
            if celsius is not None:
                readings.publish(set_stamp(Temperature(temperature=celsius), second - 2))
                assert readings.wait_for_all_acked()
            transforms.publish(transform_of(second))
            graph.wait_until(lambda: any(s.header.stamp.sec == second and s.state < 2 for s in rig.states), "the state")
            return next(s for s in rig.states if s.header.stamp.sec == second and s.state < 2)

        name = "degraded: thermometer 'skin' of beam 'measuring_beam' "
        for second, celsius, kelvin, reason in (
            (3, None, None, f"{name}has no reading whose stamp is at most 3 s old"),
            (4, 24.5, 24.5 + CELSIUS, ""),
            (5, 24.51, 24.51 + CELSIUS, ""),
            (6, math.nan, None, f"{name}does not read a number"),
            (7, 24.5, 24.5 + CELSIUS, ""),
            (8, 29.5, None, f"{name}changes faster than 0.01 K/s"),
            (9, 40.0, None, f"{name}reads a temperature outside 278.15 to 308.15 K"),
            (10, 24.5, 24.5 + CELSIUS, ""),
            (14, None, None, f"{name}has no reading whose stamp is at most 3 s old"),
        ):
            state = answer(second, celsius)
            degraded = EndpointState.STATE_DEGRADED if reason else EndpointState.STATE_OK
            assert (state.state, state.reason) == (degraded, reason)
            transform, estimator = transform_of(second), chain.estimator()
            random = np.reshape(transform.covariance_random, (6, 6))
            systematic = np.reshape(transform.covariance_systematic, (6, 6))
            estimator.set_measurements({"joint1": MeasuredJoint(pin.SE3.Identity(), random, systematic)})
            estimator.use_beam(0, chain.beams[0].at_temperature(kelvin))
            assert estimator.estimate()
            position = state.pose.position
            np.testing.assert_array_equal([position.x, position.y, position.z], estimator.pose[:3])
            systematic = np.reshape(state.covariance_systematic, (6, 6))
            np.testing.assert_array_equal(systematic, estimator.covariance_systematic)
        graph.publisher(Temperature, "shop/skin")
        graph.wait_until(lambda: graph.node.count_publishers("shop/skin") == 2, "the second publisher")
        assert answer(15, 24.5).reason == f"{name}has 2 publishers on its topic; expected one"
        assert node.end() == 0
