# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of programs that take messages in batches, without an executor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.event_handler import SubscriptionEventCallbacks

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.node import Node
    from rclpy.qos import QoSProfile


class PolledSubscription:
    """Messages of a topic as bytes; no executor may spin the node."""

    def __init__(self, node: Node, message_type: type[Any], topic: str, qos: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._end = node.create_subscription(message_type, topic, lambda _: None, qos, raw=True, event_callbacks=events)

    @property
    def publishers(self) -> int:
        """Number of publishers that are connected."""
        return int(self._end.get_publisher_count())

    def take(self) -> Iterator[tuple[bytes, dict[str, Any]]]:
        """Yield all messages that have arrived, each with what the middleware says of it."""
        handle, type_, raw = self._end.handle, self._end.msg_type, self._end.raw
        with handle:
            while (message := handle.take_message(type_, raw)) is not None:
                yield message
