# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ticks of live drivers: their schedule, and one thread of the process for all drivers of the same rate."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.numerics.stamps import NEVER_NS, TimestampLog
from posor_ros.delivery_round import DeliveryRound
from posor_ros.idle_scheduler import TickSchedule
from posor_ros.realtime_process import SWITCH_INTERVAL_S

from posor_drivers.ros_clock import SimulatedClock, TickClock, WallClock, disable_timer_slack, is_simulated

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from rclpy.clock import Clock

    from posor_drivers.sources.source import LiveSource, SourceMessage

SUBSCRIBER_POLL_S = 0.02
"""Time between two checks whether enough subscribers are connected."""


@dataclass(slots=True)
class Pause:
    """Nothing is published before a ROS time [ns]."""

    until_ns: int


class RunCalls(NamedTuple):
    """What the run of a source calls in its driver."""

    publish: Callable[[SourceMessage], None]
    has_subscribers: Callable[[], bool]
    """Whether enough subscribers are connected."""
    on_begin: Callable[[], None]
    on_end: Callable[[Exception | None], None]
    """Takes the error of a failure; may block."""


SWITCH_AT_TICK_S = 2e-5
"""Switch interval of Python while this thread waits: how long another thread may delay a tick."""
SWITCH_DURING_TICK_S = 5e-3
"""Switch interval of Python during a tick, so that other threads do not interrupt it; ticks are short."""


@dataclass
class MissedTicks:
    """Number of late wake-ups, and of ticks that were missed because of them, in one run."""

    overruns: int = 0
    ticks: int = 0


def schedule_ticks(source: LiveSource[Any], clock: TickClock, missed: MissedTicks) -> Iterator[SourceMessage | Pause]:
    """Yield what is to be published, and pauses until the next is due; ends with the run.

    A tick is missed when the next tick is due as well: it is skipped and counted, so scans are never bunched, unless
    the source keeps the readings of past ticks (``LiveSource.ticks_kept``). All drivers of a thread decide this by the
    same time, so they miss the same ticks. When the clock goes back (a simulation that restarts) or is stepped, the run
    restarts and no tick counts as missed.
    """
    while True:
        while clock.turn_ns < 1:  # simulated time is 0 before the first clock message
            yield Pause(1)
        epoch = clock.epoch
        tick, last = source.start_run(clock.turn_ns)
        due_ns = source.publication_time_ns(tick)
        while last is None or tick <= last:
            yield Pause(due_ns)
            if clock.epoch != epoch:
                break
            due_ns = source.publication_time_ns(tick + 1)
            if due_ns <= clock.turn_ns:
                present = max(tick + 1, source.newest_tick(clock.turn_ns))
                while present > tick + 1 and source.publication_time_ns(present) > clock.turn_ns:
                    present -= 1
                present = (present if last is None else min(present, last)) - source.ticks_kept
                if present > tick:
                    missed.overruns += 1
                    missed.ticks += present - tick
                    tick = present
                    due_ns = source.publication_time_ns(tick + 1)
            yield from source.read_tick(tick)
            tick += 1
        else:
            return


class TickTask:
    """The work of one driver in a tick scheduler.

    Attributes:
        due_ns: Time at which the task continues [ns].
        lateness: Due time and start of each tick.
        clock: ROS time of the task.
        steps_before: Steps of the wall clock before the task started.

    """

    def __init__(
        self,
        clock: TickClock,
        publications: Iterator[SourceMessage | Pause],
        publish: Callable[[SourceMessage], None],
        on_end: Callable[[Exception | None], None],
    ) -> None:
        """Start at the first tick of ``publications``, what to publish and pauses until the next is due.

        ``on_end`` is called in the scheduler's thread after the last message, with the error if there was one.
        """
        self.due_ns = 0
        self.lateness = TimestampLog() if isinstance(clock, WallClock) else TimestampLog(lambda: clock.now_ns)
        self.clock = clock
        self.steps_before = clock.steps
        self._epoch, self._lock, self._ended = clock.epoch, Lock(), False
        self._publications, self._publish, self._on_end = publications, publish, on_end

    def run_tick(self, now_ns: int) -> bool:
        """Publish the messages that are due; return whether the task continues."""
        with self._lock:
            if self._ended:
                return False
            if self._epoch != self.clock.epoch:
                self._epoch = self.clock.epoch
            elif now_ns < self.due_ns:
                return True
            elif self.due_ns > 1:
                self.lateness.record(self.due_ns)
            failure: Exception | None = None
            try:
                for item in self._publications:
                    if isinstance(item, Pause):
                        self.due_ns = item.until_ns
                        return True
                    self._publish(item)
            except Exception as error:  # noqa: BLE001  the main thread ends the program with it
                failure = error
            self._ended = True
            self._on_end(failure)
        return False

    def fail(self, error: Exception) -> None:
        """End the task with an error."""
        if self.end():
            self._on_end(error)

    def end(self) -> bool:
        """End the task after the present message; return whether it was still running."""
        with self._lock:
            was_running, self._ended = not self._ended, True
        return was_running


