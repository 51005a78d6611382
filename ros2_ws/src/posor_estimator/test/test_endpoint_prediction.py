# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of chain_node: readings of encoders in, Odometry and state out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from nav_msgs.msg import Odometry
from posor.chain.kinematic_chain import load_chain
from posor.numerics.stamps import time_ns
from posor_lab.harness.graph import Graph, set_stamp
from posor_msgs.msg import EndpointState, JointTransform
from sensor_msgs.msg import JointState

from .chain_program import LOSSLESS, URDF, ChainRig, chain_node, lost_transform, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

PARAMETERS = {
    "encoders.topic": "drive",
    "encoders.sigma": [1e-6],
    "encoders.lead_time": 0.5,
    "encoders.gap": 1.0,
    "encoders.max_holdover": 4.0,
}


def stamp_ns(message: Any) -> int:
    return time_ns(message.header.stamp.sec, message.header.stamp.nanosec)


def reading(second: int, angle: float, name: str = "joint1") -> Any:
    return set_stamp(JointState(name=["other", name], position=[7.0, angle]), second)


def test_the_endpoint_is_predicted_carried_through_a_gap_and_not_beyond() -> None:
    chain = load_chain(URDF, "endpoint")
    with chain_node(urdf=str(URDF), **PARAMETERS, **LOSSLESS) as node, Graph() as graph:
        states, poses = (
            graph.collect(EndpointState, "endpoint/predicted_state"),
            graph.collect(Odometry, "endpoint/predicted"),
        )
        ahead = graph.collect(Odometry, "endpoint/predicted_ahead")
        rig = ChainRig(graph)  # subscribes and waits after the others
        transforms, encoders = rig.joint_publisher("joint1"), graph.publisher(JointState, "drive")

        def read(second: int, angle: float) -> EndpointState:
            encoders.publish(reading(second, angle))
            graph.wait_until(lambda: any(s.header.stamp.sec == second for s in states), "the predicted state")
            return next(s for s in states if s.header.stamp.sec == second)

        def use(message: Any) -> None:
            count = len(rig.poses)
            transforms.publish(message)
            if message.state == JointTransform.STATE_OK:
                rig.wait_for_poses(count + 1)

        state = read(1, 0.0)
        assert (state.state, state.joint) == (EndpointState.STATE_LOST, "joint1")
        assert state.reason == "joint1 has no transform since the first reading of its encoder"
        assert np.isnan(state.pose.position.x)
        use(transform_of(1))
        assert read(2, 0.02).state == EndpointState.STATE_OK
        true = chain.nominal_endpoint({"joint1": 0.02})
        graph.wait_until(lambda: bool(poses and ahead), "the predicted poses")
        position = poses[-1].pose.pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], true.translation, atol=1e-9)
        assert (poses[-1].header.frame_id, poses[-1].child_frame_id) == (rig.poses[-1].header.frame_id, "endpoint")
        lead_ns = stamp_ns(ahead[-1]) - stamp_ns(poses[-1])
        assert lead_ns == 500_000_000
        whole = np.reshape(poses[-1].pose.covariance, (6, 6))
        parts = np.reshape(states[-1].covariance_random, (6, 6)) + np.reshape(states[-1].covariance_systematic, (6, 6))
        np.testing.assert_array_equal(whole, parts)
        transforms.publish(lost_transform(2, JointTransform.FAULT_BAD_READING))
        state = read(3, 0.02)
        assert (state.state, state.joint) == (EndpointState.STATE_DEGRADED, "joint1")
        assert state.reason == "degraded: joint1: carried on by encoders, no transform for more than 1 s"
        count, state = len(poses), read(6, 0.02)
        reason = "joint1 has no transform for more than 4 s (the newest is LOST)"
        assert (state.state, state.reason) == (EndpointState.STATE_LOST, reason)
        use(transform_of(6, pin.SE3(pin.utils.rotate("z", 0.02), np.zeros(3))))
        assert read(7, 0.02).state == EndpointState.STATE_OK
        assert len(poses) == count + 1
        encoders.publish(reading(8, float("nan")))
        graph.wait_for_status("/chain_node: prediction", "/drive: the position of joint1 is not a number")
        other = graph.publisher(JointState, "drive")  # whose clock is late
        graph.wait_until(  # the node may receive a reading before it knows of the second publisher
            lambda: any(s.reason.endswith("; 2 publishers on /drive") for s in states),
            "both publishers",
            lambda: other.publish(reading(6, 0.02)),
        )
        encoders.publish(reading(8, 0.0, "elbow"))
        graph.wait_for_status("/chain_node: prediction", "/drive: names other, elbow; expected joint1")
        assert node.end() == 0


def test_wrong_parameters_of_the_encoders_end_the_node() -> None:
    wrong = {**PARAMETERS, "encoders.sigma": [1e-6, 1e-6]}
    with chain_node(urdf=str(URDF), **wrong, **LOSSLESS) as node:
        assert node.wait() == 2
        assert any("parameter 'encoders.sigma': 2 values" in line for line in node.errors)
