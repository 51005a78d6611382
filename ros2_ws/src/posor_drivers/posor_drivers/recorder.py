# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""record: writes topics into a rosbag2 bag (MCAP) until SIGINT or SIGTERM.

Messages are stored as received, without deserialising them, and flushed twice a second. Prints ``ready: ...`` once
every named topic is connected, and at the end ``closed ...`` with the number of messages of each topic.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING

from posor.arm_names import describe_argument
from posor.bags.bag_writer import BagWriter
from posor.bags.provenance import provenance_of
from posor.errors import BagError, ParameterError, PosorError
from posor.messages.message_definitions import MessageTypes
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_ros.diagnostics import Diagnostics, Level
from posor_ros.message_classes import message_class
from posor_ros.node_program import non_ros_arguments, ros_context, spin_until
from posor_ros.polled_subscription import PolledSubscription
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_topic_name import validate_topic_name

from posor_drivers.sequence_numbers import SequenceNumbers

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Sequence

    from rclpy.topic_endpoint_info import TopicEndpointInfo

DISCOVERY_PERIOD_S = 0.1
TAKE_PERIOD_S = 0.005
FLUSH_PERIOD_S = 0.5
"""Half of the time whose messages may be lost when the recorder is killed: the other half is for a busy machine."""
DEPTH = 5000
"""Messages that a subscription holds while the process is busy: five seconds at 1 kHz, and the limit of Fast DDS."""


class RecordedTopic:
    """A subscription whose messages are taken directly, in batches, instead of by callbacks.

    That needs a tenth of the processor time, and provides each message's time of reception and sequence number. (The
    middleware's "message lost" event cannot be used to count losses: in rmw_fastrtps, taking it while messages are
    being lost blocks the process.)

    Attributes:
        received: Messages taken so far.
        lost: Messages known to be lost: gaps in the sequence numbers of the publishers.

    """

    def __init__(self, node: Node, name: str, type_name: str, offers: Sequence[QoSProfile]) -> None:
        """Subscribe on ``node``, which no executor may spin, with the strictest profile that all ``offers`` satisfy."""
        self.name = name
        self.received = 0
        self._node = node
        self._request = strictest_request(offers, DEPTH)
        self._seen: set[tuple[int, ...]] = set()  # identifiers of the publishers so far
        self._numbers = SequenceNumbers(self._count_publishers)
        self._subscription = PolledSubscription(node, message_class(type_name), name, self._request)

    @property
    def lost(self) -> int:
        """See the class."""
        return self._numbers.lost

    @property
    def matched(self) -> bool:
        """Whether a publisher is connected."""
        return self._subscription.publishers > 0

    def refuses(self, offer: QoSProfile) -> bool:
        """Return whether a publisher with this profile is incompatible with the subscription."""
        reliable = ReliabilityPolicy.RELIABLE
        return bool(self._request.reliability == reliable and offer.reliability != reliable)

    def find_publishers(self) -> list[TopicEndpointInfo]:
        """Return the present publishers, and note those that the subscription can receive."""
        found = self._node.get_publishers_info_by_topic(self.name)
        self._seen.update(tuple(each.endpoint_gid) for each in found if not self.refuses(each.qos_profile))
        return found

    def _count_publishers(self) -> int:
        """Return how many publishers the topic has had."""
        self.find_publishers()
        return len(self._seen)

    def take_messages(self) -> Iterator[tuple[int, bytes]]:
        """Yield time of reception [ns] and bytes of all messages that have arrived."""
        for data, info in self._subscription.take():
            self.received += 1
            if (number := info["publication_sequence_number"]) is not None:  # None: the middleware states none
                self._numbers.add(number)
            yield info["received_timestamp"], data


