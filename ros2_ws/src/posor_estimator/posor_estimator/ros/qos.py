"""Quality of service of all topics; their names are in ``posor_estimator.ros_names``."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from posor_estimator.node_parameters import NodeParameters

LEASE_S = 1.0
"""Time after which the publishers of a process that was killed count as dead, where a deadline is set."""

STATE_DEADLINE_S = 0.3
"""Shortest deadline that the endpoint's state offers: silence is found after 0.2 to 0.28 s, and then named."""

RELIABLE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics except sensor topics."""

KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics except sensor topics in a replay without loss."""

TF_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""For /tf, as the broadcasters of tf2."""

LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what does not change and late subscribers need: /tf_static, the robot description."""


def sensor_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of the sensor topics (raw scans, transforms) that the node's parameters select.

    The default is best effort with a small depth: a servo needs the newest scan, not all of them. Reliable with depth 0
    (keep all) at both ends makes a fast publisher wait for a slow subscription, so that a replay loses nothing. With a
    deadline, publishers offer and subscriptions request it, and liveliness too: the ends match only if both have it.
    """
    reliable = parameters.qos_reliability == "reliable"
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST if parameters.qos_depth else HistoryPolicy.KEEP_ALL,
        depth=parameters.qos_depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )
    if parameters.freshness.deadline:
        profile.deadline = Duration(seconds=parameters.freshness.deadline)
        profile.liveliness = LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(seconds=LEASE_S)
    return profile


def result_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of results computed from sensor data: reliable, and keep-all where the sensor topics are."""
    return RELIABLE_QOS if parameters.qos_depth else KEEP_ALL_QOS


def state_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of the endpoint's state: as the results, and a deadline if the sensor topics have one.

    Silence of slow scans is found after ten periods at the earliest.
    """
    profile = copy(result_qos(parameters))
    if parameters.freshness.deadline:
        profile.deadline = Duration(seconds=max(10.0 * parameters.freshness.deadline, STATE_DEADLINE_S))
    return profile
