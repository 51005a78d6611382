"""Writes the endpoint's messages from the arrays of an endpoint estimator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import JointState

from posor_estimator.ros.cdr_writer import MessageWriter

if TYPE_CHECKING:
    from posor_estimator.chain.endpoint_estimator import EndpointEstimator


class EndpointWriter:
    """Writes the results of an endpoint estimator.

    Attributes:
        pose: Of ``PoseStamped``.
        pose_with_covariance: Of ``PoseWithCovarianceStamped``.
        joint_states: Of ``JointState``, the positions only.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, *, relative: bool) -> None:
        """Prepare.

        Args:
            estimator: Of the chain.
            frame: Frame of the endpoint.
            relative: Whether to write the endpoint relative to home.

        """
        pose = estimator.relative_pose if relative else estimator.pose
        covariance = estimator.relative_covariance if relative else estimator.covariance
        plain, full, joints = PoseStamped(), PoseWithCovarianceStamped(), JointState()
        plain.header.frame_id = full.header.frame_id = frame
        joints.name, joints.position = list(estimator.joints), [0.0] * len(estimator.joints)
        self.pose = MessageWriter(plain, {"pose.position.x": pose})
        self.pose_with_covariance = MessageWriter(full, {"pose.pose.position.x": pose, "pose.covariance": covariance})
        self.joint_states = MessageWriter(joints, {"position": estimator.angles})
