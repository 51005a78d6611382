"""Publishes a live source at ticks of the ROS clock, in the thread of the process's tick scheduler."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Thread
from typing import TYPE_CHECKING, Any

from posor_ros.diagnostics import Level
from posor_ros.publication_timing import time_statistics
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from posor_drivers.ros_clock import is_simulated
from posor_drivers.tick_scheduler import SUBSCRIBER_POLL_S, Pause, RunState, TickScheduler, TickTask

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_ros.diagnostics import Status, Value
    from rclpy.node import Node

    from posor_drivers.ros_clock import TickClock
    from posor_drivers.sources.source import LiveSource, SourceMessage


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
                present = _newest_due_tick(source, tick + 1, clock.turn_ns)
                present = present if last is None else min(present, last)
                present -= source.ticks_kept
                if present > tick:
                    missed.overruns += 1
                    missed.ticks += present - tick
                    tick = present
                    due_ns = source.publication_time_ns(tick + 1)
            yield from source.read_tick(tick)
            tick += 1
        else:
            return


def _newest_due_tick(source: LiveSource[Any], tick: int, now_ns: int) -> int:
    """Return the newest tick that is due; ``tick`` is."""
    newest = max(tick, source.newest_tick(now_ns))
    while newest > tick and source.publication_time_ns(newest) > now_ns:
        newest -= 1
    return newest


class LivePublisher:
    """Waits for subscribers, then runs a task of the tick scheduler until it is stopped or the run ends."""

    def __init__(
        self,
        node: Node,
        rate: float,
        spin_us: int,
        publications: Callable[[TickClock], Iterator[SourceMessage | Pause]],
        publish: Callable[[SourceMessage], None],
        has_subscribers: Callable[[], bool],
        on_state: Callable[[RunState, Exception | None], None],
    ) -> None:
        """Prepare a run.

        Args:
            node: The driver.
            rate: Ticks of the source per second.
            spin_us: See the driver's parameter.
            publications: Makes the schedule for a clock; called when the run starts.
            publish: Publishes one message.
            has_subscribers: Whether enough subscribers are connected.
            on_state: Called with each new state, and with the error of a failure; may block.

        """
        self._node = node
        self._rate = rate
        self._spin_ns = 1000 * spin_us
        self._publications = publications
        self._publish = publish
        self._has_subscribers = has_subscribers
        self._on_state = on_state
        self._scheduler: TickScheduler | None = None
        self._end_thread: Thread | None = None
        self._timer: Any = None
        self._simulated = False
        self.task: TickTask | None = None
        self.stopping = False

    @property
    def clock_has_changed(self) -> bool:
        """Whether the node has changed between wall time and simulated time since the run started."""
        return self.task is not None and is_simulated(self._node.get_clock()) != self._simulated

    def start(self) -> None:
        """Start as soon as there are enough subscribers; a timer checks."""
        self._on_state(RunState.WAITING, None)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(SUBSCRIBER_POLL_S, self._start_if_ready, clock=steady)

    def _start_if_ready(self) -> None:
        if self._timer is not None and self._has_subscribers():
            self._stop_timer()
            clock = self._node.get_clock()
            self._simulated = is_simulated(clock)
            self._on_state(RunState.RUNNING, None)
            self._scheduler, self.task = TickScheduler.add_task(clock, self._rate, self._spin_ns, self._make_task)

    def _make_task(self, clock: TickClock) -> TickTask:
        return TickTask(clock, self._publications(clock), self._publish, self._on_end)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def stop(self) -> bool:
        """Stop after the present message; return whether the run had not ended yet."""
        self.stopping = True
        self._stop_timer()
        if self._scheduler is None or self.task is None:
            return True
        was_running = self.task.end()
        self._scheduler.remove_task(self.task)
        if self._end_thread is not None:
            self._end_thread.join()
        return was_running

    def _on_end(self, error: Exception | None) -> None:
        """Report the end in a thread of its own, because waiting for slow subscribers must not delay other drivers."""
        state = RunState.ENDED if error is None else RunState.FAILED
        self._end_thread = Thread(target=self._on_state, args=(state, error), name="end of run")
        self._end_thread.start()


class PaceReport:
    """Status line of a live driver: missed ticks, lateness, and steps of the wall clock, reported once a second."""

    def __init__(self, node: Node, status: Status) -> None:
        """Report on no run yet; steps of the clock go into the node's log too."""
        self._node = node
        self._status = status
        self._publisher: LivePublisher | None = None
        self.restart()

    def restart(self) -> MissedTicks:
        """Return the counts of a new run, initially zero."""
        self._missed, self._reported_ticks, self._reported_steps = MissedTicks(), 0, 0
        return self._missed

    def follow(self, publisher: LivePublisher) -> None:
        """Report on this publisher from now on."""
        self._publisher = publisher

    def report(self) -> None:
        """Update the line."""
        warnings: list[str] = []
        values: dict[str, Value] = {"ticks_missed": self._missed.ticks, "overruns": self._missed.overruns}
        if self._missed.ticks > self._reported_ticks:
            missed = self._missed.ticks - self._reported_ticks
            warnings.append(f"late: {missed} ticks missed; this host is overloaded, or the clock leapt")
            self._reported_ticks = self._missed.ticks
        task = None if self._publisher is None else self._publisher.task
        if task is not None:
            due_ns, begun_ns = task.lateness.drain()
            values |= time_statistics("lateness", begun_ns - due_ns)
            steps = task.clock.steps - task.steps_before
            values |= {"clock_steps": steps, "last_clock_step": task.clock.step_s if steps else 0.0}
            if steps > self._reported_steps:
                self._reported_steps = steps
                warnings.append(f"the wall clock was stepped by {task.clock.step_s:.6g} s, the run has restarted")
                self._node.get_logger().warning(warnings[-1])
        self._status.report(Level.WARN if warnings else Level.OK, "; ".join(warnings) or "in time", values)
