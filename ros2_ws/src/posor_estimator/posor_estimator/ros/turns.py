"""Turns: what can wait is done between the ticks of this process, not while a scan is on its way.

Python lets one thread run at a time. One that is at something when a tick is due holds the tick up, and one that waits
for its turn takes it in the middle of a tick; so the diagnostics of a dozen nodes, a millisecond each, cost a tick each
time they come. A tick thread says when it is due (`Turn`); whoever can wait calls `between_ticks` before each piece of
what it does.
"""

from __future__ import annotations

from threading import Lock
from time import monotonic_ns, sleep, time_ns

ROOM, MOST_ROOM_NS = 0.3, 200_000
"""What must be left until the next tick: a share of the period, but no more than a piece takes [ns]."""
PATIENCE, MOST_PATIENCE_NS = 4, 5_000_000
"""When a piece is done nevertheless: after so many periods, or a time [ns], since others wait for whoever waits."""
LOOK_S = 5e-5
"""Time between two looks."""
NS = 1_000_000_000

_turns: tuple[Turn, ...] = ()
_lock = Lock()


class Turn:
    """A thread that has something to do at every tick.

    Attributes:
        due_ns: When its next tick is due [ns of the wall's clock]; once that has passed, it is at it.

    """

    __slots__ = ("due_ns", "period_ns", "room_ns")

    def __init__(self, rate: float) -> None:
        """Have ticks from now on, so many a second."""
        global _turns  # noqa: PLW0603  one process, one lock of Python
        self.period_ns = int(NS / rate)
        self.room_ns = min(int(ROOM * self.period_ns), MOST_ROOM_NS)
        self.due_ns = 0
        with _lock:
            _turns = (*_turns, self)

    def end(self) -> None:
        """Have no more ticks."""
        global _turns  # noqa: PLW0603
        with _lock:
            _turns = tuple(turn for turn in _turns if turn is not self)


def between_ticks() -> bool:
    """Wait until no tick is under way, nor due soon; return whether there was such a time.

    Where there is none, as where ticks take all of their period, it waits for some of them, or milliseconds, at most.
    """
    longest_ns = max((turn.period_ns for turn in _turns), default=0)
    until_ns = monotonic_ns() + min(PATIENCE * longest_ns, MOST_PATIENCE_NS)
    while not all(turn.due_ns - time_ns() > turn.room_ns for turn in _turns):
        if monotonic_ns() > until_ns:
            return False
        sleep(LOOK_S)
    return True
