"""Drives live drivers in turn: one thread of the process for all that have the same rate."""

from __future__ import annotations

import sys
from threading import Lock, Thread
from typing import TYPE_CHECKING

from posor_estimator.ros.moments import NEVER_NS, Moments
from posor_estimator.ros.process import SWITCH_S
from posor_estimator.ros.turns import Turn

from posor_drivers.ros_time import RosTime, SimulatedTime, WallTime, is_simulated, wake_exactly
from posor_drivers.timeline import Pause

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from rclpy.clock import Clock

    from posor_drivers.timeline import Due

EAGER_S = 2e-5
"""How long another Python thread may hold up this one when a tick is due."""
UNDISTURBED_S = 5e-3
"""How long this one goes on, from a tick on, before it lets another have its turn: the drivers' ticks are short."""


class Beat:
    """One driver's part in a ticker.

    Attributes:
        due_ns: When it is to go on [ns].
        late: When its ticks were due, and when it came to them.
        time: The ROS time that it follows.
        steps_before: How often the wall's clock had been stepped when it began.

    """

    def __init__(
        self,
        time: RosTime,
        dues: Iterator[Due | Pause],
        publish: Callable[[Due], None],
        on_end: Callable[[Exception | None], None],
    ) -> None:
        """Go on with the first tick.

        Args:
            time: The ROS time that ``dues`` follows.
            dues: What to publish, with pauses until the next is due.
            publish: Publishes one message.
            on_end: Told in the ticker's thread that there is no more, with the error if that is why.

        """
        self.due_ns = 0
        self.late = Moments() if isinstance(time, WallTime) else Moments(lambda: time.now_ns)
        self.time = time
        self.steps_before = time.steps
        self._epoch = time.epoch
        self._dues = dues
        self._publish = publish
        self._on_end = on_end
        self._lock = Lock()
        self._ended = False

    def go_on(self, now_ns: int) -> bool:
        """Publish what is due, if anything is; return whether more is to come."""
        with self._lock:
            if self._ended:
                return False
            if self._epoch != self.time.epoch:
                self._epoch = self.time.epoch
            elif now_ns < self.due_ns:
                return True
            elif self.due_ns > 1:
                self.late.note(self.due_ns)
            try:
                for due in self._dues:
                    if isinstance(due, Pause):
                        self.due_ns = due.until_ns
                        return True
                    self._publish(due)
            except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
                failure: Exception | None = error
            else:
                failure = None
            self._ended = True
            self._on_end(failure)
        return False

    def fail(self, error: Exception) -> None:
        """Go on no more, and say why."""
        if self.end():
            self._on_end(error)

    def end(self) -> bool:
        """Go on no more, and wait for what it is about to do; return whether there was anything left to do."""
        with self._lock:
            was_left, self._ended = not self._ended, True
        return was_left


class Ticker:
    """A thread that lets each of its drivers go on when that is due, in the order in which they came."""

    def __init__(self, rate: float, clock: Clock | None, time: RosTime) -> None:
        """Wait for the first; ``clock`` is the simulated one that ``time`` follows, if any."""
        self.time = time
        self._rate = rate
        self._key = (rate, clock)
        self._beats: tuple[Beat, ...] = ()
        self._thread = Thread(target=self._run, name="ticks", daemon=True)

    @classmethod
    def joined(cls, clock: Clock, rate: float, spin_ns: int, beat: Callable[[RosTime], Beat]) -> tuple[Ticker, Beat]:
        """Let a driver take part in this process's ticker of its rate from now on; return both.

        Args:
            clock: The driver's clock; each simulated one has a ticker of its own.
            rate: Ticks per second; only drivers of the same rate share a thread.
            spin_ns: See ``WallTime``; where drivers share a thread, the longest.
            beat: Makes the driver's part.

        """
        simulated = is_simulated(clock)
        key = (rate, clock if simulated else None)
        with _lock:
            if key not in _tickers:
                _tickers[key] = cls(*key, SimulatedTime(clock) if simulated else WallTime(spin_ns))
            ticker = _tickers[key]
            if isinstance(ticker.time, WallTime):
                ticker.time.spin_ns = max(spin_ns, ticker.time.spin_ns)
            made = beat(ticker.time)
            ticker.add(made)
        return ticker, made

    def add(self, beat: Beat) -> None:
        """Let a driver take part from now on; called by ``joined``."""
        self._beats = (*self._beats, beat)
        if len(self._beats) == 1:
            self._thread.start()
        self.time.wake()

    def remove(self, beat: Beat) -> None:
        """Let a driver take part no more; the thread ends with the last one, and has then ended."""
        self._go_on_without(beat)
        if not self._beats:
            self.time.wake()
            self._thread.join()

    def _go_on_without(self, beat: Beat) -> None:
        with _lock:
            self._beats = tuple(other for other in self._beats if other is not beat)
            if not self._beats and _tickers.get(self._key) is self:
                del _tickers[self._key]

    def _run(self) -> None:
        turn = Turn(self._rate)
        try:
            self._tick(turn)
        except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
            while self._beats:
                beat = self._beats[0]
                self._go_on_without(beat)
                beat.fail(error)
        finally:
            turn.end()
            sys.setswitchinterval(SWITCH_S)
            self.time.close()

    def _tick(self, turn: Turn) -> None:
        wake_exactly()
        time = self.time
        by_the_wall = isinstance(time, WallTime)
        while beats := self._beats:
            sys.setswitchinterval(EAGER_S)
            due_ns = min([beat.due_ns for beat in beats])
            turn.due_ns = due_ns if by_the_wall else NEVER_NS
            time.wait(due_ns)
            sys.setswitchinterval(UNDISTURBED_S)
            now_ns = time.turn_ns = time.now_ns
            for beat in beats:
                if not beat.go_on(now_ns):
                    self._go_on_without(beat)


_tickers: dict[Hashable, Ticker] = {}
_lock = Lock()
