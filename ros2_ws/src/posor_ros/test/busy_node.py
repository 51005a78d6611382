# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A node that tests start as a program: 12 publishers and 6 subscriptions at 500 Hz, whose messages cross DDS.

It prints a line each second with the number of messages that each subscription has received since the line before.
"""

from __future__ import annotations

import sys
from functools import partial

from posor.node_parameters import NodeParameters
from posor_msgs.msg import RawScan
from posor_ros.lifecycle_node import PosorNode
from posor_ros.node_program import run_node
from posor_ros.qos import RELIABLE_QOS, SENSOR_QOS

PUBLISHERS, SUBSCRIPTIONS, PERIOD_S = 12, 6, 0.002


class BusyNode(PosorNode[NodeParameters]):
    """Many topics in one process, with the quality of service of the product's nodes."""

    NAME = "busy"
    Parameters = NodeParameters

    def configure(self) -> None:
        self.second, self.counts = 0, [0] * SUBSCRIPTIONS
        self.outputs = [self.create_publisher(RawScan, f"raw_{n}", RELIABLE_QOS) for n in range(PUBLISHERS)]
        for n in range(SUBSCRIPTIONS):
            self.create_subscription(RawScan, f"raw_{n}", partial(self.on_raw_scan, n), SENSOR_QOS)
        self.create_timer(PERIOD_S, self.publish)
        self.create_timer(1.0, self.report)

    def publish(self) -> None:
        for output in self.outputs:
            output.publish(RawScan())

    def on_raw_scan(self, topic: int, _scan: RawScan) -> None:
        self.counts[topic] += 1

    def report(self) -> None:
        self.second += 1
        print(f"second {self.second}:", *self.counts, flush=True)
        self.counts = [0] * SUBSCRIPTIONS


if __name__ == "__main__":
    sys.exit(run_node(BusyNode))