class TickScheduler:
    """A thread that runs its tasks when they are due, in the order in which they were added."""

    def __init__(self, rate: float, simulated: Clock | None, clock: TickClock) -> None:
        """Prepare the thread; ``simulated`` is the clock of a simulation that ``clock`` follows, if any."""
        self.clock = clock
        self._rate = rate
        self._key = (rate, simulated)
        self._tasks: tuple[TickTask, ...] = ()
        self._thread = Thread(target=self._run, name="ticks", daemon=True)

    @classmethod
    def add_task(
        cls, clock: Clock, rate: float, spin_ns: int, make_task: Callable[[TickClock], TickTask]
    ) -> tuple[TickScheduler, TickTask]:
        """Add a task to this process's scheduler of a rate [Hz]; return both.

        Only drivers of the same rate share a thread, with the longest ``spin_ns`` of all, see ``WallClock``. Each
        simulated clock has a scheduler of its own.
        """
        simulated = is_simulated(clock)
        key = (rate, clock if simulated else None)
        with _lock:
            if key not in _schedulers:
                _schedulers[key] = cls(*key, SimulatedClock(clock) if simulated else WallClock(spin_ns))
            scheduler = _schedulers[key]
            if isinstance(scheduler.clock, WallClock):
                scheduler.clock.spin_ns = max(spin_ns, scheduler.clock.spin_ns)
            return scheduler, scheduler.start_task(make_task)

    def start_task(self, make_task: Callable[[TickClock], TickTask]) -> TickTask:
        """Start a task in this thread; ``add_task`` calls this method under the lock of the schedulers."""
        task = make_task(self.clock)
        self._tasks = (*self._tasks, task)
        if len(self._tasks) == 1:
            self._thread.start()
        self.clock.wake()
        return task

    def remove_task(self, task: TickTask) -> None:
        """Remove a task; with the last one the thread ends before this method returns."""
        self._discard(task)
        if not self._tasks:
            self.clock.wake()
            self._thread.join()

    def _discard(self, task: TickTask) -> None:
        with _lock:
            self._tasks = tuple(other for other in self._tasks if other is not task)
            if not self._tasks and _schedulers.get(self._key) is self:
                del _schedulers[self._key]

    def _run(self) -> None:
        schedule = TickSchedule(self._rate)
        try:
            self._run_ticks(schedule)
        except Exception as error:  # noqa: BLE001  the main thread ends the program with it
            while self._tasks:
                task = self._tasks[0]
                self._discard(task)
                task.fail(error)
        finally:
            schedule.remove()
            sys.setswitchinterval(SWITCH_INTERVAL_S)
            self.clock.close()

    def _run_ticks(self, schedule: TickSchedule) -> None:
        disable_timer_slack()
        clock = self.clock
        is_wall = isinstance(clock, WallClock)
        while tasks := self._tasks:
            sys.setswitchinterval(SWITCH_AT_TICK_S)
            due_ns = min([task.due_ns for task in tasks])
            schedule.end_tick(due_ns if is_wall else NEVER_NS)
            clock.wait(due_ns)
            sys.setswitchinterval(SWITCH_DURING_TICK_S)
            now_ns = clock.turn_ns = clock.now_ns
            with DeliveryRound():
                for task in tasks:
                    if not task.run_tick(now_ns):
                        self._discard(task)


_schedulers: dict[Hashable, TickScheduler] = {}
_lock = Lock()
