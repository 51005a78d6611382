# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Receives the endpoint's poses in its own process, as a controller: ``latency_receiver.py TOPIC FILE PRIORITY``.

The messages stay serialised. ``PRIORITY`` is that of SCHED_FIFO, 0: none. Ends on SIGINT and writes an array of
integers, (n, 4): stamp, publication, reception [ns], and the publisher's sequence number.
"""

from __future__ import annotations

import gc
import sys
from array import array
from time import time_ns
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.node_parameters import RealtimeParameters
from posor_ros.node_program import StopSignal, non_ros_arguments
from posor_ros.realtime_process import apply_realtime_parameters
from rclpy.impl.implementation_singleton import rclpy_implementation as implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

READY, FIRST_POSE = "listening", "receiving"  # printed after subscribing, and at the first pose
DEPTH = 1000
WAIT_NS = 100_000_000


def receive_poses(topic: str, priority: int, stop: StopSignal) -> array[int]:
    """Return stamp, publication, reception and number of all poses until stopped.

    The subscription is read without an executor, which would not give the publication's sequence number.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("latency_receiver", enable_rosout=False, start_parameter_services=False)
    qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
    subscription = node.create_subscription(PoseStamped, topic, _unused_callback, qos, raw=True)
    rows = array("q")
    handle: Any = subscription.handle
    context: Any = node.context.handle
    apply_realtime_parameters(RealtimeParameters(priority=priority))  # where the system grants it
    print(READY, flush=True)
    with handle, context:
        wait_set = implementation.WaitSet(1, 0, 0, 0, 0, 0, context)
        while not stop.requested:
            wait_set.clear_entities()
            wait_set.add_subscription(handle)
            wait_set.wait(WAIT_NS)
            while (taken := handle.take_message(PoseStamped, True)) is not None:  # noqa: FBT003  raw
                now_ns, (data, info) = time_ns(), taken
                if not rows:
                    print(FIRST_POSE, flush=True)
                times_ns = stamp_ns_of(data[STAMP]), info["source_timestamp"], now_ns
                rows.extend((*times_ns, info["publication_sequence_number"]))
    node.destroy_node()
    try_shutdown()
    return rows


def _unused_callback(_data: bytes) -> None:
    """No-op callback required by rclpy."""


def main() -> None:
    """Run the program."""
    topic, file, priority = non_ros_arguments(sys.argv)
    gc.disable()
    with StopSignal() as stop:
        np.save(file, np.array(receive_poses(topic, int(priority), stop), dtype=np.int64).reshape(-1, 4))


if __name__ == "__main__":
    main()
