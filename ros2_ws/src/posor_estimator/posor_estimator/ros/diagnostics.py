"""The node's state of health on ``/diagnostics``: once a second, and soon after a level or a message has changed.

Who reports goes on at once: what it said is put into a message by the executor's thread, between the ticks of this
process, ten times a second at most. Changes that come faster wait for one another, a few of them; beyond that the least
bad are left out. So a state that lasts for one scan is seen, and one that comes and goes at every scan costs no more.
"""

from __future__ import annotations

from enum import Enum
from threading import RLock
from time import monotonic
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC, RELIABLE_QOS
from posor_estimator.ros.turns import between_ticks

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

PERIOD_S = 1.0
LEAST_S = 0.1
"""Least time between two publications because of changes."""
MOST_WAITING = 4
"""Changes of a line that wait to be published, with the one that holds; of more, the worst."""
LASTING_S = 2.0
"""How long a line must have told errors only before one goes into the log."""


class Level(Enum):
    """Severity of a status."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR
    STALE = DiagnosticStatus.STALE


BADNESS = {Level.OK: 0, Level.STALE: 0, Level.WARN: 1, Level.ERROR: 2}
"""Which of two levels is worse; that there is nothing yet is no fault."""

Value = str | bool | int | float


Words = tuple[str, "Mapping[str, Value]"]
"""A message and values that go with it."""


class Said:
    """What a line of the diagnostics says; what is told by a function is put into words when it is asked for.

    Attributes:
        level: Its level.

    """

    __slots__ = ("_message", "_values", "_words", "level")

    def __init__(self, level: Level, message: str, values: dict[str, Value], words: Callable[[], Words] | None) -> None:
        self.level = level
        self._message = message
        self._values = values
        self._words = words

    @property
    def message(self) -> str:
        """The message."""
        self._tell()
        return self._message

    @property
    def values(self) -> dict[str, Value]:
        """The values by name."""
        self._tell()
        return self._values

    def is_that(self, level: Level, message: str) -> bool:
        """Return whether it is this level and message, as far as that is in words yet."""
        return self._words is None and (level, message) == (self.level, self._message)

    def followed(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return the values that were there without words, updated."""
        return {**self._values, **values}

    def _tell(self) -> None:
        if self._words is not None:
            self._message, values = self._words()
            self._values.update(values)
            self._words = None

    def to_message(self, name: str, hardware_id: str) -> DiagnosticStatus:
        """Return the line as ROS sends it."""
        values = [KeyValue(key=key, value=_text(value)) for key, value in self.values.copy().items()]
        return DiagnosticStatus(
            level=self.level.value, name=name, message=self.message, hardware_id=hardware_id, values=values
        )


