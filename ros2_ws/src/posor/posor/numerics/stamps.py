# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages as times, and a log of them.

The scan clock: tick k is at k / rate seconds of the ROS clock on every host.
"""

from __future__ import annotations

import time
from array import array
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from posor.numerics.array_types import IntArray
from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from collections.abc import Callable

NS = 1_000_000_000
NEVER_NS = 2**63 - 1
CAPACITY = 1 << 14  # number of times that a ``TimestampLog`` holds
NO_TIME = "is zero, or its nanoseconds are a second or more"  # why a stamp is invalid
TickT = TypeVar("TickT", int, IntArray)


def time_ns(seconds: int, nanoseconds: int) -> int:
    """Return the time of a stamp [ns]; 0 (invalid) if its nanoseconds are a second or more."""
    return seconds * NS + nanoseconds if nanoseconds < NS else 0


time_in_kernel = in_place(time_ns)  # the same, for kernels


def is_accepted_age(age_ns: int, youngest_ns: float, oldest_ns: float) -> bool:
    """Return whether an age [ns] is between two others; a negative age is ahead of time."""
    return youngest_ns <= age_ns <= oldest_ns


accepted_in_kernel = in_place(is_accepted_age)  # the same, for kernels


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


class TimestampLog:
    """Ring buffer of reference times, such as stamps, each with the time of its recording [ns].

    One thread records, another drains. Nothing is allocated or locked: a pair counts once both times are written. If
    more than ``CAPACITY`` pairs are recorded between two drains, the last ones are kept. ``now_ns`` is the clock; it
    may be replaced.
    """

    __slots__ = ("_arrays", "_drained", "_recorded", "_recording_times", "_reference_times", "now_ns")

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.now_ns = now_ns
        self._reference_times = array("q", bytes(8 * CAPACITY))
        self._recording_times = array("q", bytes(8 * CAPACITY))
        self._arrays = np.frombuffer(self._reference_times, np.int64), np.frombuffer(self._recording_times, np.int64)
        self._recorded = self._drained = 0

    def record(self, reference_ns: int) -> None:
        """Store a reference time and the present time."""
        number = self._recorded
        index = number & (CAPACITY - 1)
        self._reference_times[index] = reference_ns
        self._recording_times[index] = self.now_ns()
        self._recorded = number + 1

    def drain(self) -> tuple[IntArray, IntArray]:
        """Return the reference times and the recording times since the last call, (n,) each [ns]."""
        end = self._recorded
        begin = max(self._drained, end - CAPACITY)
        self._drained = end
        indices = np.arange(begin, end) & (CAPACITY - 1)
        reference_times, recording_times = self._arrays
        return reference_times[indices], recording_times[indices]
