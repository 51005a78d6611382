# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages built from numbers, for sources, the simulator and bags; their CDR bytes do not depend on the middleware."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.chain.beam_temperatures import CELSIUS
from posor.numerics.stamps import NS
from posor.ros_names import (
    ACCELERATION_TOPIC,
    IMU,
    JOINT_STATE,
    POINT_STAMPED,
    POSE_STAMPED,
    RAW_SCAN,
    RAW_TOPIC,
    TEMPERATURE,
    TEMPERATURE_TOPIC,
    TRANSFORM_STAMPED,
    VECTOR_STAMPED,
)

from posor_drivers.sources.source import SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.messages.message_definitions import MessageTypes
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.arm_simulation import ArmSimulation
    from posor_drivers.simulator.pose_array import ArmTruth
    from posor_drivers.simulator.simulated_scans import SimulatedScans


def header(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """Return a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    stamp = types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return types.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def raw_scan(types: MessageTypes, stamp_ns: int, frame_id: str, **fields: Any) -> Any:
    """Return a posor_msgs/RawScan; a missing field is empty, not measured (NaN), not stated (0), or one sample."""
    empty = np.empty(0)
    defaults = {
        "header": header(types, stamp_ns, frame_id),
        "samples": 1,
        "status": 0,
        "gap_voltages": empty,
        "gap_voltage_spreads": empty,
        "ring_voltages": empty,
        "ring_voltage_spreads": empty,
        "diode_currents": empty,
        "diode_current_spreads": empty,
        "lit_sources": np.empty(0, dtype=np.uint8),
        "exposure_offsets": empty,
        "exposure_span": 0.0,
        "stamp_uncertainty": 0.0,
        "stamp_limit": 0.0,
        "supply_voltage": math.nan,
        "temperature": math.nan,
        "reference_voltage": math.nan,
    }
    return types.new(RAW_SCAN, **(defaults | fields))


def scan_fields(scan: Scan) -> dict[str, Any]:
    """Return the fields of ``raw_scan`` that hold the number and readings of a scan."""
    return {
        "scan": scan.number,
        "gap_voltages": scan.gap_voltages,
        "ring_voltages": scan.ring_voltages,
        "diode_currents": scan.diode_currents.ravel(),
        "lit_sources": np.array(scan.lit_sources, dtype=np.uint8),
        "exposure_offsets": scan.exposure_offsets,
        "exposure_span": scan.exposure_span,
        "stamp_uncertainty": scan.stamp_uncertainty,
        "stamp_limit": scan.stamp_limit,
        "supply_voltage": scan.supply_voltage,
        "temperature": scan.temperature,
        "reference_voltage": scan.reference_voltage,
    }


def point_stamped(types: MessageTypes, stamp_ns: int, frame_id: str, position: Iterable[float]) -> Any:
    """Return a geometry_msgs/PointStamped of a position x, y, z [m]."""
    x, y, z = position
    point = types.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return types.new(POINT_STAMPED, header=header(types, stamp_ns, frame_id), point=point)


def transform_stamped(types: MessageTypes, stamp_ns: int, frames: tuple[str, str], values: Iterable[float]) -> Any:
    """Return a geometry_msgs/TransformStamped: x, y, z [m] and the unit quaternion x, y, z, w of frame 2 in frame 1."""
    x, y, z, qx, qy, qz, qw = values
    translation = types.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
    rotation = types.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw)
    content = types.new("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
    stamped = header(types, stamp_ns, frames[0])
    return types.new(TRANSFORM_STAMPED, header=stamped, child_frame_id=frames[1], transform=content)


def pose_stamped(types: MessageTypes, stamp_ns: int, frame_id: str, pose: pin.SE3) -> Any:
    """Return a geometry_msgs/PoseStamped."""
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose).tolist()
    position = types.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    orientation = types.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw)
    content = types.new("geometry_msgs/msg/Pose", position=position, orientation=orientation)
    return types.new(POSE_STAMPED, header=header(types, stamp_ns, frame_id), pose=content)


def temperature(types: MessageTypes, stamp_ns: int, name: str, kelvin: float, uncertainty: float = 0.0) -> Any:
    """Return a sensor_msgs/Temperature in the frame ``name``; ``uncertainty``: standard one [K], zero: not stated."""
    fields = {"temperature": kelvin - CELSIUS, "variance": uncertainty**2}
    return types.new(TEMPERATURE, header=header(types, stamp_ns, name), **fields)


class SimulatedTopics:
    """Topics of an arm; all names are absolute because they belong to the arm, not to a joint."""

    def __init__(self, namespace: str) -> None:
        """Make the names for the arm of this namespace, such as "/five_axis"."""
        self._namespace = namespace
        self.endpoint = Topic(f"{namespace}/truth/endpoint", POSE_STAMPED)
        self.target = Topic(f"{namespace}/target/endpoint", POSE_STAMPED)
        self.encoders = Topic(f"{namespace}/encoders", JOINT_STATE)
        self.stage = Topic(f"{namespace}/stage/position", VECTOR_STAMPED)
        self.stage_command = Topic(f"{namespace}/stage/command", VECTOR_STAMPED)

    def joint_truth(self, joint: str) -> Topic:
        """Return the topic of a joint's true ``T_parent_child``."""
        return Topic(f"{self._namespace}/truth/{joint}", POSE_STAMPED)

    def temperature(self, thermometer: str) -> Topic:
        """Return the topic of a thermometer of a beam."""
        return Topic(f"{self._namespace}/{TEMPERATURE_TOPIC}/{thermometer}", TEMPERATURE)

    def acceleration(self, accelerometer: str) -> Topic:
        """Return the topic of an accelerometer of a beam."""
        return Topic(f"{self._namespace}/{ACCELERATION_TOPIC}/{accelerometer}", IMU)


class SimulatedMessages:
    """Serialises the results of an ``ArmSimulation``; ``n`` is the index of a tick in them."""

    def __init__(self, types: MessageTypes, simulation: ArmSimulation) -> None:
        """Take the names of topics and frames from the arm."""
        self.topics = SimulatedTopics(simulation.arm.namespace)
        self._types = types
        self._base = simulation.chain.base_frame
        self._endpoint = simulation.arm.endpoint_frame
        self._receiving = {joint.name: joint.parent for joint in simulation.chain.joints}

    def raw_scan(self, joint: str, scans: SimulatedScans, n: int) -> SourceMessage:
        """Return a scan of a joint."""
        scan, status = scans.scans[n], int(scans.statuses[n])
        message = raw_scan(self._types, scan.stamp_ns, self._receiving[joint], status=status, **scan_fields(scan))
        return self._serialize(Topic(RAW_TOPIC, RAW_SCAN), scan.stamp_ns, message)

    def joint_truth(self, joint: str, stamp_ns: int, truth: ArmTruth, n: int) -> SourceMessage:
        """Return a joint's true ``T_parent_child``."""
        pose = truth.T_parent_child[joint][n]
        return self.pose(self.topics.joint_truth(joint), stamp_ns, self._receiving[joint], pose)

    def arm_truth(self, stamp_ns: int, truth: ArmTruth, n: int) -> list[SourceMessage]:
        """Return the messages about the whole arm: true endpoint, commanded endpoint, encoders."""
        empty = np.empty(0)
        encoders = self._types.new(
            JOINT_STATE,
            header=header(self._types, stamp_ns, ""),
            name=list(truth.joints),
            position=truth.encoder[n],
            velocity=empty,
            effort=empty,
        )
        return [
            self.pose(self.topics.endpoint, stamp_ns, self._base, truth.endpoint[n]),
            self.pose(self.topics.target, stamp_ns, self._base, truth.target[n]),
            self._serialize(self.topics.encoders, stamp_ns, encoders),
        ]

    def stage_position(self, stamp_ns: int, position: FloatArray) -> SourceMessage:
        """Return the position of the stage, (3,) [m], axes of the endpoint."""
        x, y, z = position.tolist()
        vector = self._types.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        message = self._types.new(VECTOR_STAMPED, header=header(self._types, stamp_ns, self._endpoint), vector=vector)
        return self._serialize(self.topics.stage, stamp_ns, message)

    def temperature(self, name: str, stamp_ns: int, kelvin: float, uncertainty: float) -> SourceMessage:
        """Return a reading of a thermometer and its standard uncertainty [K]."""
        message = temperature(self._types, stamp_ns, name, kelvin, uncertainty)
        return self._serialize(self.topics.temperature(name), stamp_ns, message)

    def acceleration(self, name: str, stamp_ns: int, reading: FloatArray, uncertainty: float) -> SourceMessage:
        """Return a reading of an accelerometer, (3,), and its standard uncertainty [m/s^2]."""
        new, unknown = self._types.new, np.array([-1.0, *np.zeros(8)])
        zero = new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        x, y, z = reading.tolist()
        message = new(
            IMU,
            header=header(self._types, stamp_ns, name),
            orientation=new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=unknown,
            angular_velocity=zero,
            angular_velocity_covariance=unknown,
            linear_acceleration=new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            linear_acceleration_covariance=np.ravel(uncertainty**2 * np.eye(3)),
        )
        return self._serialize(self.topics.acceleration(name), stamp_ns, message)

    def pose(self, topic: Topic, stamp_ns: int, frame: str, pose: pin.SE3) -> SourceMessage:
        """Return a pose in a frame (geometry_msgs/PoseStamped), on any topic."""
        return self._serialize(topic, stamp_ns, pose_stamped(self._types, stamp_ns, frame, pose))

    def _serialize(self, topic: Topic, stamp_ns: int, message: Any) -> SourceMessage:
        return SourceMessage(topic.name, stamp_ns, self._types.serialize(message, topic.type_name))
