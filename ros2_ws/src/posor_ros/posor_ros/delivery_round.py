# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Delivery rounds: what groups of subscriptions are sent in a tick they receive at its end, in one call.

So the scans of all joints of an arm are handled together. Outside of a round, and over DDS, a group receives each
message by itself, by the same code.
"""

from __future__ import annotations

import time
from threading import RLock, local
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_ros.input_watch import InputWatch


class GroupMember(Protocol):
    """What is used of a subscription here and by groups, see ``intra_process.IntraProcessSubscription``."""

    node: Any
    topic_name: str
    group: DeliveryGroup | None
    closed: bool
    watch: InputWatch

    def attempt(self, step: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a step of the node; None: it has raised."""

    def fail(self, error: Exception) -> None:
        """Receive nothing more, and end the program with an error."""


Delivery: TypeAlias = tuple[GroupMember, bytes]  # a message for a subscription of a group


class DeliveryGroup(NamedTuple):
    """Subscriptions of one process whose messages of a round are received in one call: those of equal groups."""

    receive: Callable[[list[Delivery]], Callable[[], None] | None]
    """Takes at most one message of each subscription. May return what it has left to do once the messages that it has
    published are delivered in this process."""
    lock: RLock
    """Held while it receives, see ``IntraProcessManager.delivery_lock``."""
    take: Callable[..., Any] | None = None
    """Takes from the nodes that publish, in their own call, what would be in the messages. Those are not delivered."""


class _Held(local):
    """Messages that are held until the end of this thread's round, in order; None: there is no round."""

    messages: dict[GroupMember, bytes] | None = None


_held = _Held()


class DeliveryRound:
    """A ``with`` block of one thread; messages for groups are held until its end.

    A second message for a subscription ends the first part of the round. What a group publishes while it receives is
    delivered before the next group receives.
    """

    def __enter__(self) -> None:
        _held.messages = {}

    def __exit__(self, *_: object) -> None:
        try:
            _deliver_held_messages()
        finally:
            _held.messages = None


def hold(subscription: GroupMember, data: bytes) -> bool:
    """Hold a message for a subscription of a group; return False outside of a round, where it is to be received."""
    held = _held.messages
    if held is None:
        return False
    if subscription in held:
        _deliver_held_messages()
        held = _held.messages = {}
    held[subscription] = data
    return True


def _deliver_held_messages() -> None:
    """Deliver all messages that this thread holds, group by group."""
    groups: dict[DeliveryGroup, list[Delivery]] = {}
    now_s = time.monotonic()
    for delivery in (_held.messages or {}).items():
        subscription = delivery[0]
        if subscription.group is not None and not subscription.closed:
            subscription.watch.record(now_s)
            groups.setdefault(subscription.group, []).append(delivery)
    for group, deliveries in groups.items():
        _held.messages = {}
        _deliver(group, deliveries)
    _held.messages = {}


def _deliver(group: DeliveryGroup, deliveries: list[Delivery]) -> None:
    """Have a group receive; an error ends the program, from the main thread."""
    try:
        receive_together(group, deliveries)
    except Exception as error:  # noqa: BLE001  all nodes of the group report it
        for subscription, _ in deliveries:
            subscription.fail(error)


def receive_together(group: DeliveryGroup, deliveries: list[Delivery]) -> None:
    """Have a group receive, then whoever receives what it publishes."""
    with group.lock:
        afterwards = group.receive(deliveries)
        if _held.messages:
            _deliver_held_messages()
        if afterwards is not None:
            afterwards()
            if _held.messages:
                _deliver_held_messages()
