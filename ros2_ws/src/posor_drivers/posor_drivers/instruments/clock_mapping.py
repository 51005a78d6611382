# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Mapping from the frame counter of a device to ROS time.

A device numbers its frames by a clock of its own, and each frame arrives with a delay that is never negative. The
mapping is the line below all arrivals of the last seconds that is closest to them. It minimises the sum of the delays,
and it is the maximum-likelihood line for exponential delays (Moon, Skelly and Towsley 1999, section IV). So single slow
packets have no effect, and the time of a frame is far more exact than its arrival. What cannot be seen in arrivals is
the smallest delay itself; a device states it as ``delay``.

After a step of either clock, or a pause of the device without counting, the line is wrong until most of its window is
later. Until then the uncertainty includes the least distance of the newest arrivals from the line. They are that far
from it, too, where a network delays every frame for longer than ``STEP_INTERVALS``; their times are then right.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import IntArray

WINDOW_S = 10.0
"""Time whose arrivals decide; over it the drift of the device's clock is taken to be constant."""
INTERVAL_S = 0.05
"""Of all arrivals of this time only the one with the least delay can touch the line."""
LEAST_INTERVALS, LONGEST_START_S = 20, 5.0
"""Intervals with frames before there is a line: a second, where each has a frame; of a slow device fewer, and time."""
COMPARED_INTERVALS = 8
"""Intervals before two halves of the arrivals are compared, so that the first line rests on several comparisons."""
STEP_INTERVALS = 2
"""Newest intervals that show a step: the arrivals of all of them are far from the line."""
DELAY_THRESHOLD = 4.0
"""Least delay, in medians of its change between intervals, beyond which it is part of the standard uncertainty."""
MAX_COMPARISONS = 100
"""Comparisons of two halves of the arrivals that the uncertainty rests on."""


class ClockLine(NamedTuple):
    """ROS time of a frame: ``start_ns + (number - first) * period_ns``."""

    first: int  # number of the frame at ``start_ns``
    start_ns: int  # its time [ns]
    period_ns: float  # time from frame to frame [ns]
    uncertainty_s: float  # standard uncertainty of the times of the newest frames [s], without that of the least delay
    limit_s: float  # largest difference of two halves of the arrivals, plus the least delay of the newest intervals [s]

    def times_ns(self, counters: IntArray) -> IntArray:
        """Return the ROS times of frames [ns], (n,)."""
        since_ns: IntArray = np.rint((counters - self.first) * self.period_ns).astype(np.int64)
        return self.start_ns + since_ns


class _Arrival(NamedTuple):
    """The arrival with the least delay of an interval, relative to the first frame and the nominal rate."""

    elapsed_s: float  # by the counter
    late_s: float  # of the arrival


class ClockMapping:
    """Follows the clock of a device by the arrivals of its frames.

    Attributes:
        line: The present line; None before there have been enough arrivals.

    """

    def __init__(self, frame_rate: float) -> None:
        """Start without arrivals; ``frame_rate`` is nominal [Hz]."""
        self._nominal_ns = NS / frame_rate
        self._arrivals: deque[_Arrival] = deque()
        self._differences: deque[float] = deque(maxlen=MAX_COMPARISONS)
        self._first: tuple[int, int] | None = None
        self._least: _Arrival | None = None
        self._interval = 0
        self.line: ClockLine | None = None

    def add(self, counter: int, arrived_ns: int) -> None:
        """Add the arrival of a frame at a ROS time [ns]; of frames that arrived together the last one suffices."""
        first, start_ns = self._first = self._first or (counter, arrived_ns)
        elapsed_ns = (counter - first) * self._nominal_ns
        arrival = _Arrival(elapsed_ns / NS, (arrived_ns - start_ns - elapsed_ns) / NS)
        interval = int(arrival.elapsed_s / INTERVAL_S)
        if interval != self._interval and self._least is not None:
            self._end_interval(self._least)
            self._least = None
        self._interval = interval
        if self._least is None or arrival.late_s < self._least.late_s:
            self._least = arrival

    def _end_interval(self, least: _Arrival) -> None:
        """Find the line again with the least arrival of one more interval."""
        arrivals = self._arrivals
        arrivals.append(least)
        while arrivals[0].elapsed_s < least.elapsed_s - WINDOW_S:
            arrivals.popleft()
        if len(arrivals) < COMPARED_INTERVALS or self._first is None:
            return
        points = list(arrivals)
        drift, late_s = _lower_line(points)
        halves = [_lower_line(half) for half in (points[::2], points[1::2])]
        there = [offset_s + slope * least.elapsed_s for slope, offset_s in halves]
        self._differences.append(there[1] - there[0])
        if len(arrivals) < LEAST_INTERVALS and least.elapsed_s < LONGEST_START_S:
            return
        spread_s = math.sqrt(sum(each * each for each in self._differences) / len(self._differences))
        first, start_ns = self._first
        period_ns = self._nominal_ns * (1.0 + drift)
        limit_s = max(abs(each) for each in self._differences)
        delays_s = [each.late_s - late_s - drift * each.elapsed_s for each in points]
        delay_s = max(0.0, min(delays_s[-STEP_INTERVALS:]))
        change_s = median(abs(after - before) for before, after in pairwise(delays_s))
        excess_s = max(0.0, delay_s - DELAY_THRESHOLD * change_s)
        self.line = ClockLine(
            first,
            start_ns + round(late_s * NS),
            period_ns,
            math.hypot(spread_s, excess_s / math.sqrt(3.0)),  # anything from 0 to the excess may be the error
            limit_s + delay_s,
        )


def _lower_line(points: Sequence[_Arrival]) -> tuple[float, float]:
    """Return slope and offset [s] of the line below all points with the least sum of distances from them.

    It contains the edge of the lower convex hull above or below which their mean lies (linear programming in two
    unknowns); the points are in ascending order.
    """
    hull: list[_Arrival] = []
    for point in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    mean_s = sum(point.elapsed_s for point in points) / len(points)
    edge = next(n for n in range(1, len(hull)) if hull[n].elapsed_s >= mean_s)
    left, right = hull[edge - 1], hull[edge]
    slope = (right.late_s - left.late_s) / (right.elapsed_s - left.elapsed_s)
    return slope, left.late_s - slope * left.elapsed_s


def _turns_down(a: _Arrival, b: _Arrival, c: _Arrival) -> bool:
    """Return whether b is not below the line from a to c."""
    return (b.late_s - a.late_s) * (c.elapsed_s - a.elapsed_s) >= (c.late_s - a.late_s) * (b.elapsed_s - a.elapsed_s)
