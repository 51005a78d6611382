# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of all topics; their names are in ``posor.ros_names``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from posor.node_parameters import NodeParameters

RELIABLE_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Default of publishers, and of subscriptions to other than sensor topics."""
SENSOR_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)  # for subscriptions to sensor topics
KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For all topics of nodes with ``lossless``."""
TF_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)  # for /tf, as the broadcasters of tf2
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For constant messages that late subscribers need: /tf_static, the robot description."""


def input_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of subscriptions to scans, transforms and encoders.

    The default is best effort with a small depth, as REP-2003 recommends: a servo needs the newest scan, not all of
    them. With ``lossless`` it is reliable and keeps all, so that publishers that keep all wait for it. It requests no
    deadline and no liveliness: other publishers offer none, and their events block the executor (rmw_fastrtps 8.4.3).
    """
    return KEEP_ALL_QOS if parameters.lossless else SENSOR_QOS


def result_qos(parameters: NodeParameters) -> QoSProfile:
    """Return the profile of publishers: reliable; with ``lossless``, a publisher waits for slow subscriptions."""
    return KEEP_ALL_QOS if parameters.lossless else RELIABLE_QOS