def strictest_request(offers: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest profile that every offer satisfies.

    Reliable if all publishers are, because best effort would lose messages without need; best effort if one publisher
    is, because its messages would not arrive otherwise. Transient local durability likewise.
    """
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    transient = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient else DurabilityPolicy.VOLATILE,
    )


class _WriterThread(Thread):
    """Runs its tasks in order; stores the error that stops it."""

    def __init__(self) -> None:
        super().__init__(name="bag writer")
        self.tasks: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self.failure: PosorError | None = None

    def run(self) -> None:
        try:
            for task in iter(self.tasks.get, None):
                task()
        except PosorError as error:
            self.failure = error

    def finish(self) -> None:
        """Run the remaining tasks and end."""
        self.tasks.put(None)
        self.join()


class Recorder(Node):
    """Node that discovers topics and records their messages.

    Attributes:
        topics: The recorded topics by name.

    """

    def __init__(self, writer: BagWriter, names: Sequence[str], print_line: Callable[[str], None]) -> None:
        """Start recording.

        Args:
            writer: The bag; only the recorder's thread may use it until ``finish`` has returned.
            names: Topics to record; empty: all topics except hidden ones.
            print_line: Called with a line for every topic found, and once when all named topics are connected.

        """
        super().__init__("recorder", enable_rosout=False)
        self._subscriber = Node("_recorder_tap", enable_rosout=False, start_parameter_services=False)
        self.topics: dict[str, RecordedTopic] = {}
        self._writer = writer
        self._names = [self.resolve_topic_name(name) for name in names]
        self._print_line = print_line
        self._ready = False
        self._types = MessageTypes()
        self._skipped: set[str] = set()
        self._refused: dict[str, str] = {}
        self._failure: PosorError | None = None
        self._thread = _WriterThread()
        self._thread.start()
        diagnostics = Diagnostics(self)
        self._status = diagnostics.add_status("recording")
        self._status.report(Level.OK, "waiting for topics", {"bag": str(writer.path)})
        diagnostics.add_refresh(self._refresh_diagnostics)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._discovery_timer = self.create_timer(DISCOVERY_PERIOD_S, self._discover, clock=steady)
        self._take_timer = self.create_timer(TAKE_PERIOD_S, self._take_messages, clock=steady)
        self._flush_timer = self.create_timer(FLUSH_PERIOD_S, self._flush, clock=steady)

    @property
    def failure(self) -> PosorError | None:
        """The error that ends the recording, if any."""
        return self._failure or self._thread.failure

    def finish(self) -> None:
        """Write all messages received so far, end the thread and leave the graph."""
        self._take_messages()
        self._thread.finish()
        self._subscriber.destroy_node()
        self.destroy_node()

    def shortcomings(self) -> list[str]:
        """Return what is missing in the bag, one clause each."""
        missing = [f"topic {name} never appeared" for name in self._names if name not in self.topics]
        lost = [f"{topic.lost} messages of {topic.name} were lost" for topic in self.topics.values() if topic.lost]
        return missing + lost + list(self._refused.values())

    def _take_messages(self) -> None:
        for topic in self.topics.values():
            for time_ns, data in topic.take_messages():
                self._thread.tasks.put(partial(self._writer.write, topic.name, time_ns, data))

    def _flush(self) -> None:
        self._take_messages()
        self._thread.tasks.put(self._writer.flush)

    def _discover(self) -> None:
        try:
            for name, type_names in self.get_topic_names_and_types():
                hidden = any(part.startswith("_") for part in name.split("/"))
                if name in self._names or (not self._names and not hidden and name not in self._skipped):
                    self._handle_topic(name, type_names)
        except PosorError as error:
            self._failure = error
        if not self._ready and all(name in self.topics and self.topics[name].matched for name in self._names):
            self._ready = True
            self._status.report(Level.OK, "recording")
            self._print_line(f"ready: recording {' '.join(self._names) or 'every topic'} to {self._writer.path}")

    def _handle_topic(self, name: str, type_names: list[str]) -> None:
        """Record a new topic, or check a known one. An error is fatal for named topics; others are skipped."""
        try:
            type_name = _single_type(name, type_names)
            if name in self.topics:
                self._check_offers(self.topics[name])
            else:
                self._record_topic(name, type_name)
        except BagError as error:
            if self._names:
                raise
            self._skipped.add(name)
            self._print_line(f"not recorded: {error}")

    def _record_topic(self, name: str, type_name: str) -> None:
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return
        definition = self._types.definition(type_name)
        for type_hash in {str(publisher.topic_type_hash) for publisher in publishers}:
            if type_hash not in ("INVALID", definition.type_hash):
                what = f"topic {name} carries another version of {type_name}, {type_hash}"
                raise BagError(what, expected=definition.type_hash)
        offers = [publisher.qos_profile for publisher in publishers]
        self._thread.tasks.put(partial(self._writer.add_topic, name, type_name, definition, offers))
        self.topics[name] = RecordedTopic(self._subscriber, name, type_name, offers)
        self._print_line(f"found {name} [{type_name}]")

    def _check_offers(self, topic: RecordedTopic) -> None:
        """Report later publishers that are incompatible with the subscription."""
        for publisher in topic.find_publishers():
            if topic.name not in self._refused and topic.refuses(publisher.qos_profile):
                node = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
                self._refused[topic.name] = f"{topic.name} of {node}, best effort among reliable publishers, is missing"
                self._status.report(Level.WARN, self._refused[topic.name])

    def _refresh_diagnostics(self) -> None:
        lost = {f"{name} lost": topic.lost for name, topic in self.topics.items() if topic.lost}
        self._status.update({name: topic.received for name, topic in self.topics.items()} | lost)
        if lost:
            self._status.report(Level.WARN, "messages are being lost")


def _single_type(topic: str, type_names: Sequence[str]) -> str:
    """Return the only type of a topic; refuse several."""
    if len(type_names) != 1:
        raise BagError(f"topic {topic} has several types, {', '.join(type_names)}", expected="one")
    return type_names[0]


def _parse_arguments(arguments: Sequence[str]) -> Namespace:
    parser = CommandLineParser(prog="posor record", description="Record topics into a rosbag2 bag until interrupted.")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="the bag; must not exist yet")
    text = "recorded arm, of whose calibrations, URDF and beams the bag states the hashes"
    parser.add_argument("--arm", metavar="ARM", help=f"{text}: {describe_argument()}")
    choice = parser.add_mutually_exclusive_group(required=True)
    choice.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to record")
    choice.add_argument("--all", action="store_true", help="record every topic that appears")
    options = parser.parse_args(list(arguments))
    for topic in options.topics:
        try:
            validate_topic_name(topic)
        except InvalidTopicNameException as error:
            reason = str(error).split(":")[1].split("\n")[0].strip()
            raise ParameterError(f"'{topic}' is not a topic name, {reason}", where="record") from None
    return options


def _custom_data(arm: str | None) -> dict[str, str]:
    """Return the version of the software, and the hashes of the files of an arm."""
    if arm is None:
        return provenance_of(None)
    from posor.bags.reprocess_task import Settings  # noqa: PLC0415  pinocchio: 50 MB, for this option only
    from posor.chain.arm_file import load_arm_file  # noqa: PLC0415

    return provenance_of(Settings.of_arm(load_arm_file(arm)))


def _record(arguments: Sequence[str]) -> None:
    print_line = partial(print, flush=True)
    with ros_context(arguments) as stop:
        options = _parse_arguments(non_ros_arguments(arguments))
        with BagWriter(options.output, _custom_data(options.arm)) as writer:
            recorder = Recorder(writer, options.topics, print_line)
            try:
                spin_until(recorder, lambda: stop.requested or recorder.failure is not None)
            finally:
                recorder.finish()
        counts = ", ".join(f"{name} {count}" for name, count in writer.counts.items()) or "no topics"
        print_line(f"closed {options.output}: {counts}")
        if recorder.failure is not None:
            raise recorder.failure
        if shortcomings := recorder.shortcomings():
            raise BagError("; ".join(shortcomings), where=str(options.output))


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the recorder as a program."""
    _record(sys.argv if arguments is None else arguments)
    return 0
