# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The newest frames of a device, by their numbers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray, IntArray

    from posor_drivers.instruments.device import Frames

CAPACITY = 1 << 13
"""Frames that are kept; at 4 kHz two seconds."""
RATE_FRAMES = 100
"""Of a polled device, over which its rate is averaged."""
NO_FRAME = np.iinfo(np.int64).min


class NearestFrame(NamedTuple):
    """The frame nearest to a time, by the times that the frames have."""

    number: int
    since_before_ns: int  # time from the frame before to this one
    until_after_ns: int  # time from this frame to the one after
    offset_ns: int  # wanted time after that of this frame


class FrameStore:
    """Keeps the newest ``CAPACITY`` frames.

    Attributes:
        period_s: Time from frame to frame [s]: nominal, or by the clock line.
        values: Values by row and channel, (CAPACITY, c).
        times_ns: Times of frames that have one of their own, (CAPACITY,).
        uncertainties_s: Standard uncertainties of these times, (CAPACITY,).

    """

    def __init__(self, channels: int, frame_rate: float) -> None:
        """Start without frames; ``frame_rate`` is nominal [Hz]."""
        self.period_s, self._timed = 1.0 / frame_rate, False
        self._numbers = np.full(CAPACITY, NO_FRAME, dtype=np.int64)
        self.values = np.full((CAPACITY, channels), np.nan)
        self.times_ns, self.uncertainties_s = np.zeros(CAPACITY, dtype=np.int64), np.zeros(CAPACITY)

    def write(self, frames: Frames, which: IntArray, delay_ns: int) -> None:
        """Store frames; ``delay_ns``: by which their own times are late."""
        rows = frames.counters[which] % CAPACITY
        self._numbers[rows], self.values[rows] = frames.counters[which], frames.values[which]
        if frames.times_ns is not None:
            self._timed = True
            self.times_ns[rows] = frames.times_ns[which] - delay_ns
            self.uncertainties_s[rows] = frames.time_uncertainty_s

    def frames_up_to(
        self, number: int, count: int, columns: Sequence[int] | slice
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the stored ones among the last ``count`` frames up to ``number``, oldest first.

        Returns numbers, (n,), times by the clock of the device or of ROS, (n,) [s], and values of columns, (n, c).
        """
        numbers = np.arange(number - count + 1, number + 1)
        numbers = numbers[self._numbers[numbers % CAPACITY] == numbers]
        rows = numbers % CAPACITY
        times_s = self.times_ns[rows] / NS if self._timed else (numbers - number) * self.period_s
        return numbers, times_s, self.values[rows][:, columns]

    def row_of(self, number: int) -> int | None:
        """Return the row of a frame, if it is there."""
        row = number % CAPACITY
        return row if self._numbers[row] == number else None

    def rows_around(self, number: int) -> list[int] | None:
        """Return the rows of a frame and its two neighbours, if they are there."""
        rows = [self.row_of(each) for each in (number - 1, number, number + 1)]
        present = [row for row in rows if row is not None]
        return present if len(present) == len(rows) else None

    def nearest(self, time_ns: int, newest: int) -> NearestFrame | None:
        """Return the frame nearest to a ROS time [ns] among those that have a time of their own.

        None where one of the three around it is missing or, after the clock was set back, they are in another order.
        ``newest``: number of the newest frame.
        """
        times_ns, period_ns = self.times_ns, NS * self.period_s
        number = newest - math.ceil((times_ns[newest % CAPACITY] - time_ns) / period_ns)
        while (row := self.row_of(number)) is not None and times_ns[row] > time_ns:  # frames after a late one
            number -= 1
        while (following := self.row_of(number + 1)) is not None and times_ns[following] <= time_ns:
            number += 1
        row = self.row_of(number)
        if row is None or following is None or times_ns[row] > time_ns:
            return None
        if times_ns[following] - time_ns < time_ns - times_ns[row]:
            number += 1
        rows = self.rows_around(number)
        if rows is None:
            return None
        before_ns, nearest_ns, after_ns = times_ns[rows].tolist()
        if min(nearest_ns - before_ns, after_ns - nearest_ns) <= 0:
            return None
        return NearestFrame(number, nearest_ns - before_ns, after_ns - nearest_ns, time_ns - nearest_ns)

    def timed_rate(self, first: int, newest: int) -> float:
        """Return the mean rate of the last frames that have a time of their own [Hz]; 0 where there is only one."""
        first = max(first, newest - RATE_FRAMES)
        elapsed_ns = self.times_ns[newest % CAPACITY] - self.times_ns[first % CAPACITY]
        return (newest - first) * NS / float(elapsed_ns) if newest > first else 0.0
