"""One topic that is being recorded: takes its messages as they came over the wire, and notices lost ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.ros.message_types import message_class
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import ReliabilityPolicy

from posor_drivers.offered_qos import request_for

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rclpy.node import Node
    from rclpy.qos import QoSProfile

DEPTH = 5000
"""Messages that a subscription holds while this process is kept from taking them: five seconds at 1 kHz, and as many as
Fast DDS holds whatever the depth."""


class RecordedTopic:
    """A subscription from which messages are taken directly, a hundred at a time, rather than by callbacks.

    That costs a tenth of the processor time, and gives each message's time of reception and sequence number. (The
    middleware's own "message lost" event is no way to count losses: in rmw_fastrtps, taking it while messages are
    being lost locks up the process.)

    Attributes:
        received: Messages taken so far.
        lost: Messages known to be lost: gaps in the sequence numbers of a topic that has one publisher.

    """

    def __init__(self, node: Node, name: str, type_name: str, offers: Sequence[QoSProfile]) -> None:
        """Subscribe on ``node``, which no executor may spin, with the strictest profile that all ``offers`` satisfy."""
        self.name = name
        self.received = 0
        self.lost = 0
        self._request = request_for(offers, DEPTH)
        self._last_number: int | None = None
        self._subscription = node.create_subscription(
            message_class(type_name),
            name,
            _never_called,
            self._request,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    @property
    def matched(self) -> bool:
        """Whether a publisher is connected."""
        return self._subscription.get_publisher_count() > 0

    def refuses(self, offer: QoSProfile) -> bool:
        """Return whether the messages of a publisher with this profile cannot come, since others set the request."""
        reliable = ReliabilityPolicy.RELIABLE
        return bool(self._request.reliability == reliable and offer.reliability != reliable)

    def take(self) -> Iterator[tuple[int, bytes]]:
        """Yield time of reception [ns] and bytes of all messages that are there."""
        several = self._subscription.get_publisher_count() > 1
        handle, type_, raw = self._subscription.handle, self._subscription.msg_type, self._subscription.raw
        with handle:
            while (taken := handle.take_message(type_, raw)) is not None:
                data, info = taken
                self._count(info["publication_sequence_number"], several=several)
                yield info["received_timestamp"], data

    def _count(self, number: Any, *, several: bool) -> None:
        self.received += 1
        if several or not isinstance(number, int):
            self._last_number = None
            return
        if self._last_number is not None and number > self._last_number + 1:
            self.lost += number - self._last_number - 1
        self._last_number = number


def _never_called(_data: bytes) -> None:
    """Stand where rclpy wants a callback."""
