# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The newest messages on an arm: taken from DDS, or read from a bag.

Of a running arm the throttled topics are received, a few messages a second and every change, whatever the rate of the
scans. Messages stay bytes until the page is drawn.
"""

from __future__ import annotations

import time
from bisect import bisect_right
from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.bags.bag_reader import checked_type, opened_bag
from posor.bags.reprocess_task import Settings
from posor.chain.arm_file import posor_parameters
from posor.errors import ParameterError, TopicError
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor.ros_names import (
    DIAGNOSTICS_TOPIC,
    ENDPOINT_COVARIANCE_TOPIC,
    ENDPOINT_STATE,
    ENDPOINT_STATE_THROTTLE_TOPIC,
    ENDPOINT_STATE_TOPIC,
    ENDPOINT_TOPIC,
    JOINT_STATE,
    JOINT_TRANSFORM,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED,
    RAW_TOPIC,
    TRANSFORM_THROTTLE_TOPIC,
    TRANSFORM_TOPIC,
)
from posor_ros.message_classes import message_class, schema_of_class
from posor_ros.polled_subscription import PolledSubscription
from posor_ros.qos import RELIABLE_QOS, SENSOR_QOS
from rclpy.node import Node
from rclpy.qos import QoSProfile

from posor_bringup.view_recording import estimate_raw_scans

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.messages.cdr_schema import Schema

NO_VERDICT = b"none"  # differs from the bytes of every state
KEPT = 128  # messages kept of each topic; the stamp finds the messages of one scan
BLOCK_S = 10.0  # part of a bag after its position that is in memory
LEAD_S = 2.0  # time before the position of a bag from which messages are shown, such as diagnostics
DIAGNOSTICS_QOS = QoSProfile(depth=100)  # every node of the arm may report at once
STATE_QOS = QoSProfile(depth=2000)  # reliable: every change counts, and each scan may be a change
ENCODER_QOS = QoSProfile(depth=KEPT, reliability=SENSOR_QOS.reliability)  # at the rate of the drives
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
ENDPOINT_TOPICS = {
    ENDPOINT_STATE_TOPIC: ENDPOINT_STATE,
    ENDPOINT_COVARIANCE_TOPIC: POSE_WITH_COVARIANCE_STAMPED,
    ENDPOINT_TOPIC: POSE_STAMPED,
}
"""Topics that hold the endpoint and their types; a bag may lack the first ones."""


class Message(NamedTuple):
    """A serialised message."""

    arrival_s: float  # when it was taken (steady clock) or recorded [s]
    received_ns: int  # when it was received or recorded (system clock) [ns]
    stamp_ns: int  # its stamp [ns]; 0: invalid
    data: bytes  # in plain CDR


class StatusLine(NamedTuple):
    """A status of the diagnostics."""

    arrival_s: float
    level: int
    text: str


class StateChange(NamedTuple):
    """An ``endpoint/state`` that differs from the one before in more than its numbers."""

    received_ns: int  # when it was received or recorded (system clock) [ns]
    values: Mapping[str, Any]  # by path


class ArmTopics:
    """Topics that the page shows of one arm.

    Attributes:
        endpoint: Topic of the endpoint.
        transforms: Topic of each joint's transforms.
        encoders: Topic of each joint's encoder, and name of the joint in its messages (empty: they hold one position).
        types: Message type of each topic.
        false_alarms: Probability of a false alarm of each joint's test of chi-square.

    """

    def __init__(self, arm: ArmFile, endpoint: str = ENDPOINT_STATE_TOPIC, *, throttled: bool = False) -> None:
        """Name the topics; ``endpoint`` is one of ``ENDPOINT_TOPICS``; ``throttled``: those of a running arm."""
        self.endpoint = f"{arm.namespace}/{ENDPOINT_STATE_THROTTLE_TOPIC if throttled else endpoint}"
        transform = TRANSFORM_THROTTLE_TOPIC if throttled else TRANSFORM_TOPIC
        self.transforms = {joint: f"{arm.namespace}/{joint}/{transform}" for joint in arm.calibrations}
        self.encoders = {joint: _encoder(arm, joint) for joint in arm.calibrations}
        self.false_alarms = {name: joint.false_alarm for name, joint in Settings.of_arm(arm).joints.items()}
        self.types = {
            self.endpoint: ENDPOINT_TOPICS[endpoint],
            **dict.fromkeys(self.transforms.values(), JOINT_TRANSFORM),
            **{topic: JOINT_STATE for topic, _ in self.encoders.values()},
            DIAGNOSTICS_TOPIC: DIAGNOSTIC_ARRAY,
        }


def _encoder(arm: ArmFile, joint: str) -> tuple[str, str]:
    """Return topic and name of a joint's encoder, by the parameters of its posor_node, or of the simulated arm."""
    parameters = posor_parameters(arm, joint, checked=False)
    if not parameters.get("encoder.sigma"):
        return f"{arm.namespace}/encoders", joint
    topic = str(parameters.get("encoder.topic", "encoder"))
    return topic if topic.startswith("/") else f"{arm.namespace}/{joint}/{topic}", str(
        parameters.get("encoder.joint", "")
    )


