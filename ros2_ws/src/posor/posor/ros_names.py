# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Names of topics and message types of the stack. This module imports no ROS."""

from __future__ import annotations

import re

RAW_TOPIC = "raw"
TRANSFORM_TOPIC = "transform"
TRANSFORM_THROTTLE_TOPIC = "transform_throttle"
ENDPOINT_TOPIC = "endpoint/pose"
ENDPOINT_STATE_TOPIC = "endpoint/state"
ENDPOINT_STATE_THROTTLE_TOPIC = "endpoint/state_throttle"
ENDPOINT_COVARIANCE_TOPIC = "endpoint/pose_with_covariance"
PREDICTED_TOPIC = "endpoint/predicted"
PREDICTED_AHEAD_TOPIC = "endpoint/predicted_ahead"
PREDICTED_STATE_TOPIC = "endpoint/predicted_state"
JOINT_STATES_TOPIC = "joint_states"
TEMPERATURE_TOPIC = "temperature"
ACCELERATION_TOPIC = "acceleration"
DIAGNOSTICS_TOPIC = "/diagnostics"
COMMISSIONING_TOPIC = "commissioning/step"
REFERENCE_TOPIC = "/reference/{name}"
TF_TOPIC = "/tf"
TF_STATIC_TOPIC = "/tf_static"
ROBOT_DESCRIPTION_TOPIC = "robot_description"
TRUTH_TOPIC = "/truth/machining_centre"

RAW_SCAN = "posor_msgs/msg/RawScan"
JOINT_TRANSFORM = "posor_msgs/msg/JointTransform"
REFERENCE_READING = "posor_msgs/msg/ReferenceReading"
ENDPOINT_STATE = "posor_msgs/msg/EndpointState"
COMMISSIONING_STEP = "posor_msgs/msg/CommissioningStep"
POINT_STAMPED = "geometry_msgs/msg/PointStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
VECTOR_STAMPED = "geometry_msgs/msg/Vector3Stamped"
JOINT_STATE = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
TEMPERATURE = "sensor_msgs/msg/Temperature"
IMU = "sensor_msgs/msg/Imu"

ROS_BOOLEAN_PARAMETERS = ("use_sim_time", "start_type_description_service")  # that rclpy declares
ROS_OWN_PARAMETERS = (*ROS_BOOLEAN_PARAMETERS, "qos_overrides.")
"""Parameters (or groups of parameters) that rclpy declares on every node."""

ROS_NAME_RULE = "a letter, then letters, digits and underscores, at most 80 characters"
"""What a part of a namespace may be: longer topics than 247 characters are refused by rmw."""


_PART = r"(?:[A-Za-z_]|\{(?:node|ns|namespace)\})(?:[A-Za-z0-9_]|\{(?:node|ns|namespace)\})*"
_TOPIC_NAME = re.compile(rf"(?:/|~/)?{_PART}(?:/{_PART})*")
TOPIC_NAME_RULE = "names separated by '/', each a letter or underscore, then letters, digits and underscores"
"""What the name of a topic may be; ROS replaces {node}, {ns} and {namespace}."""


OUTER_NAMESPACE_RULE = (
    "names separated by '/', each a letter, then letters, digits and underscores, at most 40 characters"
)
"""What the namespace around an arm may be."""


def is_ros_name(name: str) -> bool:
    """Return whether a name can be one part of a namespace or topic."""
    return re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,79}", name) is not None


def is_topic_name(name: str) -> bool:
    """Return whether a name can be that of a topic: full, or relative to a namespace."""
    return _TOPIC_NAME.fullmatch(name) is not None


def is_outer_namespace(name: str) -> bool:
    """Return whether a text, with or without a '/' at its begin and its end, can be the namespace around an arm."""
    return re.fullmatch(r"(?=.{0,40}$)/?([A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*/?)?", name) is not None
