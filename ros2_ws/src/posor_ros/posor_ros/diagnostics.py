# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node on ``/diagnostics``: once a second, and soon after a level or a message has changed.

The reporting thread continues at once; the executor's thread formats and publishes the message between the ticks of
this process, at most ten times a second. A few faster changes are queued; beyond that the least severe ones are
dropped. A state that lasts for one scan is therefore seen, and a state that changes with every scan costs no more.
"""

from __future__ import annotations

from enum import Enum
from threading import RLock
from time import monotonic
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor.numerics.stamps import NS
from posor.ros_names import DIAGNOSTICS_TOPIC
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration

from posor_ros.idle_scheduler import run_when_idle
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import RELIABLE_QOS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

PERIOD_S = 1.0
MIN_INTERVAL_S = 0.1  # shortest time between two publications
MAX_QUEUED = 4  # queued changes of a status, the present one included; of more, the most severe
DELIVERY_S = 0.1
"""Longest wait for the subscribers of the last reports: messages that a process has not sent at its end are lost."""
LASTING_ERROR_S = 2.0  # how long a status must be an error before it is logged


class Level(Enum):
    """Severity of a status."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


SEVERITY = {Level.OK: 0, Level.STALE: 0, Level.WARN: 1, Level.ERROR: 2}
"""Order of the levels; missing data are not a fault."""

Value = str | bool | int | float
StatusText = tuple[str, "Mapping[str, Value]"]  # a message and values that belong to it


