# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Collects the messages of a tick that a group of subscriptions receives over DDS one by one.

A group takes less time for all scans of a tick together than for each by itself. So messages wait until each
subscription has one of the same stamp. The wait also ends with a message of the next tick, and with a check of the
inputs. Messages only wait while nearly all of the last ticks ended within ``MAX_TICK_S``: a joint that is late or gone
delays the others by no more than this, but for a few ticks.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from posor.messages.cdr_schema import STAMP

from posor_ros.delivery_round import DeliveryRound, receive_in_round

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_ros.delivery_round import GroupMember

MAX_TICK_S = 1e-3  # least length of a long tick: from its first message to its last, or to the next tick
JUDGED_TICKS, MIN_SHORT_TICKS = 20, 18  # of so many last ticks, so many must have been short


class ArrivalCollector:
    """The present tick of one group of subscriptions to stamped messages, in the executor's thread.

    Attributes:
        members: The subscriptions of the group that receive over DDS.

    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """``clock``: steady time [s]."""
        self.members: set[GroupMember] = set()
        self._clock = clock
        self._ticks = deque([True] * JUDGED_TICKS, JUDGED_TICKS)  # whether each was short
        self._waits = True
        self._stamp = b""
        self._begin_s = 0.0
        self._arrived: set[GroupMember] = set()
        self._waiting: dict[GroupMember, bytes] = {}

    def add(self, subscription: GroupMember, data: bytes) -> None:
        """Deliver a message that has arrived, at once or with the rest of its tick."""
        stamp = data[STAMP]
        if self._arrived and (stamp != self._stamp or subscription in self._arrived):
            self._end_tick()
        if not self._arrived:
            self._stamp, self._begin_s = stamp, self._clock()
        self._arrived.add(subscription)
        self._waiting[subscription] = data
        if self.members <= self._arrived:
            self._end_tick()
        elif not self._waits:
            self._deliver()

    def remove(self, subscription: GroupMember) -> None:
        """Expect nothing more of a subscription, and drop its message that waits: it has another publisher, or none."""
        self.members.discard(subscription)
        self._waiting.pop(subscription, None)

    def check(self) -> None:
        """Deliver what waits for a message that does not come."""
        if self._waiting and self._clock() - self._begin_s > MAX_TICK_S:
            self._end_tick()

    def _end_tick(self) -> None:
        self._arrived.clear()
        self._ticks.append(self._clock() - self._begin_s < MAX_TICK_S)
        self._waits = sum(self._ticks) >= MIN_SHORT_TICKS
        self._deliver()

    def _deliver(self) -> None:
        """Deliver what waits, in one round. The time that this takes is no part of the tick's length."""
        waiting, self._waiting = self._waiting, {}
        begin_s = self._clock()
        with DeliveryRound():
            for subscription, data in waiting.items():
                receive_in_round(subscription, data)
        self._begin_s += self._clock() - begin_s
