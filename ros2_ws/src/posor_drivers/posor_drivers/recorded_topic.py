"""One topic that is being recorded: its serialised messages, and the count of lost ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_ros.message_classes import message_class
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rclpy.node import Node

DEPTH = 5000
"""Messages that a subscription holds while the process is busy: five seconds at 1 kHz, and the limit of Fast DDS."""


class RecordedTopic:
    """A subscription whose messages are taken directly, in batches, instead of by callbacks.

    That needs a tenth of the processor time, and provides each message's time of reception and sequence number. (The
    middleware's "message lost" event cannot be used to count losses: in rmw_fastrtps, taking it while messages are
    being lost blocks the process.)

    Attributes:
        received: Messages taken so far.
        lost: Messages known to be lost: gaps in the sequence numbers of a topic with one publisher.

    """

    def __init__(self, node: Node, name: str, type_name: str, offers: Sequence[QoSProfile]) -> None:
        """Subscribe on ``node``, which no executor may spin, with the strictest profile that all ``offers`` satisfy."""
        self.name = name
        self.received = 0
        self.lost = 0
        self._request = strictest_request(offers, DEPTH)
        self._last_number: int | None = None
        self._subscription = node.create_subscription(
            message_class(type_name),
            name,
            _no_callback,
            self._request,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    @property
    def matched(self) -> bool:
        """Whether a publisher is connected."""
        return self._subscription.get_publisher_count() > 0

    def refuses(self, offer: QoSProfile) -> bool:
        """Return whether a publisher with this profile is incompatible with the subscription."""
        reliable = ReliabilityPolicy.RELIABLE
        return bool(self._request.reliability == reliable and offer.reliability != reliable)

    def take_messages(self) -> Iterator[tuple[int, bytes]]:
        """Yield time of reception [ns] and bytes of all messages that have arrived."""
        several = self._subscription.get_publisher_count() > 1
        handle, type_, raw = self._subscription.handle, self._subscription.msg_type, self._subscription.raw
        with handle:
            while (message := handle.take_message(type_, raw)) is not None:
                data, info = message
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


def strictest_request(offers: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest profile that every offer satisfies.

    Reliable if all publishers are, because best effort would lose messages without need; best effort if one publisher
    is, because its messages would not arrive otherwise. Transient local durability likewise.
    """
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    transient = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )


def _no_callback(_data: bytes) -> None:
    """No-op callback required by rclpy."""
