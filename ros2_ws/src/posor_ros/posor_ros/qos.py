"""Quality of service of all topics; their names are in ``posor.ros_names``."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from posor.node_parameters import NodeParameters

LEASE_S = 1.0  # time after which the publishers of a process that was killed count as dead, where a deadline is set
STATE_DEADLINE_S = 0.3
"""Shortest deadline that the endpoint's state offers: silence is found after 0.2 to 0.28 s, and then named."""
RELIABLE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Default of publishers, and of subscriptions to other than sensor topics."""
SENSOR_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)  # for subscriptions to sensor topics
KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics of nodes with ``lossless``."""
TF_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)  # for /tf, as the broadcasters of tf2
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For constant messages that late subscribers need: /tf_static, the robot description."""


def sensor_publisher_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of a publisher of a sensor topic (raw scans, transforms): as for results, with a deadline.

    The publisher serves reliable and best-effort subscriptions.
    """
    return _with_deadline(result_qos(parameters), parameters)


def sensor_subscription_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of a subscription to a sensor topic: as for other inputs, with its publisher's deadline."""
    return _with_deadline(input_qos(parameters), parameters)


def input_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of a subscription to a topic of other publishers, for example encoders.

    The default is best effort with a small depth, as REP-2003 recommends: a servo needs the newest scan, not all of
    them. With ``lossless`` it is reliable and keeps all, so that publishers that keep all wait for it. The profile
    has no deadline: other publishers offer none, and would not match.
    """
    return KEEP_ALL_QOS if parameters.lossless else SENSOR_QOS


def _with_deadline(profile: QoSProfile, parameters: NodeParameters) -> QoSProfile:
    """Return a profile with the node's deadline, if any, and liveliness: the ends match only if both have them."""
    profile = copy(profile)
    if parameters.freshness.deadline:
        profile.deadline = Duration(seconds=parameters.freshness.deadline)
        profile.liveliness = LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(seconds=LEASE_S)
    return profile


def result_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of results: reliable; with ``lossless``, a publisher waits for slow subscriptions."""
    return KEEP_ALL_QOS if parameters.lossless else RELIABLE_QOS


def state_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of the endpoint's state: as the results, and a deadline if the sensor topics have one.

    Silence of slow scans is found after ten periods at the earliest.
    """
    profile = copy(result_qos(parameters))
    if parameters.freshness.deadline:
        profile.deadline = Duration(seconds=max(10.0 * parameters.freshness.deadline, STATE_DEADLINE_S))
    return profile
