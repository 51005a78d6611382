"""Tells in the diagnostics who listens to a node: how many listeners each of its topics has, in any process.

A publisher of the default (volatile) durability sends only to subscriptions it has matched, and no ROS call tells
another program whether it has. Whoever starts a graph can wait for these reports and so lose nothing of a replay.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.wire import Outlet

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

    from posor_estimator.ros.node import PosorNode

STATUS = "listeners"
"""Name of the status line; its values are the number of listeners by topic."""


class Listeners:
    """Makes the outlets of a node and reports their listeners, at once when one comes or goes."""

    def __init__(self, node: PosorNode[Any]) -> None:
        """Add the status line to the node's diagnostics."""
        self._node = node
        self._status = node.diagnostics.add(STATUS)
        self._counts: dict[str, int] = {}

    def outlet(self, message_type: type[Any], topic: str, qos: QoSProfile) -> Outlet:
        """Return a new outlet of the node."""
        self._counts[topic] = 0
        self._report()
        return Outlet(self._node, message_type, topic, qos, on_count=partial(self._count, topic))

    def _count(self, topic: str, count: int) -> None:
        self._counts[topic] = count
        self._report()

    def _report(self) -> None:
        counts = ", ".join(f"{topic} {count}" for topic, count in self._counts.items())
        self._status.report(Level.OK, f"subscriptions: {counts}", self._counts)
