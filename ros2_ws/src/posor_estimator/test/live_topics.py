# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages with present stamps for tests of freshness, and their publisher."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from posor.messages.raw_scan import ScanTemplate
from posor_lab.harness.graph import LOSSLESS, Graph
from posor_msgs.msg import RawScan
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import Reader

BRINGUP = Path(__file__).resolve().parents[2] / "posor_bringup"
POSOR = {"calibration": str(BRINGUP / "config" / "slocum1985_printed.yaml"), "session": "ymo"}
PERIOD_S = 0.02


def first_scan() -> ScanTemplate:
    """Return the first scan of test YMO."""
    with Reader(BRINGUP / "bags" / "ymo") as reader:
        [connection] = [each for each in reader.connections if each.msgtype == "posor_msgs/msg/RawScan"]
        return ScanTemplate(bytes(next(iter(reader.messages([connection])))[2]))


class ScanSender:
    """Publishes the first scan of test YMO again and again."""

    def __init__(self, graph: Graph, topic: str = "raw", qos: QoSProfile = LOSSLESS) -> None:
        self.graph, self.number, self.template = graph, 0, first_scan()
        self.publisher: Any = graph.publisher(RawScan, topic, qos)

    def send(self, age_s: float = 0.0, number: int | None = None) -> int:
        """Publish a scan with a stamp of this age; return the stamp [ns]."""
        self.number = self.number + 1 if number is None else number
        stamp_ns = time.time_ns() - round(age_s * 1e9)
        self.publisher.publish(self.template.at(stamp_ns, self.number))
        return stamp_ns

    def send_for(self, seconds: float) -> None:
        """Publish at a steady rate for a time."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.graph.receive()
            self.send_later()

    def send_later(self) -> None:
        """Publish after a period."""
        time.sleep(PERIOD_S)
        self.send()
