"""Records topics into a bag: discovers them, takes their messages, writes from a thread of its own."""

from __future__ import annotations

from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING

from posor_estimator.errors import BagError, PosorError
from posor_estimator.ros.diagnostics import Diagnostics, Level
from posor_estimator.ros.message_types import MessageTypes
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from posor_drivers.offered_qos import kept_in_bag
from posor_drivers.recorded_topic import RecordedTopic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_drivers.bag_writer import BagWriter

DISCOVERY_PERIOD_S = 0.1
TAKE_PERIOD_S = 0.005


class _WritingThread(Thread):
    """Does its tasks in order; stores the error that stops it."""

    def __init__(self) -> None:
        super().__init__(name="bag writer")
        self.tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self.failure: PosorError | None = None

    def run(self) -> None:
        try:
            for task in iter(self.tasks.get, None):
                task()
        except PosorError as error:
            self.failure = error

    def finish(self) -> None:
        """Do what is left and end."""
        self.tasks.put(None)
        self.join()


class Recorder(Node):
    """Node that records what is published.

    Attributes:
        topics: The recorded topics by name.

    """

    def __init__(self, writer: BagWriter, names: Sequence[str], announce: Callable[[str], None]) -> None:
        """Start recording.

        Args:
            writer: The bag; from now on it belongs to the recorder's thread, until ``finish`` has returned.
            names: Topics to record; empty: all that appear, hidden ones excepted.
            announce: Called with one line for every topic that is found, and once when all named topics are connected.

        """
        super().__init__("recorder", enable_rosout=False)
        self._tap = Node("_recorder_tap", enable_rosout=False, start_parameter_services=False)
        self.topics: dict[str, RecordedTopic] = {}
        self._writer = writer
        self._names = [self.resolve_topic_name(name) for name in names]
        self._announce = announce
        self._ready = False
        self._types = MessageTypes()
        self._skipped: set[str] = set()
        self._refused: dict[str, str] = {}
        self._failure: PosorError | None = None
        self._thread = _WritingThread()
        self._thread.start()
        diagnostics = Diagnostics(self)
        self._status = diagnostics.add("recording")
        self._status.report(Level.OK, "waiting for topics", {"bag": str(writer.path)})
        diagnostics.before_each(self._refresh)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._discovery_timer = self.create_timer(DISCOVERY_PERIOD_S, self._discover, clock=steady)
        self._take_timer = self.create_timer(TAKE_PERIOD_S, self._take, clock=steady)

    @property
    def failure(self) -> PosorError | None:
        """What makes it impossible to go on, if anything."""
        return self._failure or self._thread.failure

    def finish(self) -> None:
        """Take what has already been received, write everything, end the thread and leave the graph."""
        self._take()
        self._thread.finish()
        self._tap.destroy_node()
        self.destroy_node()

    def shortcomings(self) -> list[str]:
        """Return what the bag lacks, one clause each."""
        missing = [f"topic {name} never appeared" for name in self._names if name not in self.topics]
        lost = [f"{topic.lost} messages of {topic.name} were lost" for topic in self.topics.values() if topic.lost]
        return missing + lost + list(self._refused.values())

    def _take(self) -> None:
        for topic in self.topics.values():
            for time_ns, data in topic.take():
                self._thread.tasks.put(partial(self._writer.write, topic.name, time_ns, data))

    def _discover(self) -> None:
        try:
            for name, type_names in self.get_topic_names_and_types():
                hidden = any(part.startswith("_") for part in name.split("/"))
                if name in self._names or (not self._names and not hidden and name not in self._skipped):
                    self._attend(name, type_names)
        except PosorError as error:
            self._failure = error
        if not self._ready and all(name in self.topics and self.topics[name].matched for name in self._names):
            self._ready = True
            self._status.report(Level.OK, "recording")
            self._announce(f"ready: recording {' '.join(self._names) or 'every topic'} to {self._writer.path}")

    def _attend(self, name: str, type_names: list[str]) -> None:
        """Begin to record a topic, or look after it; trouble is fatal if it was asked for by name, else only told."""
        try:
            type_name = _only_type(name, type_names)
            if name in self.topics:
                self._check_offers(self.topics[name])
            else:
                self._begin(name, type_name)
        except BagError as error:
            if self._names:
                raise
            self._skipped.add(name)
            self._announce(f"not recorded: {error}")

    def _begin(self, name: str, type_name: str) -> None:
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return
        definition = self._types.definition(type_name)
        for type_hash in {str(publisher.topic_type_hash) for publisher in publishers}:
            if type_hash not in ("INVALID", definition.type_hash):
                raise BagError(
                    f"topic {name} carries another version of {type_name}, {type_hash}", expected=definition.type_hash
                )
        offers = [publisher.qos_profile for publisher in publishers]
        profiles = [kept_in_bag(offer) for offer in offers]
        self._thread.tasks.put(partial(self._writer.add_topic, name, type_name, definition, profiles))
        self.topics[name] = RecordedTopic(self._tap, name, type_name, offers)
        self._announce(f"found {name} [{type_name}]")

    def _check_offers(self, topic: RecordedTopic) -> None:
        """Notice publishers that came later and whose messages cannot be had together with those of the first."""
        for publisher in self.get_publishers_info_by_topic(topic.name):
            if topic.name not in self._refused and topic.refuses(publisher.qos_profile):
                who = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
                self._refused[topic.name] = f"{topic.name} of {who}, best effort among reliable publishers, is missing"
                self._status.report(Level.WARN, self._refused[topic.name])

    def _refresh(self) -> None:
        lost = {f"{name} lost": topic.lost for name, topic in self.topics.items() if topic.lost}
        self._status.update({name: topic.received for name, topic in self.topics.items()} | lost)
        if lost:
            self._status.report(Level.WARN, "messages are being lost")


def _only_type(topic: str, type_names: Sequence[str]) -> str:
    if len(type_names) != 1:
        raise BagError(f"topic {topic} has several types, {', '.join(type_names)}", expected="one")
    return type_names[0]
