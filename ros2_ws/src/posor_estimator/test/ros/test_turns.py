"""What can wait is done between the ticks of a process."""

from __future__ import annotations

from threading import Event, Semaphore, Thread
from time import sleep, time_ns
from typing import TYPE_CHECKING

import pytest
from posor_estimator.ros import turns as module
from posor_estimator.ros.turns import MOST_ROOM_NS, NS, Turn, between_ticks

if TYPE_CHECKING:
    from collections.abc import Iterator

SLOW = 1.0
"""Ticks a second."""
LOOKS = 3


@pytest.fixture
def turn(monkeypatch: pytest.MonkeyPatch) -> Iterator[Turn]:
    """Return the turn of a thread whose ticks are far apart, and are waited for until the test is over."""
    monkeypatch.setattr(module, "PATIENCE", 10**9)
    monkeypatch.setattr(module, "MOST_PATIENCE_NS", 10**18)
    turn = Turn(SLOW)
    yield turn
    turn.end()


class Waiting:
    """Somebody who can wait, in a thread."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "sleep", self._sleep)
        self.done = Event()
        self.found: bool | None = None
        self._looked = Semaphore(0)
        self.thread = Thread(target=self._wait)
        self.thread.start()

    def _sleep(self, seconds: float) -> None:
        self._looked.release()
        sleep(seconds)

    def _wait(self) -> None:
        self.found = between_ticks()
        self.done.set()
        self._looked.release(LOOKS)

    def waits(self) -> bool:
        """Return whether it still waits after it has looked a few times more."""
        for _ in range(LOOKS):
            assert self._looked.acquire(timeout=30.0)
        return not self.done.is_set()


def test_nobody_waits_where_there_are_no_ticks() -> None:
    assert between_ticks()


def test_there_is_time_long_before_a_tick(turn: Turn) -> None:
    turn.due_ns = time_ns() + turn.period_ns
    assert between_ticks()


@pytest.mark.parametrize("before_ns", [None, -NS])
def test_a_tick_that_is_under_way_or_late_is_waited_for(
    turn: Turn, before_ns: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn.due_ns = 0 if before_ns is None else time_ns() + before_ns
    waiting = Waiting(monkeypatch)
    assert waiting.waits()
    turn.due_ns = time_ns() + turn.period_ns
    assert waiting.done.wait(30.0)
    assert waiting.found
    waiting.thread.join()


def test_a_tick_that_is_due_soon_is_waited_for(turn: Turn, monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = time_ns()
    monkeypatch.setattr(module, "time_ns", lambda: now_ns)
    turn.due_ns = now_ns + MOST_ROOM_NS
    waiting = Waiting(monkeypatch)
    assert waiting.waits()
    turn.due_ns = now_ns + MOST_ROOM_NS + 1
    assert waiting.done.wait(30.0)
    assert waiting.found
    waiting.thread.join()


def test_every_thread_of_ticks_is_waited_for(turn: Turn, monkeypatch: pytest.MonkeyPatch) -> None:
    turn.due_ns = time_ns() + turn.period_ns
    other = Turn(SLOW)
    waiting = Waiting(monkeypatch)
    assert waiting.waits()
    other.end()
    assert waiting.done.wait(30.0)
    assert waiting.found
    waiting.thread.join()


@pytest.mark.parametrize("rate", [1e4, 1e-3])
def test_where_there_is_never_time_it_is_taken_after_some_ticks_or_milliseconds(rate: float) -> None:
    turn = Turn(rate)
    assert turn.due_ns == 0
    assert not between_ticks()
    turn.end()
    assert between_ticks()
