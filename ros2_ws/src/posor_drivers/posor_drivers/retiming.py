"""Stamps and scan numbers of a replay that loops or that is moved to the present."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from posor_estimator.errors import BagError
from posor_estimator.ros.qos import RAW_TOPIC
from rclpy.serialization import deserialize_message

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_drivers.sources.base import SourceMessage

NS = 1_000_000_000


@dataclass
class Extent:
    """First, last and number of the values seen."""

    first: int = 0
    last: int = 0
    count: int = 0

    def see(self, value: int) -> None:
        """Take one more value."""
        if not self.count:
            self.first = value
        self.last = value
        self.count += 1

    @property
    def span(self) -> int:
        """Distance from the first to the last value."""
        return self.last - self.first

    @property
    def period(self) -> int:
        """Mean distance of neighbours [ns]; one second where there is only one value."""
        return round(self.span / (self.count - 1)) if self.count > 1 else NS


@dataclass
class Retiming:
    """Rewrites stamps and scan numbers.

    In pass n of a loop, stamps are later by n times the record's length (one mean scan period included), and scan
    numbers greater by n times the record's span, so that whoever listens sees one long record. Re-stamping then puts
    the first stamp at ``now_ns`` and divides the distances between stamps by ``speed``.
    What needs no change keeps its recorded bytes.
    """

    classes: Mapping[str, Any]
    """Message class of each topic."""
    loop: bool
    restamp: bool
    now_ns: int
    speed: float
    turn: int = 0
    _stamps: Extent = field(default_factory=Extent)
    _scans: Extent = field(default_factory=Extent)
    _first_stamp_ns: int | None = None

    def apply(self, message: SourceMessage) -> Any:
        """Return what is to be published: the recorded bytes, or a message with a new stamp.

        Raises:
            BagError: the bytes are no message of the topic's type.

        """
        if not (self.loop or self.restamp):
            return message.data
        content = self._content(message)
        header = getattr(content, "header", None)
        if header is None:
            return message.data
        stamp_ns = header.stamp.sec * NS + header.stamp.nanosec
        if self.turn == 0 and message.topic == RAW_TOPIC:
            self._stamps.see(stamp_ns)
            self._scans.see(content.scan)
        if self.turn == 0 and not self.restamp:
            return message.data
        stamp_ns += self.turn * (self._stamps.span + self._stamps.period)
        if self.restamp:
            if self._first_stamp_ns is None:
                self._first_stamp_ns = stamp_ns
            stamp_ns = self.now_ns + round((stamp_ns - self._first_stamp_ns) / self.speed)
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NS)
        if message.topic == RAW_TOPIC:
            content.scan += self.turn * (self._scans.span + 1)
        return content

    def _content(self, message: SourceMessage) -> Any:
        try:
            return deserialize_message(message.data, self.classes[message.topic])
        except RuntimeError:
            raise BagError(
                f"the {len(message.data)} bytes recorded at {message.time_ns} ns cannot be decoded",
                where=f"topic {message.topic}",
            ) from None
