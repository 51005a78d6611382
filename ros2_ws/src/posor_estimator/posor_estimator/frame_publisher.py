# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes the frames of an arm: /tf, /tf_static and the robot description.

The joints and the beams of the beams file move; their product with the fixed joints of the URDF, in the order of the
links, is the endpoint's pose of the same stamp in the base frame. robot_state_publisher leaves floating joints out.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.messages.joint_transform import stamp_of
from posor.numerics.stamps import NS
from posor.ros_names import ROBOT_DESCRIPTION_TOPIC, TF_STATIC_TOPIC, TF_TOPIC
from posor_ros.intra_process import IntraProcessPublisher
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import LATCHED_QOS, TF_QOS
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.endpoint_estimator import EndpointEstimator
    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import ChainParameters
    from posor.numerics.array_types import FloatArray
    from posor_ros.lifecycle_node import PosorNode

STAMP_BYTES, POSE_BYTES = 8, 56  # of a transform: at its begin, and at its end


class TransformWriter:
    """Writes ``TFMessage`` into one buffer: only stamp and numbers change from message to message."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        """Prepare for messages with one transform for each pair of frames: parent and child."""
        schema = schema_of_class(TFMessage)
        transforms = [{"header.frame_id": parent, "child_frame_id": child} for parent, child in frames]
        ends = np.array([len(schema.encode({"transforms": transforms[:n]})) for n in range(len(transforms) + 1)])
        self._data = np.frombuffer(schema.encode({"transforms": transforms}), dtype=np.uint8).copy()
        self._stamps = ends[:-1, None] + np.arange(STAMP_BYTES)
        self._poses = ends[1:, None] + np.arange(-POSE_BYTES, 0)

    def write(self, stamp: bytes, poses: FloatArray) -> bytes:
        """Return the message. ``stamp``: its eight bytes; ``poses``: of the children in their parents, (n, 7)."""
        self._data[self._stamps] = np.frombuffer(stamp, dtype=np.uint8)
        self._data[self._poses] = poses.view(np.uint8)
        return self._data.tobytes()


class FramePublisher:
    """Publishes the frames of an arm while its node is configured.

    Attributes:
        publisher: Of the frames that move; the node asks whether somebody subscribes.

    """

    def __init__(self, node: PosorNode[ChainParameters], chain: Chain, estimator: EndpointEstimator) -> None:
        """Publish the frames that do not move, also while the node is inactive; ``estimator``: of the poses."""
        prefix = node.parameters.frame_prefix
        self._estimator, self._next_ns = estimator, 0
        self._period_ns = round(NS / node.parameters.tf_rate)
        joints = (*chain.joints, *chain.beam_joints)
        self._writer = TransformWriter([(prefix + joint.parent, prefix + joint.child) for joint in joints])
        self.publisher = IntraProcessPublisher(node, TFMessage, TF_TOPIC, TF_QOS)
        fixed = TransformWriter([(prefix + each.parent, prefix + each.child) for each in chain.fixed_transforms])
        poses = [pin.SE3ToXYZQUAT(each.T_parent_child) for each in chain.fixed_transforms]
        static = node.create_publisher(TFMessage, TF_STATIC_TOPIC, LATCHED_QOS)
        static.publish(fixed.write(stamp_of(node.timing.now_ns()), np.array(poses).reshape(-1, 7)))
        description = node.create_publisher(String, ROBOT_DESCRIPTION_TOPIC, LATCHED_QOS)
        description.publish(schema_of_class(String).serialize(String(data=chain.urdf)))
        for publisher in (static, description):
            node.add_cleanup(node.destroy_publisher, publisher)

    def publish(self, stamp: bytes) -> None:
        """Publish the transforms of the present scan, unless the last are too recent."""
        now_ns = time.monotonic_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._period_ns
        poses = np.concatenate([self._estimator.poses, self._estimator.beam_transforms])
        self.publisher.publish(self._writer.write(stamp, poses))
