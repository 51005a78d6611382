# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A topic for those who watch: every change, and otherwise a few messages a second of a topic at the rate of scans."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.numerics.stamps import NS

from posor_ros.intra_process import IntraProcessPublisher

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

    from posor_ros.lifecycle_node import PosorNode

PERIOD_NS = NS // 20
LEAD_NS = NS // 100  # before the end of a period, in which the next scan may be the first of another one


def may_be_due_next(stamp_ns: int, last_ns: int) -> bool:
    """Return whether the scan after this one may be due, by the stamps of this scan and of the one before it [ns]."""
    return not 0 < stamp_ns - last_ns < LEAD_NS // 2 or stamp_ns % PERIOD_NS >= PERIOD_NS - LEAD_NS


class ThrottledPublisher(IntraProcessPublisher):
    """Publishes a message with the first stamp of each ``PERIOD_NS``, so that all joints choose the same scans."""

    def __init__(self, node: PosorNode[Any], message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        """Create the publisher of a topic, see ``IntraProcessPublisher``."""
        super().__init__(node, message_type, topic, qos)
        self._slot = -1

    def is_due(self, stamp_ns: int, *, changed: bool) -> bool:
        """Return whether to publish the message of a stamp [ns]; ``changed``: it says another thing than the last."""
        return self.has_subscriptions and (changed or stamp_ns // PERIOD_NS != self._slot)

    def publish_due(self, stamp_ns: int, data: bytes) -> None:
        """Publish the message of a stamp [ns] that is due; the next one is that of another period, or a change."""
        self._slot = stamp_ns // PERIOD_NS
        self.publish(data)
