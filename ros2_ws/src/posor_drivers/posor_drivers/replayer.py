"""Publishes a timeline at its pace, from a thread of its own."""

from __future__ import annotations

import time
from enum import Enum
from threading import Event, Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_drivers.timeline import Due


LOOKOUT_S = 0.02
"""Time between two looks at the subscriptions."""


class ReplayState(Enum):
    """What a replayer is doing."""

    WAITING = "waiting"
    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"


class Replayer:
    """Waits until it may start, then publishes each message when it is due.

    A steady clock sets the pace. A message that is late goes out at once, none is left out.
    """

    def __init__(
        self,
        dues: Callable[[], Iterator[Due]],
        publish: Callable[[Due], None],
        may_start: Callable[[], bool],
        on_state: Callable[[ReplayState, Exception | None], None],
    ) -> None:
        """Prepare a replay.

        Args:
            dues: Makes the timeline; called when the replay begins.
            publish: Publishes one message.
            may_start: Whether enough listeners are there; asked until it is so.
            on_state: Told of each new state, in the replay's thread; with the error when it failed.

        """
        self._dues = dues
        self._publish = publish
        self._may_start = may_start
        self._report = on_state
        self._state = ReplayState.WAITING
        self._stop = Event()
        self._thread = Thread(target=self._run, name="replay")

    @property
    def stopping(self) -> bool:
        """Whether ``stop`` was called."""
        return self._stop.is_set()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> bool:
        """Stop after the message in hand and wait for the thread; return whether there was anything left to do."""
        self._stop.set()
        self._thread.join()
        return self._state not in (ReplayState.ENDED, ReplayState.FAILED)

    def _enter(self, state: ReplayState, error: Exception | None = None) -> None:
        self._state = state
        self._report(state, error)

    def _run(self) -> None:
        try:
            self._enter(ReplayState.WAITING)
            while not self._may_start():
                if self._stop.wait(LOOKOUT_S):
                    return
            self._enter(ReplayState.RUNNING)
            begin = time.monotonic()
            for due in self._dues():
                if self._stop.wait(max(0.0, begin + due.after_s - time.monotonic())):
                    return
                self._publish(due)
        except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
            self._enter(ReplayState.FAILED, error)
        else:
            self._enter(ReplayState.ENDED)
