"""Writes the endpoint's messages from the arrays of an endpoint estimator."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_msgs.msg import EndpointState
from sensor_msgs.msg import JointState

from posor_estimator.cdr_writer import MessageWriter

if TYPE_CHECKING:
    from posor.chain.endpoint_estimator import EndpointEstimator

    from posor_estimator.endpoint_verdict import EndpointVerdict

MAX_JOINT, MAX_REASON = 128, 255  # bounds of the strings in ``posor_msgs/EndpointState`` [bytes]
WRITERS = 16  # number of verdicts whose messages are kept prepared


class EndpointWriter:
    """Writes the results of an endpoint estimator.

    Attributes:
        pose: Of ``PoseStamped``.
        pose_with_covariance: Of ``PoseWithCovarianceStamped``.
        joint_states: Of ``JointState``, the positions only.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, *, relative: bool) -> None:
        """Prepare; ``frame``: frame of the endpoint; ``relative``: whether to write the endpoint relative to home."""
        pose = estimator.relative_pose if relative else estimator.pose
        covariance = estimator.relative_covariance if relative else estimator.covariance
        plain, full, joints = PoseStamped(), PoseWithCovarianceStamped(), JointState()
        plain.header.frame_id = full.header.frame_id = frame
        joints.name, joints.position = list(estimator.joints), [0.0] * len(estimator.joints)
        self.pose = MessageWriter(plain, {"pose.position.x": pose})
        self.pose_with_covariance = MessageWriter(full, {"pose.pose.position.x": pose, "pose.covariance": covariance})
        self.joint_states = MessageWriter(joints, {"position": estimator.angles})


class EndpointStateWriter:
    """Writes ``EndpointState``; pose, covariance and protection level are NaN without a pose.

    Attributes:
        protection_level: Written into every message with a pose, (6,) [m], [rad]; NaN: not known.

    """

    def __init__(self, estimator: EndpointEstimator, frame: str, child_frame: str, *, relative: bool) -> None:
        pose = estimator.relative_pose if relative else estimator.pose
        covariance = estimator.relative_covariance if relative else estimator.covariance
        self.protection_level = np.full(6, np.nan)
        self._age = np.full(1, np.nan)
        endpoint = {"pose.position.x": pose, "covariance": covariance, "protection_level": self.protection_level}
        nothing = {name: np.full(numbers.shape, np.nan) for name, numbers in endpoint.items()}

        @lru_cache(maxsize=WRITERS)
        def writer_of(verdict: EndpointVerdict) -> MessageWriter:
            joint, reason = (
                text.encode()[:limit].decode(errors="ignore")
                for text, limit in ((verdict.joint, MAX_JOINT), (verdict.reason, MAX_REASON))
            )
            message = EndpointState(
                child_frame_id=child_frame, state=verdict.state, faults=verdict.faults, joint=joint, reason=reason
            )
            message.header.frame_id = frame
            return MessageWriter(message, {"age": self._age, **(endpoint if verdict.has_pose else nothing)})

        self._writer_of = writer_of

    def write(self, stamp: bytes, age_s: float, verdict: EndpointVerdict) -> bytes:
        """Return the message.

        ``stamp``: the eight bytes of its stamp (``STAMP``); ``age_s``: from the stamp to now [s]; NaN: no scan yet;
        ``verdict``: state, faults, joint and reason.
        """
        self._age[0] = age_s
        return self._writer_of(verdict).write(stamp)
