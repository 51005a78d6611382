# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes a live source at ticks of the ROS clock, in the thread of the process's tick scheduler."""

from __future__ import annotations

from threading import Thread
from typing import TYPE_CHECKING, Any

from posor_ros.diagnostics import Level
from posor_ros.publication_timing import time_statistics
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from posor_drivers.ros_clock import is_simulated
from posor_drivers.tick_scheduler import SUBSCRIBER_POLL_S, MissedTicks, TickScheduler, TickTask, schedule_ticks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_ros.diagnostics import Status, Value
    from rclpy.node import Node

    from posor_drivers.ros_clock import TickClock
    from posor_drivers.sources.source import LiveSource, SourceMessage
    from posor_drivers.tick_scheduler import Pause, RunCalls


class LivePublisher:
    """Waits for subscribers, then runs a task of the tick scheduler until it is stopped or the run ends."""

    def __init__(
        self,
        node: Node,
        source: LiveSource[Any],
        spin_us: int,
        condition: Callable[[Iterator[SourceMessage | Pause]], Iterator[SourceMessage | Pause]],
        calls: RunCalls,
    ) -> None:
        """Prepare a run; ``spin_us`` is the driver's parameter, ``condition`` changes what the source yields."""
        self._node, self._source, self._condition, self._calls = node, source, condition, calls
        self._spin_ns = 1000 * spin_us
        self._scheduler: TickScheduler | None = None
        self._end_thread: Thread | None = None
        self._timer: Any = None
        self._task: TickTask | None = None
        self._simulated = False
        self._missed, self._reported_ticks, self._reported_steps = MissedTicks(), 0, 0
        self.stopping = False

    @property
    def clock_has_changed(self) -> bool:
        """Whether the node has changed between wall time and simulated time since the run started."""
        return self._task is not None and is_simulated(self._node.get_clock()) != self._simulated

    def start(self) -> None:
        """Start as soon as there are enough subscribers; a timer checks."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(SUBSCRIBER_POLL_S, self._start_if_ready, clock=steady)

    def _start_if_ready(self) -> None:
        if self._timer is not None and self._calls.has_subscribers():
            self._stop_timer()
            clock = self._node.get_clock()
            self._simulated = is_simulated(clock)
            self._calls.on_begin()
            rate = self._source.rate
            self._scheduler, self._task = TickScheduler.add_task(clock, rate, self._spin_ns, self._make_task)

    def _make_task(self, clock: TickClock) -> TickTask:
        publications = self._condition(schedule_ticks(self._source, clock, self._missed))
        return TickTask(clock, publications, self._calls.publish, self._on_end)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def stop(self) -> bool:
        """Stop after the present message; return whether the run had not ended yet."""
        self.stopping = True
        self._stop_timer()
        if self._scheduler is None or self._task is None:
            return True
        was_running = self._task.end()
        self._scheduler.remove_task(self._task)
        if self._end_thread is not None:
            self._end_thread.join()
        return was_running

    def _on_end(self, error: Exception | None) -> None:
        """Report the end in a thread of its own, because waiting for slow subscribers must not delay other drivers."""
        self._end_thread = Thread(target=self._calls.on_end, args=(error,), name="end of run")
        self._end_thread.start()

    def report_pace(self, status: Status) -> None:
        """Update the status line of missed ticks, lateness and steps of the wall clock; called once a second."""
        warnings: list[str] = []
        values: dict[str, Value] = {"ticks_missed": self._missed.ticks, "overruns": self._missed.overruns}
        if new := self._missed.ticks - self._reported_ticks:
            self._reported_ticks += new
            warnings.append(f"late: {new} ticks missed; this host is overloaded, or the clock leapt")
        if (task := self._task) is not None:
            due_ns, begun_ns = task.lateness.drain()
            values |= time_statistics("lateness", begun_ns - due_ns)
            steps = task.clock.steps - task.steps_before
            values |= {"clock_steps": steps, "last_clock_step": task.clock.step_s if steps else 0.0}
            if steps > self._reported_steps:
                self._reported_steps = steps
                warnings.append(f"the wall clock was stepped by {task.clock.step_s:.6g} s, the run has restarted")
                self._node.get_logger().warning(warnings[-1])
        status.report(Level.WARN if warnings else Level.OK, "; ".join(warnings) or "in time", values)
