# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Loops over the messages of a bag, as a user would write them, that `reprocess` is compared with.

* Read only: reads and decodes each message with rosbags and does nothing else; the least that such a loop costs.
* Bulk: reads and decodes each message with rosbags into arrays, then estimates all poses and endpoints in a few calls.
* Message by message: decodes with rclpy, calls the estimator for each scan and the chain for each stamp, writes each
  result with rclpy and rosbags. Its results equal those of `reprocess` bit for bit, which is checked first.
"""

from __future__ import annotations

from itertools import islice, zip_longest
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from posor.bags.bag_reader import opened_bag
from posor.bags.bag_writer import BagWriter
from posor.chain.arm_file import chain_parameters
from posor.chain.identity import calibration_id
from posor.chain.joint_measurements import MeasuredJoint
from posor.errors import BagError
from posor.estimation.posor import Posor
from posor.messages.message_definitions import MessageTypes
from posor.model.scan import Scans
from posor.node_parameters import ChainParameters, NodeParameters
from posor.parameter_model import validate_parameters
from posor.ros_names import (
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATE,
    JOINT_STATES_TOPIC,
    JOINT_TRANSFORM,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    RAW_TOPIC,
    TRANSFORM_TOPIC,
)
from posor_msgs.msg import RawScan
from posor_ros.message_classes import message_class, schema_of_class
from posor_ros.qos import result_qos
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from posor_lab.harness.message_conversion import estimate_with_effects, scan_from_message, stamp_ns, transform_message

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray, IntArray

MAX_MESSAGES = 120_000  # messages of the read-only loop and of the bulk loop
WARM_UP_TICKS, TICKS = 100, 2000  # ticks of the loop message by message: before the time is taken, and in all
SAME_POSE = 1e-12
"""Largest difference of the bulk loop's poses from those of `reprocess` [m, and without unit for quaternions]."""
ENDPOINT_TYPES = {
    ENDPOINT_TOPIC: POSE_STAMPED,
    ENDPOINT_COVARIANCE_TOPIC: POSE_WITH_COVARIANCE_STAMPED,
    JOINT_STATES_TOPIC: JOINT_STATE,
}


def run_message_loop(arm: ArmFile, bag: Path, output: Path) -> float:
    """Process a bag message by message into a bag of transforms and endpoints; return scans per second."""
    calibrations = {joint: arm.calibration(joint) for joint in arm.calibrations}
    posors = {joint: Posor(calibration) for joint, calibration in calibrations.items()}
    numbers = {joint: calibration_id(calibration) for joint, calibration in calibrations.items()}
    causes = {joint: posor.hypotheses.joint_causes() for joint, posor in posors.items()}
    joints = {f"/{arm.name}/{joint}/{RAW_TOPIC}": joint for joint in posors}
    chain = arm.chain()
    parameters = validate_parameters(ChainParameters, chain_parameters(arm), node="chain_node")
    estimator = chain.estimator(parameters.acceleration_window)
    open_scans = dict[int, dict[str, MeasuredJoint]]()
    with opened_bag(bag) as reader, BagWriter(output) as writer:
        _add_topics(writer, arm)
        begin, first, last = 0.0, WARM_UP_TICKS * len(posors), TICKS * len(posors)
        for count, (connection, time_ns, data) in enumerate(islice(reader.messages(), last)):
            if count == first:
                begin = process_time()
            raw = deserialize_message(bytes(data), RawScan)
            joint = joints[connection.topic]
            scan, frames = scan_from_message(raw), calibrations[joint].frames
            estimate, effects = estimate_with_effects(posors[joint], scan)
            faults = causes[joint], effects
            transform = transform_message(raw, estimate, frames.parent, frames.child, faults, numbers[joint])
            writer.write(f"/{arm.name}/{joint}/{TRANSFORM_TOPIC}", time_ns, serialize_message(transform))
            if estimate.T_R_T is not None:
                measured = open_scans.setdefault(scan.stamp_ns, {})
                measured[joint] = MeasuredJoint(
                    estimate.T_R_T, estimate.covariance_random, estimate.covariance_systematic
                )
                estimator.thetas[estimator.joints.index(joint)] = estimate.native[5]
                if len(measured) == len(posors):
                    estimator.set_measurements(open_scans.pop(scan.stamp_ns))
                    estimator.estimate(scan.stamp_ns)
                    for topic, message in _endpoint_messages(chain.base_frame, raw, estimator):
                        writer.write(f"/{arm.name}/{topic}", time_ns, serialize_message(message))
        return (last - first) / (process_time() - begin)


def _add_topics(writer: BagWriter, arm: ArmFile) -> None:
    types, qos = MessageTypes(), [result_qos(NodeParameters())]
    kinds = {f"{joint}/{TRANSFORM_TOPIC}": JOINT_TRANSFORM for joint in arm.calibrations} | ENDPOINT_TYPES
    for topic, kind in kinds.items():
        writer.add_topic(f"/{arm.name}/{topic}", kind, types.definition(kind), qos)


def _endpoint_messages(frame: str, raw: RawScan, estimator: Any) -> Iterator[tuple[str, Any]]:
    """Yield topics and messages of the endpoint of an estimator."""
    pose, full = PoseStamped(), PoseWithCovarianceStamped()
    states = JointState(name=list(estimator.joints), position=estimator.angles)
    for message in (pose, full, states):
        message.header.stamp = raw.header.stamp
    pose.header.frame_id = full.header.frame_id = frame
    x, y, z, qx, qy, qz, qw = estimator.pose.tolist()
    pose.pose = full.pose.pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    full.pose.covariance = estimator.covariance().ravel()
    yield ENDPOINT_TOPIC, pose
    yield ENDPOINT_COVARIANCE_TOPIC, full
    yield JOINT_STATES_TOPIC, states


