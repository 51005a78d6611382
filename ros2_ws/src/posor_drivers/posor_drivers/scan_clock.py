"""Scan clock: tick k happens at k / rate seconds of the ROS clock, on every host."""

from __future__ import annotations

from typing import TypeVar

from posor.numerics.array_types import IntArray
from posor.numerics.stamps import NS

TickT = TypeVar("TickT", int, IntArray)


def tick_stamp_ns(tick: TickT, rate: int) -> TickT:
    """Return the time [ns] of a tick, or of ticks (n,), at a rate in whole hertz."""
    seconds, rest = divmod(tick, rate)
    return seconds * NS + rest * NS // rate


def first_tick_after(time_ns: int, rate: int) -> int:
    """Return the first tick later than a time [ns]."""
    tick = time_ns * rate // NS
    while tick_stamp_ns(tick, rate) <= time_ns:
        tick += 1
    return tick