class MessageStore:
    """The newest messages of each topic.

    Attributes:
        since_s: When it began to receive (steady clock) [s]; None: it holds a part of a bag.
        statuses: Newest diagnostic status of the arm's nodes, by its name.
        refused: Why the last invalid message was refused; empty: there was none.

    """

    def __init__(self, namespace: str, types: Mapping[str, str]) -> None:
        self._prefix = f"{namespace}/"
        self._schemas = {topic: schema_of_class(message_class(name)) for topic, name in types.items()}
        self._messages: dict[str, deque[Message]] = {topic: deque(maxlen=KEPT) for topic in types}
        self.since_s: float | None = None
        self.statuses: dict[str, StatusLine] = {}
        self.refused = ""
        self._changes: list[StateChange] = []
        self._verdict, self._end_of_verdict = NO_VERDICT, 0

    def clear(self, since_s: float | None = None) -> None:
        """Forget all messages; see ``since_s``."""
        self.since_s = since_s
        for messages in self._messages.values():
            messages.clear()
        self.statuses.clear()
        self.refused = ""
        self._verdict, self._end_of_verdict = NO_VERDICT, 0

    def add(self, topic: str, arrival_s: float, received_ns: int, data: bytes) -> None:
        """Keep a message; of diagnostics only the statuses of the arm's nodes."""
        try:
            data = self._schemas[topic].normal(data)
            if topic == DIAGNOSTICS_TOPIC:
                for status in _decode(self._schemas[topic], data)["status"]:
                    if status["name"].startswith(self._prefix):
                        level = int.from_bytes(status["level"], "little")
                        self.statuses[status["name"]] = StatusLine(arrival_s, level, status["message"])
                return
        except TopicError as error:
            self.refused = f"{topic}: {error}"
            return
        stamp_ns = stamp_ns_of(data[STAMP]) if len(data) >= STAMP.stop else 0
        message = Message(arrival_s, received_ns, stamp_ns, data)
        self._messages[topic].append(message)
        if "age" in self._schemas[topic].by_path and data[STAMP.stop : self._end_of_verdict] != self._verdict:
            self._note_change(topic, message)

    def _note_change(self, topic: str, message: Message) -> None:
        """Keep a state whose bytes between stamp and age differ from those of the state before."""
        values = self.values(topic, message)
        if values is not None:
            self._end_of_verdict = self._schemas[topic].layout(message.data)["age"].offset
            self._verdict = message.data[STAMP.stop : self._end_of_verdict]
            self._changes.append(StateChange(message.received_ns, values))

    def take_changes(self) -> list[StateChange]:
        """Return the changes of the endpoint's state since the last call."""
        changes, self._changes = self._changes, []
        return changes

    def messages(self, topic: str) -> deque[Message]:
        """Return the newest messages of a topic, in the order of their arrival."""
        return self._messages[topic]

    def values(self, topic: str, message: Message) -> Mapping[str, Any] | None:
        """Return the values of a message by path; None: it is invalid, and then ``refused`` says why."""
        try:
            return _decode(self._schemas[topic], message.data)
        except TopicError as error:
            self.refused = f"{topic}: {error}"
            return None


@lru_cache(maxsize=64)
def _decode(schema: Schema, data: bytes) -> Mapping[str, Any]:
    return schema.values(data)


class LiveTopics:
    """Subscriptions to the topics of a running arm, in a node that no executor spins.

    Between two calls of ``take`` DDS keeps the last messages of each topic: of ``endpoint/state_throttle`` 2000.
    """

    def __init__(self, store: MessageStore, topics: ArmTopics) -> None:
        self._store, self._topics = store, topics
        self._node = Node("view", enable_rosout=False, start_parameter_services=False)
        self._subscriptions: list[PolledSubscription] = []
        self._store.clear(time.monotonic())
        special = {DIAGNOSTICS_TOPIC: DIAGNOSTICS_QOS, self._topics.endpoint: STATE_QOS}
        special |= {topic: ENCODER_QOS for topic, _ in self._topics.encoders.values()}
        for topic, name in self._topics.types.items():
            qos = special.get(topic, RELIABLE_QOS)
            self._subscriptions.append(PolledSubscription(self._node, message_class(name), topic, qos))

    def take(self) -> float:
        """Store the messages that have arrived; return the present time (steady clock) [s]."""
        now_s = time.monotonic()
        for subscription, topic in zip(self._subscriptions, self._topics.types, strict=False):
            for data, info in subscription.take():
                self._store.add(topic, now_s, info["received_timestamp"], data)
        return now_s

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()