class StatusReport:
    """Level, message and values at one time. A report made of a function is formatted lazily, when it is published."""

    __slots__ = ("_formatter", "_message", "_values", "level")

    def __init__(
        self, level: Level, message: str, values: dict[str, Value], formatter: Callable[[], StatusText] | None = None
    ) -> None:
        self.level = level
        self._message = message
        self._values = values
        self._formatter = formatter

    @property
    def message(self) -> str:
        """The message."""
        self._format()
        return self._message

    @property
    def values(self) -> dict[str, Value]:
        """The values by name."""
        self._format()
        return self._values

    def equals(self, level: Level, message: str) -> bool:
        """Return whether the report has this level and message; an unformatted report equals none."""
        return self._formatter is None and (level, message) == (self.level, self._message)

    def updated_values(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return a copy of the values, without formatting, updated."""
        return {**self._values, **values}

    def _format(self) -> None:
        if self._formatter is not None:
            self._message, values = self._formatter()
            self._values.update(values)
            self._formatter = None

    def to_fields(self, name: str, hardware_id: str) -> dict[str, Any]:
        """Return the fields of a ``diagnostic_msgs/DiagnosticStatus``."""
        values = [{"key": key, "value": _value_text(value)} for key, value in self.values.copy().items()]
        return {
            "level": self.level.value,
            "name": name,
            "message": self.message,
            "hardware_id": hardware_id,
            "values": values,
        }


def _value_text(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class Status:
    """One status line of the diagnostics. May be set from any thread."""

    def __init__(self, name: str, on_change: Callable[[], None], now_s: Callable[[], float], lock: RLock) -> None:
        self.name = name
        self._report = StatusReport(Level.STALE, "no report yet", {})
        self._queue: list[StatusReport] = []
        self._on_change = on_change
        self._now_s = now_s
        self._lock = lock

    @property
    def message(self) -> str:
        """The present message."""
        return self._report.message

    def report(self, level: Level, message: str, values: Mapping[str, Value] | None = None) -> None:
        """Set level and message, and update values; a new level or message is published soon.

        The value ``since`` is the ROS time [s] since which the level and the message hold.
        """
        with self._lock:
            if self._report.equals(level, message):
                self._report.values.update(values or {})
            else:
                self._enqueue(level, message, values or {}, None)

    def report_status_change(self, level: Level, formatter: Callable[[], StatusText]) -> None:
        """Set the level, and a message and values that another thread formats later; published soon."""
        with self._lock:
            self._enqueue(level, "", {}, formatter)

    def _enqueue(
        self, level: Level, message: str, values: Mapping[str, Value], formatter: Callable[[], StatusText] | None
    ) -> None:
        values = self._report.updated_values({**values, "since": f"{self._now_s():.3f}"})
        self._report = StatusReport(level, message, values, formatter)
        self._queue.append(self._report)
        if len(self._queue) > MAX_QUEUED:
            self._queue.remove(min(self._queue[:-1], key=lambda report: SEVERITY[report.level]))
        self._on_change()

    def update(self, values: Mapping[str, Value]) -> None:
        """Update values only; they are part of the next publication."""
        with self._lock:
            self._report.values.update(values)

    def next_report(self) -> tuple[StatusReport, bool]:
        """Return the report to publish next, and whether more are queued."""
        with self._lock:
            report = self._queue.pop(0) if self._queue else self._report
            return report, bool(self._queue)


class Diagnostics:
    """Publishes the statuses of one node.

    A steady clock sets the pace, so that a step or a halt of the ROS clock stops no report; the ROS clock stamps them.
    """

    def __init__(self, node: Node, hardware_id: str = "") -> None:
        """Start publishing; without ``hardware_id`` the node's namespace, else its name, stands for the hardware."""
        self._node = node
        self._hardware_id = hardware_id or node.get_namespace().strip("/") or node.get_name()
        self._statuses: list[Status] = []
        self._error_logs: dict[Status, LastingErrorLog] = {}
        self._refreshers: list[Callable[[], None]] = []
        self._lock = RLock()
        self._scheduled = self._closed = False
        self._published_s = -MIN_INTERVAL_S
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
        self._timer = node.create_timer(PERIOD_S, self._publish_periodically, clock=self._steady_clock)
        # One timer for all delays: rclpy keeps about 300 bytes of each timer that a node has ever created.
        self._delay_timer = node.create_timer(
            MIN_INTERVAL_S, self._on_delay_passed, clock=self._steady_clock, autostart=False
        )

    def add_status(self, name: str, *, logged: bool = False) -> Status:
        """Add a status line; if it is ``logged``, lasting errors and their end are logged too."""
        with self._lock:
            status = Status(name, self._schedule, self._now_s, self._lock)
            self._statuses.append(status)
            if logged:
                self._error_logs[status] = LastingErrorLog(self._node, name)
        return status

    def add_refresh(self, refresh: Callable[[], None]) -> None:
        """Call ``refresh`` before each periodic publication, to update values such as rates."""
        self._refreshers.append(refresh)

    def close(self) -> None:
        """Publish the queued reports, and nothing more; wait until subscribers have them, at most ``DELIVERY_S``."""
        with self._lock:
            while self._scheduled:
                self._scheduled = False
                self._publish()
            self._closed = True
        self._publisher.wait_for_all_acked(Duration(seconds=DELIVERY_S))

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _schedule(self) -> None:
        """Have the executor publish a change soon; without an executor, publish at once."""
        if self._scheduled or self._closed:
            return
        executor = self._node.executor
        if executor is None:
            self._publish()
        else:
            self._scheduled = True
            executor.create_task(self._publish_scheduled)

    def _publish_scheduled(self) -> None:
        """Publish a change once the shortest interval since the last publication has passed."""
        if not self._scheduled or self._closed or not self._delay_timer.is_canceled():
            return
        left_s = self._published_s + MIN_INTERVAL_S - monotonic()
        if left_s > 0.0:
            self._delay_timer.timer_period_ns = max(1, int(left_s * NS))
            self._delay_timer.reset()
        else:
            run_when_idle(self._publish)

    def _on_delay_passed(self) -> None:
        self._delay_timer.cancel()
        self._publish_scheduled()

    def _publish_periodically(self) -> None:
        self._run_first_of([*self._refreshers, self._publish])

    def _run_first_of(self, works: list[Callable[[], None]]) -> None:
        """Run the first piece of work; the executor handles the messages that have come meanwhile before the next."""
        first, *others = works
        run_when_idle(first)
        if not others:
            return
        if (executor := self._node.executor) is None:
            self._run_first_of(others)
        else:
            executor.create_task(self._run_first_of, others)

    def _publish(self) -> None:
        with self._lock:
            self._scheduled = False
            reports = [(status, *status.next_report()) for status in self._statuses]
        name = self._node.get_fully_qualified_name()
        sec, nanosec = self._node.get_clock().now().seconds_nanoseconds()
        fields = {
            "header.stamp.sec": sec,
            "header.stamp.nanosec": nanosec,
            "status": [report.to_fields(f"{name}: {status.name}", self._hardware_id) for status, report, _ in reports],
        }
        self._publisher.publish(schema_of_class(DiagnosticArray).encode(fields))
        self._published_s = monotonic()
        for status, report, _ in reports:
            if status in self._error_logs:
                self._error_logs[status].add(report)
        if any(more for *_, more in reports):
            with self._lock:
                self._schedule()


class LastingErrorLog:
    """Logs an error of a status that lasts, and its end. The error of a single scan is not logged."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._name = name
        self._error_since_s: float | None = None
        self._logged = self._ended_by_warning = False

    def add(self, report: StatusReport) -> None:
        """Process a published report; an error that ends with a warning has ended, but the next OK is logged too."""
        now_s = monotonic()
        if report.level is not Level.ERROR:
            is_ok = report.level is Level.OK
            if self._logged or (self._ended_by_warning and is_ok):
                self._node.get_logger().info(f"{self._name}: {report.message}")
            self._ended_by_warning = not is_ok and (self._logged or self._ended_by_warning)
            self._error_since_s, self._logged = None, False
        elif self._error_since_s is None:
            self._error_since_s = now_s
        elif not self._logged and now_s - self._error_since_s >= LASTING_ERROR_S:
            reason = report.values.get("reason") or ""
            self._node.get_logger().error(f"{self._name}: {report.message}{reason and '; '}{reason}")
            self._logged = True
