# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A lifecycle node that does nothing, with numpy and the topics of a ``posor_node``: the least that a start costs."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import rclpy
from posor_msgs.msg import JointTransform, RawScan
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import qos_profile_sensor_data


def _receive(scan: RawScan) -> None:
    np.asarray(scan.gap_voltages)


def main() -> None:
    """Activate the node, print that it is ready, and wait for a signal."""
    rclpy.init()
    node = LifecycleNode("empty_node")
    node.create_subscription(RawScan, "raw", _receive, qos_profile_sensor_data)
    node.create_publisher(JointTransform, "transform", qos_profile_sensor_data)
    node.trigger_configure()
    node.trigger_activate()
    print("ready", flush=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
