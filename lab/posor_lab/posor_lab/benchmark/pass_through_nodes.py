# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nodes with the topics, message sizes and connections of posor_node and chain_node that compute nothing.

A graph of these nodes shows the cost of middleware and Python alone. Their messages are prepared; only the
stamp comes from the received message. ``compose`` finds the nodes by entry points, see ``register_nodes``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor.messages.cdr_schema import STAMP
from posor.node_parameters import NodeParameters
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_TOPIC, JOINT_STATES_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC
from posor_estimator.composition_file import NODE_ENTRY_POINTS
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import input_qos, result_qos
from pydantic import Field
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from pathlib import Path

MAX_OPEN_STAMPS = 1000  # most stamps that wait for further joints; beyond, the oldest is dropped


class _PreparedMessage:
    """A serialised message whose stamp is replaced before it is published."""

    def __init__(self, node: PosorNode[Any], message: Any, topic: str, qos: Any) -> None:
        data = schema_of_class(type(message)).serialize(message)
        self._before, self._after = data[: STAMP.start], data[STAMP.stop :]
        self._publisher = IntraProcessPublisher(node, type(message), topic, qos)
        node.add_cleanup(self._publisher.destroy)

    def publish(self, stamp: bytes) -> None:
        self._publisher.publish(self._before + stamp + self._after)


class PassThroughPosorParameters(NodeParameters):
    """Parameters of pass_through_posor."""

    parent: str = Field(description="frame of the receiving plate")
    child: str = Field(description="frame of the target plate")


class PassThroughPosor(PosorNode[PassThroughPosorParameters]):
    """Publishes the same transform for every scan."""

    NAME = "pass_through_posor"
    Parameters = PassThroughPosorParameters

    def configure(self) -> None:
        """Open the topics."""
        message = JointTransform(child_frame_id=self.parameters.child)
        message.header.frame_id = self.parameters.parent
        qos = result_qos(self.parameters)
        self._transform = _PreparedMessage(self, message, TRANSFORM_TOPIC, qos)
        qos = input_qos(self.parameters)
        self.add_cleanup(IntraProcessSubscription(self, RawScan, RAW_TOPIC, qos, self._on_raw_scan).destroy)

    def _on_raw_scan(self, data: bytes) -> None:
        self._transform.publish(data[STAMP])


class PassThroughChainParameters(NodeParameters):
    """Parameters of pass_through_chain."""

    joints: tuple[str, ...] = Field(description="names of the arm's joints")
    frame: str = Field(description="base frame")


class PassThroughChain(PosorNode[PassThroughChainParameters]):
    """Publishes the same endpoint when the transforms of all joints with the same stamp have come."""

    NAME = "pass_through_chain"
    Parameters = PassThroughChainParameters

    def configure(self) -> None:
        """Open the topics."""
        joints = self.parameters.joints
        results, qos = result_qos(self.parameters), input_qos(self.parameters)
        pose, with_covariance = PoseStamped(), PoseWithCovarianceStamped()
        pose.header.frame_id = with_covariance.header.frame_id = self.parameters.frame
        states = JointState(name=list(joints), position=[0.0] * len(joints))
        topics = {ENDPOINT_TOPIC: pose, ENDPOINT_COVARIANCE_TOPIC: with_covariance, JOINT_STATES_TOPIC: states}
        self._results = [_PreparedMessage(self, message, topic, results) for topic, message in topics.items()]
        self._received: dict[bytes, int] = {}
        self._joint_count = len(joints)
        for joint in joints:
            subscription = IntraProcessSubscription(
                self, JointTransform, f"{joint}/{TRANSFORM_TOPIC}", qos, self._on_transform
            )
            self.add_cleanup(subscription.destroy)

    def _on_transform(self, data: bytes) -> None:
        stamp = data[STAMP]
        count = self._received.pop(stamp, 0) + 1
        if count == self._joint_count:
            for result in self._results:
                result.publish(stamp)
            return
        self._received[stamp] = count
        if len(self._received) > MAX_OPEN_STAMPS:
            del self._received[next(iter(self._received))]


def register_nodes(folder: Path) -> None:
    """Make the two nodes known to ``compose`` in every Python process that has ``folder`` on its path."""
    info = folder / "posor_pass_through-1.0.dist-info"
    info.mkdir()
    metadata = "Metadata-Version: 2.1\nName: posor_pass_through\nVersion: 1.0\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    nodes = "".join(f"{kind.NAME} = {__name__}:{kind.__name__}\n" for kind in (PassThroughPosor, PassThroughChain))
    (info / "entry_points.txt").write_text(f"[{NODE_ENTRY_POINTS}]\n{nodes}", encoding="utf-8")
