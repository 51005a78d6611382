# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Collects the messages of a tick that a group of subscriptions receives over DDS one by one.

A group takes less time for all scans of a tick together than for each by itself. So messages wait until each
subscription has one of the same stamp, or one of the next tick or a check of the inputs comes. They only wait while
most of the last ticks ended within ``MAX_TICK_S``, so that a joint that is gone or late does not delay the others.
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

MAX_TICK_S = 1e-3  # from the first message of a short tick to its last one or the first one of the next tick
JUDGED_TICKS, SHORT_TICKS = 20, 18  # of so many last ticks, so many must have been short


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
        stamp, now_s = data[STAMP], self._clock()
        if self._arrived and (stamp != self._stamp or subscription in self._arrived):
            self._end_tick(now_s)
        if not self._arrived:
            self._stamp, self._begin_s = stamp, now_s
        self._arrived.add(subscription)
        self._waiting[subscription] = data
        if self.members <= self._arrived:
            self._end_tick(now_s)
        elif not self._waits:
            self._deliver()

    def check(self) -> None:
        """Deliver what waits for a message that does not come."""
        now_s = self._clock()
        if self._waiting and now_s - self._begin_s > MAX_TICK_S:
            self._end_tick(now_s)

    def _end_tick(self, now_s: float) -> None:
        self._arrived.clear()
        self._ticks.append(now_s - self._begin_s < MAX_TICK_S)
        self._waits = sum(self._ticks) >= SHORT_TICKS
        self._deliver()

    def _deliver(self) -> None:
        """Deliver what waits, in one round."""
        waiting, self._waiting = self._waiting, {}
        with DeliveryRound():
            for subscription, data in waiting.items():
                receive_in_round(subscription, data)
