"""Protection level of the endpoint from the messages on the reliability of the joints, and from the beams file."""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.errors import TopicError
from posor.uncertainty.protection_level import endpoint_effects, endpoint_protection_level, expansion_shifts
from posor_msgs.msg import JointReliability
from posor_ros.message_classes import schema_of_class

if TYPE_CHECKING:
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray

FREEDOMS = 6
VALID_S = 5.0  # time after which a message on the reliability of a joint is not used any more [s]


class ProtectionLevel:
    """Protection level of the endpoint from the latest reliability of each joint."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self._received: dict[str, tuple[float, FloatArray]] = {}

    def receive(self, joint: str, data: bytes) -> None:
        """Keep a JointReliability; ignore one with other frames, another length, or too few readings for a pose."""
        expected = next(own for own in self._chain.joints if own.name == joint)
        try:
            message = schema_of_class(JointReliability).values(data)
        except TopicError:
            return
        shifts, readings = np.array(message["undetected_shifts"]), len(message["readings"])
        frames = message["header.frame_id"], message["child_frame_id"]
        is_whole = shifts.size == 6 * readings and readings >= FREEDOMS
        if frames == (expected.parent, expected.child) and is_whole:
            self._received[joint] = monotonic(), shifts.reshape(-1, 6)

    def compute(self, poses: FloatArray, covariance: FloatArray, axes: FloatArray) -> FloatArray:
        """Return the protection level, (6,); NaN without a covariance, or without a recent message of each joint.

        ``poses``: of the joints, (j, 7), as ``EndpointEstimator.poses``; ``covariance``: of the endpoint, (6, 6), in
        the axes of the result; ``axes``: rotation of these axes in the base, (3, 3).
        """
        names, oldest_s = [joint.name for joint in self._chain.joints], monotonic() - VALID_S
        if (
            any(name not in self._received or self._received[name][0] < oldest_s for name in names)
            or np.isnan(covariance).any()
        ):
            return np.full(6, np.nan)
        transforms = {name: pin.XYZQUATToSE3(pose) for name, pose in zip(names, poses, strict=True)}
        effects = endpoint_effects(self._chain, transforms)
        turn = np.kron(np.eye(2), axes.T)
        return endpoint_protection_level(
            [self._received[name][1] for name in names],
            [turn @ effects[name] for name in names],
            covariance,
            expansion_shifts(self._chain, transforms) @ turn.T,
        )
