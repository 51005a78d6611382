# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrivals of frames that hardware triggers: they show triggers that the device has lost, or counted without need.

A device that loses a trigger numbers all further frames one too low, so the clock line gives them the time of the tick
before their own. No comparison within a period can show this, but the arrivals can: a frame that has arrived before the
next tick was not triggered by that tick, and no trigger was lost until then. Delays are not negative, so a frame that
arrives long before its tick was triggered by an earlier one: the device has counted a false trigger.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from posor_drivers.instruments.clock_mapping import ClockLine

MOST_ARRIVALS = 2048
"""Arrivals that are kept; each is that of the frames of one read."""
FALSE_TRIGGER = 0.5
"""Periods before its tick at which a frame shows a false trigger."""


class _Arrival(NamedTuple):
    number: int  # of the newest frame that arrived
    arrived_ns: int  # without the stated delay


class TriggerArrivals:
    """Compares the arrivals of triggered frames with their ticks."""

    def __init__(self, tolerance_s: float) -> None:
        """Start without arrivals; a frame is at most ``tolerance_s`` from its tick."""
        self._tolerance_ns = tolerance_s * NS
        self._arrivals: deque[_Arrival] = deque(maxlen=MOST_ARRIVALS)

    def add(self, number: int, arrived_ns: int) -> None:
        """Add the arrival of a frame at a ROS time [ns]; of frames that arrived together the newest one suffices."""
        self._arrivals.append(_Arrival(number, arrived_ns))

    def false_trigger(self, line: ClockLine) -> float:
        """Return how long before its tick the newest frame has arrived [s], if a false trigger was counted; else 0."""
        early_ns = -self._late_ns(self._arrivals[-1], line)
        return early_ns / NS if early_ns > FALSE_TRIGGER * line.period_ns else 0.0

    def periods_off(self, number: int, line: ClockLine) -> int:
        """Return by how many periods a frame may be off its tick: no arrival since that of the frame shows less."""
        least_ns = math.inf
        for arrival in reversed(self._arrivals):
            if arrival.number < number:
                break
            least_ns = min(least_ns, self._late_ns(arrival, line))
        late_ns = least_ns + self._tolerance_ns
        return abs(math.floor(late_ns / line.period_ns)) if math.isfinite(late_ns) else 0

    @staticmethod
    def _late_ns(arrival: _Arrival, line: ClockLine) -> float:
        """Return the time from the tick of a frame to its arrival [ns]."""
        return arrival.arrived_ns - line.start_ns - (arrival.number - line.first) * line.period_ns
