"""Publishes the frames of an arm for viewers: /tf, /tf_static and the robot description.

The joints and the beams of the beams file move; their product with the fixed joints of the URDF, in the order of the
links, is the endpoint's pose of the same stamp in the base frame. robot_state_publisher leaves floating joints out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from posor.numerics.stamps import NS
from posor.ros_names import ROBOT_DESCRIPTION_TOPIC, TF_STATIC_TOPIC, TF_TOPIC
from posor_ros.idle_scheduler import run_when_idle
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import LATCHED_QOS, TF_QOS
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray
    from posor_ros.lifecycle_node import PosorNode


class StampedPoses(NamedTuple):
    """Poses of the joints, then of the beams, of one scan."""

    stamp_ns: int  # of the scan [ns]
    poses: FloatArray  # child link in parent link, (j + b, 7): x, y, z [m], unit quaternion x, y, z, w


class FramePublisher:
    """Publishes the frames of an arm while its node is configured."""

    def __init__(
        self, node: PosorNode[Any], chain: Chain, rate: float, newest: Callable[[], StampedPoses | None]
    ) -> None:
        """Publish what does not move, also while the node is inactive, and start to publish the rest.

        ``rate``: how often /tf is published [1/s]; ``newest``: returns the poses of the newest scan; None: it gives no
        endpoint, or the node must not publish.
        """
        self._newest, self._published_ns, self._is_open = newest, 0, True
        joints = (*chain.joints, *chain.beam_joints)
        self._moving = TFMessage(transforms=[_transform(joint.parent, joint.child) for joint in joints])
        self._publisher = node.create_publisher(TFMessage, TF_TOPIC, TF_QOS)
        fixed = TFMessage(transforms=[_transform(each.parent, each.child) for each in chain.fixed_transforms])
        poses = [pin.SE3ToXYZQUAT(each.T_parent_child) for each in chain.fixed_transforms]
        _set_transforms(fixed, StampedPoses(node.timing.now_ns(), np.array(poses).reshape(-1, 7)))
        static = node.create_publisher(TFMessage, TF_STATIC_TOPIC, LATCHED_QOS)
        description = node.create_publisher(String, ROBOT_DESCRIPTION_TOPIC, LATCHED_QOS)
        for publisher, message in ((static, fixed), (description, String(data=chain.urdf))):
            publisher.publish(schema_of_class(type(message)).serialize(message))
        for publisher in (self._publisher, static, description):
            node.add_cleanup(node.destroy_publisher, publisher)
        node.add_cleanup(self._close)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = node.create_timer(1.0 / rate, lambda: run_when_idle(self._publish), clock=clock)
        node.add_cleanup(node.destroy_timer, timer)

    def _close(self) -> None:
        """Publish nothing more; the executor may hold a call of the destroyed timer."""
        self._is_open = False

    def _publish(self) -> None:
        """Publish the transforms of the newest scan with a pose, once, and only while there is a subscription."""
        if not self._is_open or not self._publisher.get_subscription_count():
            return
        newest = self._newest()
        if newest is None or newest.stamp_ns == self._published_ns:
            return
        self._published_ns = newest.stamp_ns
        _set_transforms(self._moving, newest)
        self._publisher.publish(schema_of_class(TFMessage).serialize(self._moving))


def _transform(parent: str, child: str) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    return message


def _set_transforms(message: TFMessage, frames: StampedPoses) -> None:
    stamp = Time(sec=frames.stamp_ns // NS, nanosec=frames.stamp_ns % NS)
    for each, (x, y, z, qx, qy, qz, qw) in zip(message.transforms, frames.poses.tolist(), strict=True):
        each.header.stamp = stamp
        translation, rotation = each.transform.translation, each.transform.rotation
        translation.x, translation.y, translation.z = x, y, z
        rotation.x, rotation.y, rotation.z, rotation.w = qx, qy, qz, qw
