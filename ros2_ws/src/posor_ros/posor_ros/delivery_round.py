# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Delivery rounds: what groups of subscriptions are sent in a tick they receive at its end, in one call.

So the scans of all joints of an arm are handled together. What arrives over DDS has a round for the messages of a tick,
see ``arrival_collector``; any other message outside of a round has a round of its own, by the same code.
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
    """Called in a round by nodes of the same lock that would publish to the group, with what they have in memory.

    Returns a function that does their work and its own, and returns whether it has; None: the group needs messages."""


class _Held(local):
    """Messages that are held until the end of this thread's round; None: there is no round.

    They are in parts, each with at most one message of each subscription, in order.
    """

    parts: list[dict[GroupMember, bytes]] | None = None
    afterwards: tuple[Callable[[], object], ...] = ()
    """What runs after the round."""


_held = _Held()


class DeliveryRound:
    """A ``with`` block of one thread; messages for groups are held until its end. A block inside another does nothing.

    What a group publishes while it receives is delivered before the next group receives.
    """

    def __enter__(self) -> None:
        self._is_inner = _held.parts is not None
        if not self._is_inner:
            _held.parts = []

    def __exit__(self, *_: object) -> None:
        if not self._is_inner:
            try:
                _deliver_held_messages()
            finally:
                _held.parts = None
                afterwards, _held.afterwards = _held.afterwards, ()
            for work in afterwards:
                work()


def run_after_round(work: Callable[[], object]) -> None:
    """Run something after this thread's round, so that no message waits for it; at once where there is no round."""
    if _held.parts is None:
        work()
    else:
        _held.afterwards += (work,)


def receive_in_round(subscription: GroupMember, data: bytes) -> None:
    """Hold a message for a subscription of a group until the end of this thread's round, or of one of its own.

    So what other nodes publish because of the message waits until the group has received it.
    """
    parts = _held.parts
    if parts is None:
        with DeliveryRound():
            receive_in_round(subscription, data)
        return
    if not parts or subscription in parts[-1]:
        parts.append({})
    parts[-1][subscription] = data


def _deliver_held_messages() -> None:
    """Deliver all messages that this thread holds, part by part and group by group."""
    parts, _held.parts = _held.parts or [], []
    for part in parts:
        groups: dict[DeliveryGroup, list[Delivery]] = {}
        now_s = time.monotonic()
        for delivery in part.items():
            subscription = delivery[0]
            if subscription.group is not None and not subscription.closed:
                subscription.watch.record(now_s)
                groups.setdefault(subscription.group, []).append(delivery)
        for group, deliveries in groups.items():
            _deliver(group, deliveries)


def _deliver(group: DeliveryGroup, deliveries: list[Delivery]) -> None:
    """Have a group receive; an error ends the program, from the main thread."""
    try:
        _receive_together(group, deliveries)
    except Exception as error:  # noqa: BLE001  all nodes of the group report it
        for subscription, _ in deliveries:
            subscription.fail(error)


def _receive_together(group: DeliveryGroup, deliveries: list[Delivery]) -> None:
    """Have a group receive, then whoever receives what it publishes."""
    with group.lock:
        afterwards = group.receive(deliveries)
        if _held.parts:
            _deliver_held_messages()
        if afterwards is not None:
            afterwards()
            if _held.parts:
                _deliver_held_messages()
