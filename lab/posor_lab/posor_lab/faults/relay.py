# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A relay of raw scans between two topics: the link of a driver, which the program cuts by stopping this process.

Started by ``process_run`` as ``relay.py FROM TO``.
"""

from __future__ import annotations

import sys

from posor_msgs.msg import RawScan
from posor_ros.node_program import non_ros_arguments, ros_context, spin_until
from posor_ros.qos import RELIABLE_QOS
from rclpy.node import Node

from posor_lab.reports.arrival_receiver import QOS

if __name__ == "__main__":
    source, destination = non_ros_arguments(sys.argv)
    with ros_context(sys.argv) as stop:
        node = Node("relay")
        publisher = node.create_publisher(RawScan, destination, RELIABLE_QOS)
        node.create_subscription(RawScan, source, publisher.publish, QOS, raw=True)
        spin_until(node, lambda: stop.requested)
