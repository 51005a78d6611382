"""The node's state of health on ``/diagnostics``: once a second, and at once when a level or a message changes."""

from __future__ import annotations

from enum import Enum
from threading import RLock
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC, RELIABLE_QOS
from posor_estimator.ros.turns import between_ticks

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

PERIOD_S = 1.0


class Level(Enum):
    """Severity of a status."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


Value = str | bool | int | float


class Status:
    """One line of the diagnostics: level, message and values. May be set from any thread."""

    def __init__(self, name: str, publish: Callable[[], None], now_s: Callable[[], float], lock: RLock) -> None:
        self.name = name
        self.level = Level.STALE
        self.message = "no report yet"
        self._values: dict[str, Value] = {}
        self._publish = publish
        self._now_s = now_s
        self._lock = lock

    def report(self, level: Level, message: str, values: Mapping[str, Value] | None = None) -> None:
        """Set level and message, update ``values``; published at once when level or message are new.

        The value ``since`` is the ROS time [s] from which the present level and message hold.
        """
        with self._lock:
            changed = (level, message) != (self.level, self.message)
            self.level, self.message = level, message
            if values:
                self._values.update(values)
            if changed:
                self._values["since"] = f"{self._now_s():.3f}"
                self._publish()

    def update(self, values: Mapping[str, Value]) -> None:
        """Update values only; they go out with the next publication."""
        with self._lock:
            self._values.update(values)

    def to_message(self, prefix: str, hardware_id: str) -> DiagnosticStatus:
        """Return the status as ROS sends it."""
        return DiagnosticStatus(
            level=self.level.value,
            name=f"{prefix}: {self.name}",
            message=self.message,
            hardware_id=hardware_id,
            values=[KeyValue(key=key, value=_text(value)) for key, value in self._values.items()],
        )


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


class Diagnostics:
    """Publishes the statuses of one node.

    A steady clock sets the pace, so that a jump or a halt of the ROS clock stops no report; the ROS clock stamps them.
    """

    def __init__(self, node: Node, hardware_id: str = "") -> None:
        """Start publishing.

        Args:
            node: Node whose health it is.
            hardware_id: What the node stands for; empty: its namespace, or its name in the root namespace.

        """
        self._node = node
        self._hardware_id = hardware_id or node.get_namespace().strip("/") or node.get_name()
        self._statuses: list[Status] = []
        self._refreshers: list[Callable[[], None]] = []
        self._lock = RLock()
        self._number = 0
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
        self._timer = node.create_timer(PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def add(self, name: str) -> Status:
        """Add a status line; it is published once it has been reported."""
        with self._lock:
            status = Status(name, self._publish, self._now_s, self._lock)
            self._statuses.append(status)
        return status

    def before_each(self, refresh: Callable[[], None]) -> None:
        """Have ``refresh`` called before each periodic publication, to update values such as rates."""
        self._refreshers.append(refresh)

    def _tick(self) -> None:
        for refresh in self._refreshers:
            between_ticks()
            refresh()
        between_ticks()
        with self._lock:
            number, message = self._number, self._message()
        between_ticks()
        with self._lock:
            if number == self._number:  # else something newer has gone out meanwhile
                self._send(message)

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _publish(self) -> None:
        with self._lock:
            self._send(self._message())

    def _message(self) -> DiagnosticArray:
        name = self._node.get_fully_qualified_name()
        message = DiagnosticArray(status=[status.to_message(name, self._hardware_id) for status in self._statuses])
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def _send(self, message: DiagnosticArray) -> None:
        self._number += 1
        self._publisher.publish(message)
