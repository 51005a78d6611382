"""The floor: nodes with the topics, message sizes and connections of posor_node and chain_node that compute nothing.

What a message of theirs holds is prepared; only the stamp is that of what came in. They are composed as all nodes are,
by way of entry points that the benchmark makes in its own folder, see ``register``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATES_TOPIC,
    RAW_TOPIC,
    TRANSFORM_TOPIC,
    result_qos,
    sensor_qos,
)
from posor_estimator.ros.registry import GROUP
from posor_estimator.ros.wire import Inlet, Outlet
from posor_msgs.msg import JointTransform, RawScan
from pydantic import Field
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from pathlib import Path

STAMP = slice(4, 12)
"""Where every message with a header has its stamp."""
MOST_OPEN = 1000
"""Stamps that wait for further joints; of more the oldest is dropped."""


class _Prepared:
    """A message and the topic that it goes out on."""

    def __init__(self, node: PosorNode[Any], message: Any, topic: str, qos: Any) -> None:
        data = serialize_message(message)
        self._before, self._after = data[: STAMP.start], data[STAMP.stop :]
        self._outlet = Outlet(node, type(message), topic, qos)
        node.when_cleaned_up(self._outlet.destroy)

    def publish(self, stamp: bytes) -> None:
        """Publish the message with a stamp, as its bytes."""
        self._outlet.publish(self._before + stamp + self._after)


class FloorPosorParameters(NodeParameters):
    """Parameters of floor_posor."""

    parent: str = Field(description="frame of the receiving plate")
    child: str = Field(description="frame of the target plate")


class FloorPosor(PosorNode[FloorPosorParameters]):
    """Answers every scan with the same transform."""

    NAME = "floor_posor"
    Parameters = FloorPosorParameters

    def configure(self) -> None:
        """Open the topics."""
        message = JointTransform(child_frame_id=self.parameters.child)
        message.header.frame_id = self.parameters.parent
        qos = sensor_qos(self.parameters)
        self._transform = _Prepared(self, message, TRANSFORM_TOPIC, qos)
        self.when_cleaned_up(Inlet(self, RawScan, RAW_TOPIC, qos, self._take).destroy)

    def _take(self, data: bytes) -> None:
        self._transform.publish(data[STAMP])


class FloorChainParameters(NodeParameters):
    """Parameters of floor_chain."""

    joints: tuple[str, ...] = Field(description="names of the arm's joints")
    frame: str = Field(description="base frame")


class FloorChain(PosorNode[FloorChainParameters]):
    """Answers the last transform of each stamp with the same endpoint."""

    NAME = "floor_chain"
    Parameters = FloorChainParameters

    def configure(self) -> None:
        """Open the topics."""
        joints = self.parameters.joints
        results, qos = result_qos(self.parameters), sensor_qos(self.parameters)
        pose, with_covariance = PoseStamped(), PoseWithCovarianceStamped()
        pose.header.frame_id = with_covariance.header.frame_id = self.parameters.frame
        states = JointState(name=list(joints), position=[0.0] * len(joints))
        topics = (
            (pose, ENDPOINT_TOPIC),
            (with_covariance, ENDPOINT_COVARIANCE_TOPIC),
            (states, JOINT_STATES_TOPIC),
        )
        self._results = [_Prepared(self, message, topic, results) for message, topic in topics]
        self._seen: dict[bytes, int] = {}
        self._complete = len(joints)
        for joint in joints:
            inlet = Inlet(self, JointTransform, f"{joint}/{TRANSFORM_TOPIC}", qos, self._take)
            self.when_cleaned_up(inlet.destroy)

    def _take(self, data: bytes) -> None:
        stamp = data[STAMP]
        count = self._seen.pop(stamp, 0) + 1
        if count < self._complete:
            self._seen[stamp] = count
            if len(self._seen) > MOST_OPEN:
                del self._seen[next(iter(self._seen))]
            return
        for result in self._results:
            result.publish(stamp)


def register(folder: Path) -> None:
    """Make the two nodes known, by their names, to whatever Python finds ``folder`` on its path."""
    info = folder / "posor_floor-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: posor_floor\nVersion: 1.0\n", encoding="utf-8")
    nodes = "".join(f"{kind.NAME} = {__name__}:{kind.__name__}\n" for kind in (FloorPosor, FloorChain))
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{nodes}", encoding="utf-8")
