"""What reprocessing is compared with: loops over the messages of a bag as one would write them, one by one."""

from __future__ import annotations

from time import process_time
from typing import TYPE_CHECKING

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from posor_drivers.bag_writer import BagWriter
from posor_drivers.offered_qos import kept_in_bag
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.chain import MeasuredJoint
from posor_estimator.core.posor import Posor
from posor_estimator.ros.bag_reader import opened_bag
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.messages import chosen_covariance, pose_message, scan_from_message, transform_message
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    RAW_TOPIC,
    TRANSFORM_TOPIC,
    sensor_qos,
)
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message, serialize_message

if TYPE_CHECKING:
    from pathlib import Path

    from posor_estimator.core.arm import Arm

SAMPLE = 100_000
"""Messages over which the reading loop is measured."""
WORKED = 12_000
"""Messages over which the loop is measured that does the work."""
KINDS = {
    TRANSFORM_TOPIC: "posor_msgs/msg/JointTransform",
    ENDPOINT_TOPIC: "geometry_msgs/msg/PoseStamped",
    ENDPOINT_COVARIANCE_TOPIC: "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def reading(bag: Path) -> float:
    """Return how many messages of a bag rosbags reads and rclpy deserialises in a second of processor time."""
    with opened_bag(bag) as reader:
        begin, count = process_time(), 0
        for _, _, data in reader.messages():
            deserialize_message(bytes(data), RawScan)
            count += 1
            if count == SAMPLE:
                break
        return count / (process_time() - begin)


def working(arm: Arm, bag: Path, output: Path) -> float:
    """Return how many scans a second of processor time are turned into a bag of transforms and endpoints, one by one.

    Read and written by rosbags, their messages by rclpy, located and fused by the same compiled core, whose calls for
    one scan these are.
    """
    types = MessageTypes()
    qos = [kept_in_bag(sensor_qos(NodeParameters()))]
    calibrations = {name: load_calibration(path) for name, path in arm.calibrations.items()}
    posors = {name: Posor(calibration) for name, calibration in calibrations.items()}
    joints = {f"/{arm.name}/{name}/{RAW_TOPIC}": name for name in posors}
    chain, open_scans = arm.chain(), dict[int, dict[str, MeasuredJoint]]()
    with opened_bag(bag) as reader, BagWriter(output) as writer:
        for topic in (*(f"{name}/{TRANSFORM_TOPIC}" for name in posors), ENDPOINT_TOPIC, ENDPOINT_COVARIANCE_TOPIC):
            kind = KINDS.get(topic, KINDS[TRANSFORM_TOPIC])
            writer.add_topic(topic, kind, types.definition(kind), qos)
        begin, count = process_time(), 0
        for connection, time_ns, data in reader.messages():
            raw = deserialize_message(bytes(data), RawScan)
            name = joints[connection.topic]
            scan, frames = scan_from_message(raw), calibrations[name].frames
            estimate = posors[name].locate(scan)
            transform = transform_message(raw, estimate, frames.parent, frames.child, "total")
            writer.write(f"{name}/{TRANSFORM_TOPIC}", time_ns, serialize_message(transform))
            count += 1
            if estimate.T_R_T is not None:
                measured = open_scans.setdefault(scan.stamp_ns, {})
                measured[name] = MeasuredJoint(estimate.T_R_T, chosen_covariance(estimate, "total"))
                if len(measured) == len(posors):
                    endpoint = chain.endpoint(open_scans.pop(scan.stamp_ns))
                    pose = PoseStamped(pose=pose_message(endpoint.T_base_endpoint))
                    full = PoseWithCovarianceStamped()
                    full.pose.pose, full.pose.covariance = pose.pose, endpoint.covariance.ravel()
                    full.header.stamp = pose.header.stamp = raw.header.stamp
                    writer.write(ENDPOINT_TOPIC, time_ns, serialize_message(pose))
                    writer.write(ENDPOINT_COVARIANCE_TOPIC, time_ns, serialize_message(full))
            if count == WORKED:
                break
        return count / (process_time() - begin)
