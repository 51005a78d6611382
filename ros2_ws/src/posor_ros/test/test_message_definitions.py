# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from posor.errors import BagError
from posor.messages.message_definitions import MessageTypes
from posor_ros.message_classes import message_class
from rclpy.serialization import deserialize_message
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

TYPES = [
    "posor_msgs/msg/RawScan",
    "posor_msgs/msg/JointTransform",
    "posor_msgs/msg/EndpointState",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/ParameterEvent",
    "lifecycle_msgs/msg/TransitionEvent",
]


@pytest.mark.parametrize("name", TYPES)
def test_type_hash_is_that_of_the_installed_package(name: str) -> None:
    package, _, leaf = name.split("/")
    installed = json.loads((Path(get_package_share_directory(package)) / "msg" / f"{leaf}.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in installed["type_hashes"]}
    assert MessageTypes().definition(name).type_hash == hashes[name]


@pytest.mark.parametrize("name", TYPES)
def test_definition_is_complete(name: str) -> None:
    definition = MessageTypes().definition(name)
    store = Typestore()
    store.register(get_types_from_msg(definition.text, name))
    assert store.hash_rihs01(name) == definition.type_hash


def test_ros_deserialises_the_bytes() -> None:
    types = MessageTypes()
    stamp = types.new("builtin_interfaces/msg/Time", sec=3, nanosec=4)
    header = types.new("std_msgs/msg/Header", stamp=stamp, frame_id="machining_centre")
    point = types.new("geometry_msgs/msg/Point", x=1.0, y=2.0, z=float("inf"))
    content = types.new("geometry_msgs/msg/PointStamped", header=header, point=point)
    read = deserialize_message(types.serialize(content, "geometry_msgs/msg/PointStamped"), PointStamped)
    assert (read.header.stamp.sec, read.header.stamp.nanosec, read.header.frame_id) == (3, 4, "machining_centre")
    assert (read.point.x, read.point.y, read.point.z) == (1.0, 2.0, float("inf"))


@pytest.mark.parametrize("name", ["nobody_msgs/msg/Thing", "std_msgs/msg/Nothing", "odd", "", "../msg/x"])
def test_an_unknown_type_is_refused(name: str) -> None:
    with pytest.raises(BagError, match=f"^message type {name} is unknown; expected "):
        MessageTypes().definition(name)


def test_class_of_a_type() -> None:
    assert message_class("diagnostic_msgs/msg/DiagnosticArray") is DiagnosticArray
    with pytest.raises(BagError, match="has no Python class"):
        message_class("nobody_msgs/msg/Thing")
