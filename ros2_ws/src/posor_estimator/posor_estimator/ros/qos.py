"""Quality of service of all topics; their names are in ``posor_estimator.ros_names``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from posor_estimator.node_parameters import NodeParameters

RELIABLE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics except sensor topics."""

KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics except sensor topics in a replay without loss."""


def sensor_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of the sensor topics (raw scans, transforms) that the node's parameters select.

    The default is best effort with a small depth: a servo needs the newest scan, not all of them. Reliable with depth 0
    (keep all) at both ends makes a fast publisher wait for a slow subscription, so that a replay loses nothing.
    """
    reliable = parameters.qos_reliability == "reliable"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST if parameters.qos_depth else HistoryPolicy.KEEP_ALL,
        depth=parameters.qos_depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def result_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of results computed from sensor data: reliable, and keep-all where the sensor topics are."""
    return RELIABLE_QOS if parameters.qos_depth else KEEP_ALL_QOS
