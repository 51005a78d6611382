"""What the nodes of an arm make of raw scans, without any node: the same steps in the same order, the same numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.arm_chain import chain_parameters
from posor_estimator.chain_node import ChainParameters
from posor_estimator.core.posor import Posor
from posor_estimator.ros.messages import is_usable, scan_from_message, stamp_ns, transform_message
from posor_estimator.ros.parameters import validate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.types import FloatArray
    from posor_msgs.msg import JointTransform, RawScan


def transforms(arm: Arm, joint: str, scans: Sequence[RawScan]) -> list[JointTransform]:
    """Return what a posor_node publishes for scans, in order.

    Raises:
        CalibrationError: The joint's calibration cannot be used.

    """
    calibration = arm.calibration(joint)
    posor, frames = Posor(calibration), calibration.frames
    return [
        transform_message(scan, posor.locate(scan_from_message(scan)), frames.parent, frames.child, "total")
        for scan in scans
    ]


def endpoints(arm: Arm, scans: Mapping[str, Sequence[RawScan]]) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Yield time [ns], pose (7,) and covariance (6, 6) of every scan for which a chain_node has an endpoint, in order.

    Args:
        arm: The arm.
        scans: Of every joint, in the order of their stamps.

    Raises:
        CalibrationError: A calibration or the beams file cannot be used.
        ChainError: The URDF cannot be used.
        NodeError: The arm file gives chain_node parameters that it does not take.

    """
    chain = arm.chain()
    told = validate(ChainParameters, chain_parameters(arm), node="chain_node")
    lane = chain.lane(told.acceleration_window)
    located = {
        joint.name: {stamp_ns(message): message for message in transforms(arm, joint.name, scans[joint.name])}
        for joint in chain.joints
    }
    for time_ns in sorted(set.intersection(*(set(messages) for messages in located.values()))):
        scan = {name: messages[time_ns] for name, messages in located.items()}
        if all(map(is_usable, scan.values())):
            for number, name in enumerate(lane.joints):
                at, turn = scan[name].pose.position, scan[name].pose.orientation
                lane.poses[number] = at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w
                lane.covariances[number] = np.reshape(scan[name].covariance, (6, 6))
            lane.run(time_ns)
            yield time_ns, lane.pose.copy(), lane.covariance.copy()
