"""The endpoint's messages as bytes, written from the chain's lane."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import JointState

from posor_estimator.ros.cdr_writer import MessageWriter

if TYPE_CHECKING:
    from posor_estimator.core.chain_lane import ChainLane


class EndpointWriter:
    """Writes what a lane finds.

    Attributes:
        pose: Of ``PoseStamped``.
        pose_with_covariance: Of ``PoseWithCovarianceStamped``.
        joint_states: Of ``JointState``, the positions only.

    """

    def __init__(self, lane: ChainLane, frame: str, *, relative: bool) -> None:
        """Prepare.

        Args:
            lane: The chain's.
            frame: In which the endpoint is given.
            relative: Whether to write the endpoint as it is relative to home.

        """
        pose = lane.relative_pose if relative else lane.pose
        covariance = lane.relative_covariance if relative else lane.covariance
        plain, full, joints = PoseStamped(), PoseWithCovarianceStamped(), JointState()
        plain.header.frame_id = full.header.frame_id = frame
        joints.name, joints.position = list(lane.joints), [0.0] * len(lane.joints)
        self.pose = MessageWriter(plain, {"pose.position.x": pose})
        self.pose_with_covariance = MessageWriter(full, {"pose.pose.position.x": pose, "pose.covariance": covariance})
        self.joint_states = MessageWriter(joints, {"position": lane.angles})
