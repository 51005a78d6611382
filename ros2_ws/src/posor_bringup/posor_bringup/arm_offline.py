"""What the nodes of an arm make of raw scans, without any node: the same steps in the same order, the same numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.chain_node import ChainParameters
from posor_estimator.core.beam_motion import MovingChain
from posor_estimator.core.posor import Posor
from posor_estimator.ros.messages import is_usable, measured_joint, scan_from_message, stamp_ns, transform_message
from posor_estimator.ros.parameters import validate

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.chain import Endpoint
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


def endpoints(arm: Arm, scans: Mapping[str, Sequence[RawScan]]) -> Iterator[tuple[int, Endpoint]]:
    """Yield time [ns] and endpoint of every scan for which a chain_node has a pose, in order.

    Args:
        arm: The arm.
        scans: Of every joint, in the order of their stamps.

    Raises:
        CalibrationError: A calibration or the beams file cannot be used.
        ChainError: The URDF cannot be used.
        ParameterError: The arm file gives chain_node parameters that it does not take.

    """
    chain = arm.chain()
    told = validate(ChainParameters, {"urdf": str(arm.urdf), **arm.chain_parameters}, node="chain_node")
    moving = MovingChain(chain, told.acceleration_window)
    located = {
        joint.name: {stamp_ns(message): message for message in transforms(arm, joint.name, scans[joint.name])}
        for joint in chain.joints
    }
    for time_ns in sorted(set.intersection(*(set(messages) for messages in located.values()))):
        scan = {name: messages[time_ns] for name, messages in located.items()}
        if all(map(is_usable, scan.values())):
            measured = {name: measured_joint(message) for name, message in scan.items()}
            yield time_ns, moving.endpoint(time_ns, measured)
