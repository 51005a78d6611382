# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Idle scheduler: deferrable work runs between the ticks of this process, not while a scan is being handled.

Python runs one thread at a time. A thread that is busy when a tick is due delays the tick, and a thread that waits for
the interpreter lock may obtain it in the middle of a tick. Without a schedule the diagnostics of a dozen nodes, a
millisecond each, delay one tick each time. A thread with ticks announces the end of each tick and when the next is due
(`TickSchedule`); deferrable work is passed to `run_when_idle`, one short piece at a time. It sleeps until a tick ends:
a thread that polls takes the interpreter lock from the ticks each time.
"""

from __future__ import annotations

from threading import Event, Lock
from time import monotonic_ns, time_ns
from typing import TYPE_CHECKING, Any

from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Callable

MARGIN_PERIODS, MAX_MARGIN_NS = 0.6, 300_000
"""Time that must be left before the next tick: a share of the period, at most the length of most work [ns]."""
MAX_WAIT_PERIODS, MAX_WAIT_NS = 4, 5_000_000
"""Longest wait for an idle moment: a number of periods, at most a time [ns]; other threads may wait for the caller."""

_tick_ended = Event()  # set by threads with ticks after each tick; cleared by a thread before it waits for the next
_schedules: tuple[TickSchedule, ...] = ()
_lock = Lock()


class TickSchedule:
    """The ticks of one thread.

    The next tick is due at ``due_ns`` [ns of the system clock] and runs from then until ``end_tick``.
    """

    __slots__ = ("due_ns", "margin_ns", "period_ns")

    def __init__(self, rate: float) -> None:
        global _schedules  # noqa: PLW0603  one process, one interpreter lock
        self.period_ns = int(1e9 / rate)
        self.margin_ns = min(int(MARGIN_PERIODS * self.period_ns), MAX_MARGIN_NS)
        self.due_ns = 0
        with _lock:
            _schedules = (*_schedules, self)

    def end_tick(self, next_due_ns: int) -> None:
        """Announce that the thread is idle until a time [ns of the system clock]."""
        self.due_ns = next_due_ns
        if not _tick_ended.is_set():
            _tick_ended.set()

    def remove(self) -> None:
        """Remove the thread."""
        global _schedules  # noqa: PLW0603
        with _lock:
            _schedules = tuple(schedule for schedule in _schedules if schedule is not self)
        _tick_ended.set()


def run_when_idle(work: Callable[[], Any]) -> bool:
    """Run ``work`` when no tick is running or due soon; return whether there was such a moment within the longest wait.

    Where ticks take all of their period, ``work`` runs after the longest wait.
    """
    longest_ns = max((schedule.period_ns for schedule in _schedules), default=0)
    until_ns = monotonic_ns() + min(MAX_WAIT_PERIODS * longest_ns, MAX_WAIT_NS)
    _tick_ended.clear()
    while not (is_idle := _is_idle()) and (left_ns := until_ns - monotonic_ns()) > 0:
        _tick_ended.wait(left_ns / NS)
        _tick_ended.clear()
    work()
    return is_idle


def _is_idle() -> bool:
    return all(schedule.due_ns - time_ns() > schedule.margin_ns for schedule in _schedules)