def run_reading_loop(bag: Path) -> float:
    """Read and decode messages of a bag with rosbags; return messages per second."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        begin, count = process_time(), 0
        for connection, _, data in islice(reader.messages(), MAX_MESSAGES):
            reader.deserialize(data, connection.msgtype)
            count += 1
        return count / (process_time() - begin)


def run_bulk_loop(arm: ArmFile, bag: Path) -> tuple[float, IntArray, FloatArray]:
    """Read messages of a bag into arrays, then estimate all poses and endpoints at once.

    Returns scans per second; stamps [ns], (n,); endpoints as x, y, z [m] and quaternion x, y, z, w, (n, 7).
    """
    posors = {f"/{arm.name}/{joint}/{RAW_TOPIC}": Posor(arm.calibration(joint)) for joint in arm.calibrations}
    messages: dict[str, list[Any]] = {topic: [] for topic in posors}
    parameters = validate_parameters(ChainParameters, chain_parameters(arm), node="chain_node")
    estimator = arm.chain().estimator(parameters.acceleration_window)
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        begin = process_time()
        for connection, _, data in islice(reader.messages(), MAX_MESSAGES):
            messages[connection.topic].append(reader.deserialize(data, connection.msgtype))
    scans = [_scans_from_messages(of_topic) for of_topic in messages.values()]
    estimates = [posor.estimate_all(of_joint) for posor, of_joint in zip(posors.values(), scans, strict=True)]
    stamps_ns = scans[0].stamps_ns
    endpoints = estimator.estimate_all(
        np.stack([joint.poses for joint in estimates], axis=1),
        np.stack([joint.covariances_random for joint in estimates], axis=1),
        np.stack([joint.covariances_systematic for joint in estimates], axis=1),
        stamps_ns,
        np.stack([joint.thetas for joint in estimates], axis=1),
    )
    count = sum(map(len, scans))
    return count / (process_time() - begin), stamps_ns, endpoints.poses


def _scans_from_messages(messages: Sequence[Any]) -> Scans:
    """Return decoded raw scans of one joint as arrays."""
    return Scans.from_fields(
        numbers=np.array([message.scan for message in messages], dtype=np.uint64),
        stamps_ns=np.array([stamp_ns(message) for message in messages]),
        gap_voltages=np.array([message.gap_voltages for message in messages]),
        ring_voltages=np.array([message.ring_voltages for message in messages]),
        diode_currents=np.array([message.diode_currents for message in messages]),
        lit_sources=np.array([message.lit_sources for message in messages], dtype=np.int64),
        supply_voltages=np.array([message.supply_voltage for message in messages]),
        temperatures=np.array([message.temperature for message in messages]),
        reference_voltages=np.array([message.reference_voltage for message in messages]),
        statuses=np.array([message.status for message in messages], dtype=np.int64),
        at_home=np.array([message.status & RawScan.STATUS_HOME_BUMP != 0 for message in messages], dtype=np.int64),
    )


def check_same_endpoints(arm: ArmFile, stamps_ns: IntArray, poses: FloatArray, reprocessed: Path) -> None:
    """Compare endpoints with the beginning of a reprocessed bag.

    Raises BagError: a pose is missing or differs by more than ``SAME_POSE``.
    """
    where = f"/{arm.name}/{ENDPOINT_TOPIC}"
    with opened_bag(reprocessed) as reader:
        connections = [connection for connection in reader.connections if connection.topic == where]
        messages = islice(reader.messages(connections), len(stamps_ns))
        found = [deserialize_message(bytes(data), PoseStamped) for _, _, data in messages]
    expected = [
        (p.position.x, p.position.y, p.position.z, p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w)
        for p in (message.pose for message in found)
    ]
    same_stamps = [stamp_ns(message) for message in found] == stamps_ns.tolist()
    if not same_stamps or not np.allclose(poses, expected, rtol=0.0, atol=SAME_POSE):
        raise BagError(f"endpoints of {where} differ", where=str(reprocessed), expected="those of the bulk loop")


def check_same_messages(looped: Path, reprocessed: Path) -> None:
    """Compare the bag of the loop message by message with the beginning of a reprocessed bag, bit by bit.

    Raises BagError: a message differs.
    """
    expected = _messages_by_topic(looped)
    end_ns = max(time_ns for messages in expected.values() for time_ns, _ in messages)
    found = _messages_by_topic(reprocessed, end_ns)
    for topic in sorted(expected | found):
        for number, pair in enumerate(zip_longest(expected.get(topic, ()), found.get(topic, ()))):
            if pair[0] != pair[1]:
                what = f"message {number} of {topic} differs from that of the loop message by message"
                raise BagError(what, where=str(reprocessed), expected="the same bits")


def _messages_by_topic(bag: Path, end_ns: int | None = None) -> dict[str, list[tuple[int, bytes]]]:
    """Return times [ns] and messages of each topic up to a time, serialised with zeros as padding."""
    found = dict[str, list[tuple[int, bytes]]]()
    with opened_bag(bag) as reader:
        for connection, time_ns, data in reader.messages(stop=None if end_ns is None else end_ns + 1):
            kind = message_class(connection.msgtype)
            message = schema_of_class(kind).serialize(deserialize_message(bytes(data), kind))
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found
