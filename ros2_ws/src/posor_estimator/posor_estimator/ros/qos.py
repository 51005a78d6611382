"""Topics and quality of service of the stack, told once."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from posor_estimator.ros.parameters import NodeParameters

RAW_TOPIC = "raw"
TRANSFORM_TOPIC = "transform"
ENDPOINT_TOPIC = "endpoint/pose"
ENDPOINT_COVARIANCE_TOPIC = "endpoint/pose_with_covariance"
JOINT_STATES_TOPIC = "joint_states"
DIAGNOSTICS_TOPIC = "/diagnostics"
TRUTH_TOPIC = "/truth/machining_centre"

RELIABLE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""For everything that is not sensor data."""

KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""The same in a replay without loss."""


def sensor_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of the sensor topics (raw scans, transforms) as the node's parameters ask for it.

    Best effort with a small depth unless told otherwise: a servo wants the newest scan, not all of them. Reliable with
    depth 0 (keep all) on both sides makes a fast publisher wait for a slow subscriber, so that a replay loses nothing.
    """
    keep_all = parameters.qos_depth == 0
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=parameters.qos_depth,
        reliability=ReliabilityPolicy.RELIABLE
        if parameters.qos_reliability == "reliable"
        else ReliabilityPolicy.BEST_EFFORT,
    )


def result_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of what a node makes of sensor data: reliable, keeping all where the sensor topics do."""
    return RELIABLE_QOS if parameters.qos_depth else KEEP_ALL_QOS
