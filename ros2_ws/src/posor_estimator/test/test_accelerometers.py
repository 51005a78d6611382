# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Accelerometers of beams: chain_node follows them as the library does, and names those that it cannot use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_vibration import BeamVibrations
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor.numerics.stamps import NS
from posor_lab.harness.graph import Graph
from posor_msgs.msg import EndpointState
from sensor_msgs.msg import Imu

from .chain_program import LOSSLESS, URDF, ChainRig, chain_node, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

NAMES = ("near", "far")
VIBRATION = """\
    sag:
      tube:
        outer_diameter: {value: 0.0508, unit: m}
        inner_diameter: {value: 0.04445, unit: m}
        modulus: {value: 69.0e9, unit: Pa}
        density: {value: 2700, unit: kg/m^3}
      gimbals: {value: [0.1, 0.5], unit: m}
      uncertainty: {value: 0.01, unit: "1"}
    vibration:
      frequency: {value: 100.0, sigma: 1.0, unit: Hz}
      damping: {value: 0.05, unit: "1"}
      uncertainty: {value: 0.1, unit: "1"}
      spread: {value: 2.0, unit: m/s^2}
      accelerometers:
        names: [near, far]
        uncertainty: {value: 0.02, unit: m/s^2}
        delay: {value: 5.0e-5, unit: s}
        range: {value: 200.0, unit: m/s^2}
        age: {value: 0.005, unit: s}
"""
STEP_NS, READINGS = 4_000_000, 60
OFFSET_NS = 250_000_000  # of the stamps of ``set_stamp`` after whole seconds


def imu(stamp_ns: int, reading: np.ndarray) -> Any:
    message = Imu()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS)
    acceleration = message.linear_acceleration
    acceleration.x, acceleration.y, acceleration.z = reading.tolist()
    return message


def vibrating_beams(folder: Path) -> Path:
    former = Path(__file__).with_name("warm_beam.yaml").read_text(encoding="utf-8")
    beams = folder / "beams.yaml"
    beams.write_text(former.replace("version: 2", "version: 4") + VIBRATION, encoding="utf-8")
    return beams


def test_the_endpoint_follows_the_accelerometers_and_is_degraded_without(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    beams = vibrating_beams(tmp_path)
    chain = load_chain(URDF, "endpoint", beams)
    estimator = chain.estimator()
    vibrations = BeamVibrations(chain.beams, estimator)
    with chain_node(urdf=str(URDF), beams=str(beams), acceleration_topic="sense", **LOSSLESS) as node, Graph() as graph:
        rig = ChainRig(graph)
        transforms = rig.joint_publisher("joint1")
        sensors = {name: graph.publisher(Imu, f"sense/{name}") for name in NAMES}

        def answer(second: int, messages: list[tuple[str, Any]]) -> EndpointState:
            """Return the state of a scan after readings, and estimate the same scan."""
            for name, message in messages:
                sensors[name].publish(message)
                if message.linear_acceleration_covariance[0] < 0.0:
                    expected = "linear_acceleration, whose covariance is not -1"
                    reason = f"has sent an invalid message: has no linear acceleration; expected {expected}"
                    vibrations.refuse(name, reason)
                    continue
                stamp, a = message.header.stamp, message.linear_acceleration
                reading = stamp.sec * NS + stamp.nanosec, (a.x, a.y, a.z), message.header.frame_id
                vibrations.add(name, *reading)
            for publisher in sensors.values():
                assert publisher.wait_for_all_acked()
            transforms.publish(transform := transform_of(second))
            graph.wait_until(lambda: any(s.header.stamp.sec == second and s.state < 2 for s in rig.states), "the state")
            stamp_ns = second * NS + OFFSET_NS
            vibrations.update(stamp_ns)
            parts = (transform.covariance_random, transform.covariance_systematic)
            random, systematic = (np.reshape(part, (6, 6)) for part in parts)
            estimator.set_measurements({"joint1": MeasuredJoint(pin.SE3.Identity(), random, systematic)})
            assert estimator.estimate(stamp_ns)
            return next(s for s in rig.states if s.header.stamp.sec == second and s.state < 2)

        def readings(second: int) -> list[tuple[str, Any]]:
            stamps = second * NS + OFFSET_NS - STEP_NS * np.arange(READINGS)[::-1]
            up = -estimator.static_forces[0]
            return [(name, imu(int(at), up + 0.02 * rng.normal(size=3))) for at in stamps for name in NAMES]

        without = [(name, imu(9 * NS, np.zeros(3))) for name in NAMES]
        for _, message in without:
            message.linear_acceleration_covariance[0] = -1.0
        swapped = readings(11)
        swapped[-2][1].header.frame_id = "far"
        missing = "has no reading whose stamp is at most 0.005 s old"
        for second, messages, fault in (
            (3, [], missing),
            (4, None, ""),
            (5, None, ""),
            (6, [], missing),
            (8, None, ""),
            (9, without, "has sent an invalid message"),
            (11, swapped, "receives the readings of 'far'"),
        ):
            state = answer(second, readings(second) if messages is None else messages)
            degraded = EndpointState.STATE_DEGRADED if fault else EndpointState.STATE_OK
            assert state.state == degraded
            reason = f"degraded: {vibrations.reason}" if fault else ""
            assert reason.startswith(state.reason)  # the message bounds the text
            assert fault in state.reason
            assert not fault or "accelerometer 'near' of beam 'measuring_beam'" in state.reason
            position = state.pose.position
            np.testing.assert_array_equal([position.x, position.y, position.z], estimator.pose[:3])
            systematic = np.reshape(state.covariance_systematic, (6, 6))
            np.testing.assert_array_equal(systematic, estimator.covariance_systematic)
        assert node.end() == 0


def test_an_accelerometer_with_two_publishers_is_not_used(tmp_path: Path) -> None:
    beams = vibrating_beams(tmp_path)
    with chain_node(urdf=str(URDF), beams=str(beams), **LOSSLESS) as node, Graph() as graph:
        rig = ChainRig(graph)
        transforms = rig.joint_publisher("joint1")
        sensors = [graph.publisher(Imu, f"acceleration/{name}") for name in ("near", "near", "far")]
        graph.wait_until(lambda: all(each.get_subscription_count() for each in sensors), "the subscriptions")
        for publisher in sensors:
            publisher.publish(imu(3 * NS, np.array([0.0, 0.0, 9.8])))
            assert publisher.wait_for_all_acked()
        transforms.publish(transform_of(3))
        graph.wait_until(lambda: any(s.state == EndpointState.STATE_DEGRADED for s in rig.states), "the state")
        (reason,) = {s.reason for s in rig.states if s.state == EndpointState.STATE_DEGRADED}
        assert "accelerometer 'near' of beam 'measuring_beam' has 2 publishers on its topic; expected one" in reason
        assert node.end() == 0
