# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrivals of triggered frames: they show triggers that the device has lost, and false triggers that it has counted.

A device that loses a trigger numbers all further frames one too low, so the clock line gives them the time of the tick
before their own. No comparison within a period can show this, but the arrivals can: a frame that has arrived before the
next tick was not triggered by that tick, and no trigger was lost until then. Delays are not negative, so a frame that
arrives long before its tick was triggered by an earlier one: the device has counted a false trigger.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import takewhile
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from posor_drivers.instruments.clock_mapping import ClockLine
    from posor_drivers.instruments.device import Device

MOST_ARRIVALS = 2048
"""Arrivals that are kept; each is that of the frames of one read."""
FALSE_TRIGGER = 0.5
"""Periods before its tick at which a frame shows a false trigger."""


class TriggeredFrame(NamedTuple):
    """What is known of a frame and its tick."""

    shift_s: float  # by which it may be off its tick by lost triggers [s]
    fault: str  # empty: none
    is_usable: bool = True


class _Arrival(NamedTuple):
    number: int  # of the newest frame that arrived
    arrived_ns: int  # without the stated delay


class TriggerArrivals:
    """Compares the arrivals of triggered frames with their ticks."""

    def __init__(self, device: Device[Any], tolerance_s: float) -> None:
        """Start without arrivals; a frame is at most ``tolerance_s`` from its tick."""
        self._device, self._tolerance_s = device, tolerance_s
        self._arrivals: deque[_Arrival] = deque(maxlen=MOST_ARRIVALS)

    def add(self, number: int, arrived_ns: int) -> None:
        """Add the arrival of a frame at a ROS time [ns]; of frames that arrived together the newest one suffices."""
        self._arrivals.append(_Arrival(number, arrived_ns))

    def check(self, number: int, offset_s: float, line: ClockLine | None) -> TriggeredFrame:
        """Return whether a stored frame is that of its tick.

        Args:
            number: Of the frame.
            offset_s: Time of the tick after that of the frame [s].
            line: That of the device; None: its frames have times of their own, which show lost triggers.

        """
        if abs(offset_s) > self._tolerance_s:
            what = f"frame {number} is {-1e3 * offset_s:+.3g} ms from its tick"
            expected = f"at most {1e3 * self._tolerance_s:g} ms, as it is triggered"
            return TriggeredFrame(0.0, str(self._device.error(what, expected)), is_usable=False)
        periods = 0 if line is None else self.lost_periods(number, line)
        if line is None or not periods:
            return TriggeredFrame(0.0, "")
        shift_s = abs(periods) * line.period_ns / NS
        if periods < 0:
            what = f"an arrival since frame {number} is before its tick"
        else:
            what = f"every arrival since frame {number} is {'a period' if periods == 1 else f'{periods} periods'} late"
        what = f"{what}: the frame may be {1e3 * shift_s:.3g} ms off its tick"
        expected = "an arrival between its tick and the next one; a trigger may be lost, or latency too short"
        return TriggeredFrame(shift_s, str(self._device.error(what, expected)))

    def early_by_s(self, line: ClockLine) -> float:
        """Return how long before its tick the newest frame has arrived [s], if a false trigger was counted; else 0."""
        early_ns = -self._late_ns(self._arrivals[-1], line)
        return early_ns / NS if early_ns > FALSE_TRIGGER * line.period_ns else 0.0

    def lost_periods(self, number: int, line: ClockLine) -> int:
        """Return by how many periods a stored frame may be off its tick: no arrival since that of the frame shows less.

        Negative: an arrival was before its tick. The frame has arrived, so there is an arrival of it or of a later one.
        A lost trigger is not seen where a false one follows before the frame is used: the numbers, and the arrivals
        since, are then right again.
        """
        since = takewhile(lambda arrival: arrival.number >= number, reversed(self._arrivals))
        least_ns = min(self._late_ns(arrival, line) for arrival in since)
        return math.floor((least_ns + self._tolerance_s * NS) / line.period_ns)

    @staticmethod
    def _late_ns(arrival: _Arrival, line: ClockLine) -> float:
        """Return the time from the tick of a frame to its arrival [ns]."""
        return arrival.arrived_ns - line.start_ns - (arrival.number - line.first) * line.period_ns
