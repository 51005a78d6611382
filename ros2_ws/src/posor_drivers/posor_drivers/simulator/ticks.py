"""The scan clock: tick k happens at k / rate of the ROS clock, on every host."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from posor_estimator.core.types import IntArray

NS = 1_000_000_000


def stamps_of(ticks: IntArray, rate: int) -> IntArray:
    """Return the time of ticks [ns], (n,), at a rate in whole hertz."""
    seconds, rest = np.divmod(ticks, rate)
    return np.asarray(seconds * NS + rest * NS // rate)


def stamp_of(tick: int, rate: int) -> int:
    """Return the time of one tick [ns]."""
    return tick * NS // rate


def first_tick_after(time_ns: int, rate: int) -> int:
    """Return the first tick later than a time [ns]."""
    tick = time_ns * rate // NS
    while stamp_of(tick, rate) <= time_ns:
        tick += 1
    return tick