class Status:
    """One line of the diagnostics: level, message and values. May be set from any thread."""

    def __init__(self, name: str, changed: Callable[[], None], now_s: Callable[[], float], lock: RLock) -> None:
        self.name = name
        self._said = Said(Level.STALE, "no report yet", {}, None)
        self._waiting: list[Said] = []
        self._changed = changed
        self._now_s = now_s
        self._lock = lock

    @property
    def level(self) -> Level:
        """The present level."""
        return self._said.level

    @property
    def message(self) -> str:
        """The present message."""
        return self._said.message

    def report(self, level: Level, message: str, values: Mapping[str, Value] | None = None) -> None:
        """Set level and message, update ``values``; published soon where level or message are new.

        The value ``since`` is the ROS time [s] from which the present level and message hold.
        """
        with self._lock:
            if self._said.is_that(level, message):
                self._said.values.update(values or {})
            else:
                self._say(level, message, values or {}, None)

    def report_news(self, level: Level, words: Callable[[], Words]) -> None:
        """Set level, and a message and values that are put into words later, in another thread: published soon."""
        with self._lock:
            self._say(level, "", {}, words)

    def _say(self, level: Level, message: str, values: Mapping[str, Value], words: Callable[[], Words] | None) -> None:
        since = {**values, "since": f"{self._now_s():.3f}"}
        self._said = Said(level, message, self._said.followed(since), words)
        self._waiting.append(self._said)
        if len(self._waiting) > MOST_WAITING:
            self._waiting.remove(min(self._waiting[:-1], key=lambda said: BADNESS[said.level]))
        self._changed()

    def update(self, values: Mapping[str, Value]) -> None:
        """Update values only; they go out with the next publication."""
        with self._lock:
            self._said.values.update(values)

    def take(self) -> tuple[Said, bool]:
        """Return what is to be published next, and whether more waits."""
        with self._lock:
            said = self._waiting.pop(0) if self._waiting else self._said
            return said, bool(self._waiting)


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
        self._logged: dict[Status, Log] = {}
        self._refreshers: list[Callable[[], None]] = []
        self._lock = RLock()
        self._asked = self._closed = False
        self._sent_s = -LEAST_S
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS_TOPIC, RELIABLE_QOS)
        self._timer = node.create_timer(PERIOD_S, self._tick, clock=self._steady)
        self._later: Any = None

    def add(self, name: str, *, logged: bool = False) -> Status:
        """Add a status line; it is published once it has been reported.

        Args:
            name: Of the line.
            logged: Whether errors that last, and that they are over, go into the log too.

        """
        with self._lock:
            status = Status(name, self._changed, self._now_s, self._lock)
            self._statuses.append(status)
            if logged:
                self._logged[status] = Log(self._node, name)
        return status

    def before_each(self, refresh: Callable[[], None]) -> None:
        """Have ``refresh`` called before each periodic publication, to update values such as rates."""
        self._refreshers.append(refresh)

    def close(self) -> None:
        """Publish what has not been said yet, and nothing any more."""
        with self._lock:
            while self._asked:
                self._asked = False
                self._publish()
            self._closed = True

    def _now_s(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _changed(self) -> None:
        """Have what is new published soon: by the executor, or at once where the node has none."""
        if self._asked or self._closed:
            return
        executor = self._node.executor
        if executor is None:
            self._publish()
        else:
            self._asked = True
            executor.create_task(self._soon)

    def _soon(self) -> None:
        """Publish what is new once the least time has gone by since the last publication."""
        if not self._asked or self._closed or self._later is not None:
            return
        left_s = self._sent_s + LEAST_S - monotonic()
        if left_s > 0.0:
            self._later = self._node.create_timer(left_s, self._at_last, clock=self._steady)
            return
        between_ticks()
        self._publish()

    def _at_last(self) -> None:
        self._node.destroy_timer(self._later)
        self._later = None
        self._soon()

    def _tick(self) -> None:
        for refresh in self._refreshers:
            between_ticks()
            refresh()
        between_ticks()
        self._publish()

    def _publish(self) -> None:
        """Publish what is next of each line; where more waits, have it published too."""
        with self._lock:
            self._asked = False
            told = [(status, *status.take()) for status in self._statuses]
        name = self._node.get_fully_qualified_name()
        message = DiagnosticArray(
            status=[said.to_message(f"{name}: {status.name}", self._hardware_id) for status, said, _ in told]
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._sent_s = monotonic()
        for status, said, _ in told:
            if status in self._logged:
                self._logged[status].note(said)
        if any(more for _, _, more in told):
            with self._lock:
                self._changed()


class Log:
    """Puts it into the log where a line's errors last, and when they are over; one bad scan does not get there."""

    def __init__(self, node: Node, name: str) -> None:
        """Begin without an error."""
        self._node = node
        self._name = name
        self._bad_since_s: float | None = None
        self._logged = False

    def note(self, said: Said) -> None:
        """Take note of what is published."""
        now_s = monotonic()
        if said.level is not Level.ERROR:
            if self._logged:
                self._node.get_logger().info(f"{self._name}: {said.message}")
            self._bad_since_s, self._logged = None, False
        elif self._bad_since_s is None:
            self._bad_since_s = now_s
        elif not self._logged and now_s - self._bad_since_s >= LASTING_S:
            reason = said.values.get("reason") or ""
            self._node.get_logger().error(f"{self._name}: {said.message}{reason and '; '}{reason}")
            self._logged = True