class BagTopics:
    """The ``topics`` of an arm in a bag from ``begin_ns`` to ``end_ns``, ``LEAD_S`` and ``BLOCK_S`` of it in memory.

    The ``store`` holds the messages up to the present position.
    """

    def __init__(self, path: Path, arm: ArmFile, folder: Path) -> None:
        """Check the topics and go to the beginning.

        A bag with raw scans of all joints but not all transforms and states is estimated; the result is written into a
        folder that exists. Raises BagError: the bag cannot be read, or a topic was recorded with another type;
        ParameterError: the bag holds neither the endpoint nor the raw scans of the arm; PosorError: a file of the arm
        cannot be used.
        """
        filled = _filled_topics(path)
        found = [topic for topic in ENDPOINT_TOPICS if f"{arm.namespace}/{topic}" in filled]
        topics = ArmTopics(arm, found[0] if found else ENDPOINT_STATE_TOPIC)
        raw = {f"{arm.namespace}/{joint}/{RAW_TOPIC}" for joint in arm.calibrations}
        lacks = not {f"{arm.namespace}/{ENDPOINT_STATE_TOPIC}", *topics.transforms.values()} <= filled
        if lacks and raw <= filled:
            topics = ArmTopics(arm)
            others = [topic for topic in topics.types if topic not in {topics.endpoint, *topics.transforms.values()}]
            _check_types(path, topics, others)
            path = estimate_raw_scans(path, arm, folder, others)
            filled = _filled_topics(path)
        elif not found:
            known = ", ".join(f"{arm.namespace}/{topic}" for topic in ENDPOINT_TOPICS)
            raise ParameterError(
                f"there is no endpoint of arm {arm.name}",
                where=str(path),
                expected=f"messages on one of {known}, or raw scans of all its joints",
            )
        self._path, self._namespace, self.topics = path, arm.namespace, topics
        _check_types(path, topics, topics.types)
        with opened_bag(path) as reader:
            self.begin_ns, self.end_ns = reader.start_time, reader.end_time
        self.duration_s = (self.end_ns - self.begin_ns) / NS
        self.store = MessageStore(arm.namespace, self.topics.types)
        self._loaded: list[tuple[int, str, bytes]] = []
        self._block_s = (0.0, 0.0)
        self._position_s = -1.0

    def states(self) -> Iterator[StateChange]:
        """Yield the changes of the endpoint's state from begin to end. Raises BagError: the bag is damaged."""
        store = MessageStore(self._namespace, self.topics.types)
        with opened_bag(self._path) as reader:
            selected = [connection for connection in reader.connections if connection.topic == self.topics.endpoint]
            for each, time_ns, data in reader.messages(selected):
                store.add(each.topic, 0.0, time_ns, bytes(data))
                yield from store.take_changes()

    def seek(self, position_s: float, ahead_s: float = BLOCK_S) -> None:
        """Store the messages up to a position [s] after the beginning.

        ``ahead_s``: time after the position that is read with it. Raises BagError: the bag is damaged there.
        """
        if not self._block_s[0] <= position_s <= self._block_s[1] or not self._loaded:
            self._load(position_s, ahead_s)
        if not self._position_s <= position_s < self._position_s + LEAD_S:
            self.store.clear()
            self._position_s = position_s - LEAD_S
        first, last = (
            bisect_right(self._loaded, self.begin_ns + round(each * NS), key=lambda entry: entry[0])
            for each in (self._position_s, position_s)
        )
        for time_ns, topic, data in self._loaded[first:last]:
            self.store.add(topic, (time_ns - self.begin_ns) / NS, time_ns, data)
        self._position_s = position_s

    def _load(self, position_s: float, ahead_s: float) -> None:
        """Read the messages from ``LEAD_S`` before a position to some time after it."""
        begin, end = (self.begin_ns + round((position_s + each) * NS) for each in (-LEAD_S, ahead_s))
        with opened_bag(self._path) as reader:
            selected = [connection for connection in reader.connections if connection.topic in self.topics.types]
            messages = reader.messages(selected, start=begin, stop=end + 1)
            self._loaded = [(time_ns, each.topic, bytes(data)) for each, time_ns, data in messages]
        self._block_s = position_s, position_s + ahead_s


def _filled_topics(path: Path) -> set[str]:
    with opened_bag(path) as reader:
        return {connection.topic for connection in reader.connections if connection.msgcount}


def _check_types(path: Path, topics: ArmTopics, names: Iterable[str]) -> None:
    """Check the types of some topics, where the bag has them. Raises BagError: a topic has another type or version."""
    types = MessageTypes()
    with opened_bag(path) as reader:
        connections = list(reader.connections)
        for topic in {connection.topic for connection in connections if connection.msgcount} & set(names):
            checked_type(connections, topic, str(path), types, (topics.types[topic],))
