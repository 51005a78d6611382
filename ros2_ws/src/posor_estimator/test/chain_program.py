# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A chain_node program for tests: transforms to send, and received messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.model.native_coordinates import native_from_rotation
from posor_lab.harness.graph import Graph, set_stamp, values_of, wait_for_value
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_msgs.msg import EndpointState, JointTransform
from posor_ros.ros_arguments import ros_arguments
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from .live_topics import BRINGUP

URDF = BRINGUP / "urdf" / "slocum1985_rig.urdf"
PLATES = ("posor_receiving", "posor_target")
TURN = 2.0 * math.pi  # the joint has made one turn
RANDOM_SHARE = 0.25  # of the variances of a transform
LOSSLESS = {"lossless": True, "max_wait": 60.0, "alarm_count": 1, **HAND_FED}


def chain_node(**parameters: object) -> Program:
    return Program([*installed("posor_estimator", "chain_node"), *ros_arguments(parameters)])


def call_set_home(graph: Graph) -> tuple[bool, str]:
    answer = graph.call(Trigger, "/chain_node/set_home", Trigger.Request())
    return answer.success, answer.message


def transform_of(seconds: int, pose: pin.SE3 | None = None, plates: tuple[str, str] = PLATES) -> Any:
    """Return a sound transform between two plates."""
    message = set_stamp(JointTransform(scan=seconds, child_frame_id=plates[1]), seconds)
    message.header.frame_id = plates[0]
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose or pin.SE3.Identity()).tolist()
    message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
    message.pose.orientation.x, message.pose.orientation.y = qx, qy
    message.pose.orientation.z, message.pose.orientation.w = qz, qw
    covariance = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 4.0]).ravel() * 1e-12
    message.covariance_random, message.covariance_systematic = (
        RANDOM_SHARE * covariance,
        (1.0 - RANDOM_SHARE) * covariance,
    )
    alpha, beta, theta = native_from_rotation((pose or pin.SE3.Identity()).rotation)
    message.native = [x, y, z, alpha, beta, theta + TURN]
    return message


def lost_transform(seconds: int, fault: int, plates: tuple[str, str] = PLATES) -> Any:
    message = transform_of(seconds, plates=plates)
    message.state, message.faults = JointTransform.STATE_LOST, fault
    nan = math.nan
    message.pose.position.x = message.pose.position.y = message.pose.position.z = nan
    message.native = [nan] * 6
    return message


class ChainRig:
    """Topics and diagnostics of a chain_node."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        # Its listeners are not counted: subscribed to first, and so discovered before the topics that are waited for.
        self.states: list[Any] = graph.collect(EndpointState, "endpoint/state")
        self.poses: list[Any] = graph.collect(PoseStamped, "endpoint/pose")
        self.with_covariance: list[Any] = graph.collect(PoseWithCovarianceStamped, "endpoint/pose_with_covariance")
        self.joint_states: list[Any] = graph.collect(JointState, "joint_states")
        graph.watch_diagnostics()
        for topic in ("endpoint/pose", "endpoint/pose_with_covariance", "joint_states"):
            wait_for_value(graph, "/chain_node: listeners", topic, "1")

    def clear(self) -> None:
        """Discard the received messages."""
        for messages in (self.poses, self.with_covariance, self.joint_states, self.graph.diagnostics):
            messages.clear()

    def joint_publisher(self, name: str) -> Any:
        """Return a publisher of a joint's transforms."""
        return self.graph.publisher(JointTransform, f"{name}/transform")

    def count_of(self, key: str) -> int:
        """Return a count in the diagnostics of a usable pose."""
        return int(values_of(self.graph.wait_for_status("/chain_node: endpoint", "ok"))[key])

    def wait_for_poses(self, count: int) -> None:
        """Wait until all topics have ``count`` messages."""
        self.graph.wait_until(
            lambda: len(self.poses) == len(self.with_covariance) == len(self.joint_states) == count, f"{count} poses"
        )

    def wait_for_message(self, text: str) -> DiagnosticStatus:
        """Return the endpoint's status once its message contains ``text``."""
        return self.graph.wait_for_status("/chain_node: endpoint", text)
