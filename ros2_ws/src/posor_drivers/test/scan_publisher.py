# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes scans of five joints at a rate, as fast drivers do; a program that tests start.

``scan_publisher.py TICKS RATE`` waits for a subscription to each topic, publishes TICKS scans of each joint at
RATE [Hz], waits until all have been received, and prints a line.
"""

from __future__ import annotations

import sys
import time

import rclpy
from posor.numerics.stamps import NS
from posor_msgs.msg import RawScan
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy

JOINTS = 5
QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


def flood(ticks: int, rate: float) -> None:
    rclpy.init()
    node = rclpy.create_node("flood", enable_rosout=False)
    publishers = [node.create_publisher(RawScan, f"/joint{joint}/raw", QOS) for joint in range(1, JOINTS + 1)]
    while any(publisher.get_subscription_count() < 1 for publisher in publishers):
        time.sleep(0.01)
    scan = RawScan(gap_voltages=[0.1, 0.2, 0.3], diode_currents=[5e-5] * 8, lit_sources=[0, 1], samples=1)
    scan.header.frame_id = "posor_receiving"
    begin = time.monotonic()
    for tick in range(ticks):
        scan.scan = tick
        scan.header.stamp.sec, scan.header.stamp.nanosec = divmod(round(tick * 1e9 / rate), NS)
        for publisher in publishers:
            publisher.publish(scan)
        time.sleep(max(0.0, begin + (tick + 1) / rate - time.monotonic()))
    received = all(publisher.wait_for_all_acked(Duration(seconds=60)) for publisher in publishers)
    print("all received" if received else "not all received", flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    flood(int(sys.argv[1]), float(sys.argv[2]))
