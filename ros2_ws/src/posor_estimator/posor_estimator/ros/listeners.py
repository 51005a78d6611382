"""Tells in the diagnostics who listens to a node: how many subscriptions each of its topics has.

A publisher of the default (volatile) durability sends only to subscriptions it has matched, and no ROS call tells
another program whether it has. Whoever starts a graph can wait for these reports and so lose nothing of a replay.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks

from posor_estimator.ros.diagnostics import Level

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

    from posor_estimator.ros.node import PosorNode

STATUS = "listeners"
"""Name of the status line; its values are the number of subscriptions by topic."""


class Listeners:
    """Makes the publishers of a node and reports their listeners, at once when one comes or goes."""

    def __init__(self, node: PosorNode[Any]) -> None:
        """Add the status line to the node's diagnostics."""
        self._node = node
        self._status = node.diagnostics.add(STATUS)
        self._counts: dict[str, int] = {}

    def publisher(self, message_type: type[Any], topic: str, qos: QoSProfile) -> Any:
        """Return a new lifecycle publisher of the node."""
        matched = PublisherEventCallbacks(matched=partial(self._match, topic))
        self._counts[topic] = 0
        self._report()
        return self._node.create_lifecycle_publisher(message_type, topic, qos, event_callbacks=matched)

    def _match(self, topic: str, event: Any) -> None:
        self._counts[topic] = event.current_count
        self._report()

    def _report(self) -> None:
        counts = ", ".join(f"{topic} {count}" for topic, count in self._counts.items())
        self._status.report(Level.OK, f"subscriptions: {counts}", self._counts)
