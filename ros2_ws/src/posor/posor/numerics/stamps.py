"""Stamps of messages as times, and the scan clock: tick k is at k / rate seconds of the ROS clock on every host."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from posor.numerics.array_types import IntArray
from posor.numerics.compiled import inlined

NS = 1_000_000_000
NO_TIME = "is zero, or its nanoseconds are a second or more"  # why a stamp is invalid
TickT = TypeVar("TickT", int, IntArray)


def time_ns(seconds: int, nanoseconds: int) -> int:
    """Return the time of a stamp [ns]; 0 (invalid) if its nanoseconds are a second or more."""
    return seconds * NS + nanoseconds if nanoseconds < NS else 0


time_in_kernel = inlined(time_ns)  # the same, for kernels


def is_accepted_age(age_ns: int, youngest_ns: float, oldest_ns: float) -> bool:
    """Return whether an age [ns] is between two others; a negative age is ahead of time."""
    return youngest_ns <= age_ns <= oldest_ns


accepted_in_kernel = inlined(is_accepted_age)  # the same, for kernels


def times_ns(seconds: IntArray, nanoseconds: IntArray) -> IntArray:
    """Return the times of stamps [ns], (n,), likewise."""
    return np.where(nanoseconds < NS, seconds * NS + nanoseconds, 0)


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


def span_text(stamps_ns: IntArray) -> str:
    """Return the time from the first to the last valid stamp [ns], (n,), for a ``repr``: `` over 1.250 s``."""
    valid = stamps_ns[stamps_ns != 0]
    return f" over {(int(valid.max()) - int(valid.min())) / NS:.3f} s" if len(valid) else ""
