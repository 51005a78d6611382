"""What reprocessing is compared with: a loop over the messages of a bag as one would write it, one by one.

It reads and writes by rosbags, decodes and encodes by rclpy, and asks the same compiled core for one scan and for one
endpoint at a time. What comes of it is what ``reprocess`` writes, to the last bit: that is looked at first.
"""

from __future__ import annotations

from itertools import islice, zip_longest
from time import process_time
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from posor_drivers.bag_writer import BagWriter
from posor_drivers.offered_qos import kept_in_bag
from posor_estimator.arm_chain import chain_parameters
from posor_estimator.chain_node import ChainParameters
from posor_estimator.core.chain import MeasuredJoint
from posor_estimator.core.posor import Posor
from posor_estimator.errors import BagError
from posor_estimator.ros.bag_reader import opened_bag
from posor_estimator.ros.cdr import Schema
from posor_estimator.ros.message_types import (
    JOINT_STATE,
    JOINT_TRANSFORM,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    MessageTypes,
    message_class,
)
from posor_estimator.ros.messages import chosen_covariance, scan_from_message, transform_message
from posor_estimator.ros.parameters import NodeParameters, validate
from posor_estimator.ros.qos import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATES_TOPIC,
    RAW_TOPIC,
    TRANSFORM_TOPIC,
    sensor_qos,
)
from posor_msgs.msg import RawScan
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor_estimator.core.arm import Arm

READ = 100_000
"""Messages that are only read, at most."""
WARM_UP, TICKS = 100, 2000
"""Ticks of which the scans are reprocessed one by one: before the clock is started, and in all."""
ENDPOINT_KINDS = {
    ENDPOINT_TOPIC: POSE_STAMPED,
    ENDPOINT_COVARIANCE_TOPIC: POSE_WITH_COVARIANCE_STAMPED,
    JOINT_STATES_TOPIC: JOINT_STATE,
}


def plain_loop(arm: Arm, bag: Path, output: Path) -> float:
    """Return how many scans a second of processor time are turned into a bag of transforms and endpoints."""
    calibrations = {joint: arm.calibration(joint) for joint in arm.calibrations}
    posors = {joint: Posor(calibration) for joint, calibration in calibrations.items()}
    joints = {f"/{arm.name}/{joint}/{RAW_TOPIC}": joint for joint in posors}
    chain = arm.chain()
    told = validate(ChainParameters, chain_parameters(arm), node="chain_node")
    lane = chain.lane(told.acceleration_window)
    open_scans = dict[int, dict[str, MeasuredJoint]]()
    with opened_bag(bag) as reader, BagWriter(output) as writer:
        _add_topics(writer, arm)
        begin, first, last = 0.0, WARM_UP * len(posors), TICKS * len(posors)
        for count, (connection, time_ns, data) in enumerate(islice(reader.messages(), last)):
            if count == first:
                begin = process_time()
            raw = deserialize_message(bytes(data), RawScan)
            joint = joints[connection.topic]
            scan, frames = scan_from_message(raw), calibrations[joint].frames
            estimate = posors[joint].locate(scan)
            transform = transform_message(raw, estimate, frames.parent, frames.child, "total")
            writer.write(f"/{arm.name}/{joint}/{TRANSFORM_TOPIC}", time_ns, serialize_message(transform))
            if estimate.T_R_T is not None:
                measured = open_scans.setdefault(scan.stamp_ns, {})
                measured[joint] = MeasuredJoint(estimate.T_R_T, chosen_covariance(estimate, "total"))
                lane.thetas[lane.joints.index(joint)] = estimate.native[5]
                if len(measured) == len(posors):
                    lane.take(open_scans.pop(scan.stamp_ns))
                    lane.run(scan.stamp_ns)
                    for topic, message in _endpoint(chain.base_frame, raw, lane):
                        writer.write(f"/{arm.name}/{topic}", time_ns, serialize_message(message))
        return (last - first) / (process_time() - begin)


def _add_topics(writer: BagWriter, arm: Arm) -> None:
    types, qos = MessageTypes(), [kept_in_bag(sensor_qos(NodeParameters()))]
    kinds = {f"{joint}/{TRANSFORM_TOPIC}": JOINT_TRANSFORM for joint in arm.calibrations} | ENDPOINT_KINDS
    for topic, kind in kinds.items():
        writer.add_topic(f"/{arm.name}/{topic}", kind, types.definition(kind), qos)


def _endpoint(frame: str, raw: RawScan, lane: Any) -> Iterator[tuple[str, Any]]:
    """Yield topics and messages of the endpoint that a lane has found."""
    pose, full = PoseStamped(), PoseWithCovarianceStamped()
    states = JointState(name=list(lane.joints), position=lane.angles)
    for message in (pose, full, states):
        message.header.stamp = raw.header.stamp
    pose.header.frame_id = full.header.frame_id = frame
    x, y, z, qx, qy, qz, qw = lane.pose.tolist()
    pose.pose = full.pose.pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    full.pose.covariance = lane.covariance.ravel()
    yield ENDPOINT_TOPIC, pose
    yield ENDPOINT_COVARIANCE_TOPIC, full
    yield JOINT_STATES_TOPIC, states


def reading(bag: Path) -> float:
    """Return how many messages of a bag rosbags reads and decodes in a second of processor time, and no more."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        begin, count = process_time(), 0
        for connection, _, data in islice(reader.messages(), READ):
            reader.deserialize(data, connection.msgtype)
            count += 1
        return count / (process_time() - begin)


def check_same(plain: Path, reprocessed: Path) -> None:
    """Compare what the plain loop has written, message by message and bit by bit, with the beginning of another bag.

    Raises:
        BagError: They are not the same.

    """
    mine = _messages(plain)
    end_ns = max(time_ns for found in mine.values() for time_ns, _ in found)
    others = _messages(reprocessed, end_ns)
    for topic in sorted(mine | others):
        for number, (one, other) in enumerate(zip_longest(mine.get(topic, ()), others.get(topic, ()))):
            if one != other:
                raise BagError(
                    f"message {number} of {topic} is another than the plain loop's",
                    where=str(reprocessed),
                    expected="the same to the last bit",
                )


def _messages(bag: Path, end_ns: int | None = None) -> dict[str, list[tuple[int, bytes]]]:
    """Return times [ns] and messages of each topic, to a time; what rclpy leaves in gaps between fields is gone."""
    found = dict[str, list[tuple[int, bytes]]]()
    with opened_bag(bag) as reader:
        for connection, time_ns, data in reader.messages(stop=None if end_ns is None else end_ns + 1):
            kind = message_class(connection.msgtype)
            message = Schema.of(kind).serialize(deserialize_message(bytes(data), kind))
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found
