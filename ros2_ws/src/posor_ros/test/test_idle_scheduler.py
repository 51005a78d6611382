# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Deferrable work runs between the ticks of a process."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event, Semaphore, Thread
from time import time_ns

import pytest
from posor_ros import idle_scheduler
from posor_ros.idle_scheduler import MAX_MARGIN_NS, TickSchedule, run_when_idle

SLOW_RATE = 1.0


def no_work() -> None:
    pass


@pytest.fixture
def schedule(monkeypatch: pytest.MonkeyPatch) -> Iterator[TickSchedule]:
    """Return a schedule with ticks far apart, for whose end a waiting thread waits without a limit."""
    monkeypatch.setattr(idle_scheduler, "MAX_WAIT_PERIODS", 10**9)
    monkeypatch.setattr(idle_scheduler, "MAX_WAIT_NS", 10**18)
    schedule = TickSchedule(SLOW_RATE)
    yield schedule
    schedule.remove()


class ObservedEvent(Event):
    def __init__(self) -> None:
        super().__init__()
        self.waits = Semaphore(0)

    def wait(self, timeout: float | None = None) -> bool:
        self.waits.release()
        return super().wait(timeout)


class WaitingThread:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._tick_ended = ObservedEvent()
        monkeypatch.setattr(idle_scheduler, "_tick_ended", self._tick_ended)
        self._done = Event()
        self._was_idle: bool | None = None
        self._thread = Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self._was_idle = run_when_idle(self._done.set)

    def is_waiting(self) -> bool:
        """Return whether the thread begins to wait, once more after a tick that changes nothing."""
        for _ in range(2):
            assert self._tick_ended.waits.acquire(timeout=30.0)
            self._tick_ended.set()
        return not self._done.is_set()

    def runs(self) -> bool:
        """Wait for the work; return whether it ran in an idle moment."""
        assert self._done.wait(30.0)
        self._thread.join()
        return bool(self._was_idle)


def test_work_runs_at_once_long_before_a_tick(schedule: TickSchedule) -> None:
    schedule.end_tick(time_ns() + schedule.period_ns)
    assert run_when_idle(no_work)


@pytest.mark.parametrize("before_ns", [None, -(10**9)])
def test_work_waits_for_a_running_or_late_tick(
    schedule: TickSchedule, before_ns: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    schedule.end_tick(0 if before_ns is None else time_ns() + before_ns)
    thread = WaitingThread(monkeypatch)
    assert thread.is_waiting()
    schedule.end_tick(time_ns() + schedule.period_ns)
    assert thread.runs()


def test_work_waits_for_a_tick_that_is_due_soon(schedule: TickSchedule, monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = time_ns()
    monkeypatch.setattr(idle_scheduler, "time_ns", lambda: now_ns)
    schedule.end_tick(now_ns + MAX_MARGIN_NS)
    thread = WaitingThread(monkeypatch)
    assert thread.is_waiting()
    schedule.end_tick(now_ns + MAX_MARGIN_NS + 1)
    assert thread.runs()


def test_work_waits_for_every_thread_with_ticks(schedule: TickSchedule, monkeypatch: pytest.MonkeyPatch) -> None:
    schedule.end_tick(time_ns() + schedule.period_ns)
    other = TickSchedule(SLOW_RATE)
    thread = WaitingThread(monkeypatch)
    assert thread.is_waiting()
    other.remove()
    assert thread.runs()


@pytest.mark.parametrize("rate", [1e4, 1e-3])
def test_work_runs_after_the_longest_wait_where_no_moment_is_idle(rate: float) -> None:
    schedule = TickSchedule(rate)
    assert schedule.due_ns == 0
    done = Event()
    assert not run_when_idle(done.set)
    assert done.is_set()
    schedule.remove()
    assert run_when_idle(no_work)
