# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Publishes a recorded source at the pace of its log times, in a thread of its own."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from posor.errors import BagError, ParameterError
from posor.numerics.stamps import NS
from posor.ros_names import RAW_TOPIC
from rclpy.serialization import deserialize_message

from posor_drivers.sources.source import SourceMessage
from posor_drivers.tick_scheduler import SUBSCRIBER_POLL_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from posor_drivers.driver_parameters import ReplayParameters
    from posor_drivers.sources.source import RecordedSource
    from posor_drivers.tick_scheduler import RunCalls


@dataclass
class Extent:
    """First value, last value, least step upward and number of values of a series."""

    first: int = 0
    last: int = 0
    step: int = 0
    count: int = 0

    def add(self, value: int) -> None:
        """Add the next value."""
        if not self.count:
            self.first = value
        elif value > self.last:
            self.step = min(self.step or value - self.last, value - self.last)
        self.last = value
        self.count += 1

    @property
    def span(self) -> int:
        """Difference of the last and the first value."""
        return self.last - self.first

    @property
    def period(self) -> int:
        """Mean difference of neighbours [ns]; one second for a single value."""
        return round(self.span / (self.count - 1)) if self.count > 1 else NS


@dataclass
class StampRewriter:
    """Rewrites stamps and scan numbers of a replay that loops or is moved to the present.

    In pass n of a loop, stamps are later by n times the record's length and scan numbers greater by n times its span,
    one usual step included, so subscribers see one long record. The time of a step follows from the numbers: it is the
    same for all joints of an arm, whichever scans each lacks. Restamping puts the first stamp at
    ``now_ns`` and divides the differences of stamps by ``speed``. Messages without change keep their recorded bytes.
    """

    classes: Mapping[str, Any]
    """Message class of each topic."""
    loop: bool
    restamp: bool
    now_ns: int
    speed: float
    pass_number: int = 0
    _stamps: Extent = field(default_factory=Extent)
    _scans: Extent = field(default_factory=Extent)
    _first_stamp_ns: int | None = None

    def rewrite(self, message: SourceMessage) -> Any:
        """Return what is to be published: the recorded bytes, or a message with a new stamp.

        Raises:
            BagError: The bytes are not a message of the topic's type.

        """
        if not (self.loop or self.restamp):
            return message.data
        content = self._deserialize(message)
        header = getattr(content, "header", None)
        if header is None:
            return message.data
        stamp_ns = header.stamp.sec * NS + header.stamp.nanosec
        if self.pass_number == 0 and message.topic == RAW_TOPIC:
            self._stamps.add(stamp_ns)
            self._scans.add(content.scan)
        if self.pass_number == 0 and not self.restamp:
            return message.data
        step, numbers = self._scans.step or 1, self._scans.span
        period_ns = round(self._stamps.span * step / numbers) if numbers > 0 else self._stamps.period
        stamp_ns += self.pass_number * (self._stamps.span + period_ns)
        if self.restamp:
            if self._first_stamp_ns is None:
                self._first_stamp_ns = stamp_ns
            stamp_ns = self.now_ns + round((stamp_ns - self._first_stamp_ns) / self.speed)
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NS)
        if message.topic == RAW_TOPIC:
            content.scan += self.pass_number * (numbers + step)
        return content

    def _deserialize(self, message: SourceMessage) -> Any:
        try:
            return deserialize_message(message.data, self.classes[message.topic])
        except RuntimeError:
            what = f"the {len(message.data)} bytes recorded at {message.time_ns} ns cannot be decoded"
            raise BagError(what, where=f"topic {message.topic}") from None


def schedule_replay(
    source: RecordedSource[Any], classes: Mapping[str, Any], options: ReplayParameters, now_ns: int
) -> Iterator[SourceMessage]:
    """Yield what is to be published, in order, from an open source; endless if the replay loops.

    ``classes`` are the message classes by topic, ``now_ns`` is the ROS time at the start of the replay [ns].

    Raises:
        ParameterError: No scan lies between the offsets.
        PosorError: The source cannot be read.

    """
    speed = options.rate or 1.0
    stamps = StampRewriter(classes, options.loop, options.restamp, now_ns, speed)
    length_ns = 0
    for pass_number in itertools.count():
        stamps.pass_number = pass_number
        everything, scans = Extent(), Extent()
        for message in _read_window(source, options):
            everything.add(message.time_ns)
            if message.topic == RAW_TOPIC:
                scans.add(message.time_ns)
            after_ns = pass_number * length_ns + message.time_ns - everything.first
            after_s = after_ns / NS / speed if options.rate and not source.has_own_pace else 0.0
            yield SourceMessage(message.topic, 0, stamps.rewrite(message), after_s)
        if not scans.count:
            what = f"between 'start_offset' {options.start_offset} and 'stop_offset' {options.stop_offset}"
            raise ParameterError(f"no scan lies {what}", expected="offsets within the record")
        if not options.loop:
            return
        length_ns = everything.span + scans.period


def _read_window(source: RecordedSource[Any], options: ReplayParameters) -> Iterator[SourceMessage]:
    """Yield the messages between the offsets, which count from the first message."""
    origin_ns = None
    for message in source.read_messages():
        origin_ns = message.time_ns if origin_ns is None else origin_ns
        offset_s = (message.time_ns - origin_ns) / NS
        if offset_s >= options.stop_offset:
            return
        if offset_s >= options.start_offset:
            yield message


class ReplayPublisher:
    """Waits for subscribers, then publishes each message when it is due.

    The steady clock sets the pace. A late message is published at once; none is skipped.
    """

    def __init__(self, publications: Callable[[], Iterator[SourceMessage]], calls: RunCalls) -> None:
        """Prepare a replay; ``publications`` makes the schedule when it starts, in the thread of all calls."""
        self._publications, self._calls = publications, calls
        self._ended = False
        self._stop = Event()
        self._thread = Thread(target=self._run, name="replay")

    @property
    def stopping(self) -> bool:
        """Whether ``stop`` was called."""
        return self._stop.is_set()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> bool:
        """Stop after the present message and join the thread; return whether the replay had not ended yet."""
        self._stop.set()
        self._thread.join()
        return not self._ended

    def _run(self) -> None:
        failure = None
        try:
            while not self._calls.has_subscribers():
                if self._stop.wait(SUBSCRIBER_POLL_S):
                    return
            self._calls.on_begin()
            begin = time.monotonic()
            for publication in self._publications():
                if self._stop.wait(max(0.0, begin + publication.after_s - time.monotonic())):
                    return
                self._calls.publish(publication)
        except Exception as error:  # noqa: BLE001  the main thread ends the program with it
            failure = error
        self._ended = True
        self._calls.on_end(failure)
