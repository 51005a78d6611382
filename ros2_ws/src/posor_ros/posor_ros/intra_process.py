# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Serialised topics: intra-process delivery between nodes of one process, DDS to other processes.

Where both ends of a topic live in one rclpy context, `IntraProcessPublisher.publish` passes the published bytes to the
callback of each `IntraProcessSubscription`, in the publisher's thread, and these subscriptions do not use DDS. A group
may take the data without messages, see `DeliveryGroup.take`; other subscriptions receive them afterwards. A DDS
subscription is created as soon as the context has no publisher of the topic left. A node receives the same bytes either
way. Messages are handed to DDS only where a DDS subscription has matched.

Intra-process delivery loses and reorders nothing, whatever the quality of service; ``publish`` returns when the
callbacks are done. Publishers in other processes are ignored while this process publishes the same topic.

Subscriptions of a group receive the messages of a tick together, see ``delivery_round`` and ``arrival_collector``.

Both ends are destroyed with the cleanup of their node, unless they were destroyed before. If a callback raises, its
node requests the end of the program with that exception and receives nothing more; the publisher and other nodes
continue.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from threading import RLock
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakKeyDictionary

from posor.errors import TopicError
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import HistoryPolicy

from posor_ros.arrival_collector import ArrivalCollector
from posor_ros.delivery_round import DeliveryGroup, receive_in_round
from posor_ros.input_watch import InputWatch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.context import Context
    from rclpy.qos import QoSProfile

    from posor_ros.lifecycle_node import PosorNode


DESTROY_TIMEOUT_S = 5.0
"""How long a keep-all publisher waits for acknowledgements when it is destroyed.

Longer than Fast DDS takes by itself to request them, 3 s."""
ACK_POLL_S = 2e-3  # time between two checks of the acknowledgements
PUBLISH_TIMEOUT_S = 60.0
"""How long a full history may block a keep-all publisher. DDS drops a dead subscription sooner."""


class IntraProcessPublisher:
    """A publisher of serialised messages that is silent while its node is inactive.

    Attributes:
        taker: The first subscription of this process whose group can take what is published, see ``DeliveryGroup``.

    """

    def __init__(
        self,
        node: PosorNode[Any],
        message_type: type[Any],
        topic: str,
        qos: QoSProfile,
        *,
        count_listeners: bool = False,
    ) -> None:
        """Create the publisher of a topic, whose name is relative to the node's namespace.

        With ``count_listeners`` the node's diagnostics count the subscriptions, see `PosorNode.report_listeners`.
        Raises TopicError: this process uses the topic with another type.
        """
        self.topic_name: str = node.resolve_topic_name(topic)
        self.message_type = message_type
        self._node = node
        self._topic = topic
        self._gave_up = False
        self._dds_subscriptions = 0
        self._subscriptions: tuple[IntraProcessSubscription, ...] = ()
        self._is_read_whole_here = False
        self.taker: IntraProcessSubscription | None = None
        self._manager = IntraProcessManager.of(node.context)
        self._manager.check_type(self)
        self._count_listeners = count_listeners
        events = PublisherEventCallbacks(matched=self._on_matched) if count_listeners else None
        self._publisher = node.create_publisher(message_type, topic, qos, event_callbacks=events)
        self._keeps_all = self._publisher.qos_profile.history == HistoryPolicy.KEEP_ALL
        self._handle = self._publisher.handle
        # Entered once: rclpy enters and leaves the handle in every call, which costs more than the call itself.
        self._handle_in_use = ExitStack()
        self._handle_in_use.enter_context(self._handle)
        self._report_count()
        self._manager.add(self)
        self._is_open = True
        node.add_cleanup(self.destroy)

    @property
    def subscription_count(self) -> int:
        """Number of subscriptions, over DDS and within this process."""
        return int(self._handle.get_subscription_count()) + len(self._subscriptions)

    @property
    def has_subscriptions(self) -> bool:
        """Whether there is any subscription; else a message need not be serialised."""
        return bool(self._subscriptions) or bool(self._handle.get_subscription_count())

    @property
    def is_read_whole(self) -> bool:
        """Whether any subscription reads all parts of a message, see ``IntraProcessSubscription.reads_whole``."""
        return self._is_read_whole_here or bool(self._handle.get_subscription_count())

    def is_read_by_others(self, taker: IntraProcessSubscription | None) -> bool:
        """Return whether there is any subscription but one of this process."""
        return self._subscriptions != (taker,) or bool(self._handle.get_subscription_count())

    def note_readers(self) -> None:
        """Note which subscriptions of this process read all parts of a message, and the taker."""
        self._is_read_whole_here = any(subscription.reads_whole for subscription in self._subscriptions)
        takers = (each for each in self._subscriptions if each.group is not None and each.group.take is not None)
        self.taker = next(takers, None)

    def publish(self, data: bytes) -> bool:
        """Deliver a serialised message within this process, then publish it over DDS; return whether all received it.

        Raises TopicError: a reliable subscription has blocked the publisher for too long.
        """
        self.deliver(data)
        return self.publish_over_dds(data)

    def deliver(self, data: bytes, *, taken_by: IntraProcessSubscription | None = None) -> None:
        """Deliver a serialised message within this process; the caller then calls ``publish_over_dds``.

        ``taken_by``: subscription whose group has taken it, see ``DeliveryGroup.take``.
        """
        if self._node.may_publish:
            for subscription in self._subscriptions:
                if subscription is not taken_by:
                    subscription.receive(data)

    def publish_over_dds(self, data: bytes) -> bool:
        """Publish a message of ``deliver`` over DDS, see ``publish``; return whether all received it."""
        return self._node.may_publish and (not self._handle.get_subscription_count() or self._hand_to_dds(data))

    def _hand_to_dds(self, data: bytes) -> bool:
        """Publish over DDS; retry while the full history of a keep-all publisher blocks, until the node is to stop."""
        if self._gave_up and self._node.is_stopping():  # each attempt takes 0.1 s
            return False
        blocked_since = None
        while blocked_since is None or (self._node.may_publish and not self._node.is_stopping()):
            try:
                self._handle.publish_raw(data)
            except RuntimeError:
                if not self._keeps_all:
                    raise
                blocked_since = blocked_since or time.monotonic()
                if time.monotonic() - blocked_since > PUBLISH_TIMEOUT_S:
                    raise TopicError(
                        f"a subscription has taken nothing for {PUBLISH_TIMEOUT_S:g} s",
                        where=f"topic {self.topic_name}",
                        expected="one that keeps up, or the parameter 'lossless' false",
                    ) from None
            else:
                return True
        self._gave_up = True
        return False

    def wait_for_all_acked(self, timeout_s: float, cancelled: Callable[[], bool] = lambda: False) -> bool:
        """Wait until every reliable DDS subscription has acknowledged all messages; return whether they have.

        Other threads continue meanwhile, unlike during rclpy's own call with a timeout. ``cancelled`` is polled; true
        ends the wait.
        """
        deadline = time.monotonic() + timeout_s
        while not self._publisher.wait_for_all_acked(Duration()):
            if cancelled() or time.monotonic() > deadline:
                return False
            time.sleep(ACK_POLL_S)
        return True

    def destroy(self) -> None:
        """Close the topic; subscriptions of this process then subscribe over DDS.

        A keep-all publisher first waits for the acknowledgements of reliable subscriptions.
        """
        if not self._is_open:
            return
        self._is_open = False
        self._manager.remove(self)
        self.connect(())
        received = not self._keeps_all or self.wait_for_all_acked(DESTROY_TIMEOUT_S)
        if self._gave_up or not received:
            self._node.get_logger().warning(f"not all messages of {self.topic_name} were received")
        self._handle_in_use.close()
        self._node.destroy_publisher(self._publisher)

    def connect(self, subscriptions: tuple[IntraProcessSubscription, ...]) -> None:
        """Deliver to these subscriptions of this process from now on."""
        if subscriptions != self._subscriptions:
            self._subscriptions = subscriptions
            self.note_readers()
            self._report_count()

    def _on_matched(self, event: Any) -> None:
        self._dds_subscriptions = event.current_count
        self._report_count()

    def _report_count(self) -> None:
        if self._count_listeners:
            self._node.report_listeners(self._topic, self._dds_subscriptions + len(self._subscriptions))


class IntraProcessSubscription:
    """A subscription to serialised messages of this process or, if it has no publisher, of other processes.

    Attributes:
        node: Its node.
        group: With whom it receives in a round; None: by itself, at once.
        collector: What collects the messages of its group over DDS.
        closed: Whether it receives nothing more.
        topic_name: Full name of the topic.
        watch: Arrivals of messages.
        publishers: Number of publishers of the topic; as of the last message or call of ``find_publishers``.
        reads_whole: Whether the callback reads all parts of a message. A publisher of this process may leave out what
            no subscription reads.
        on_publishers: Called when that number has changed.

    """

    def __init__(
        self,
        node: PosorNode[Any],
        message_type: type[Any],
        topic: str,
        qos: QoSProfile,
        receiver: Callable[[bytes], None] | DeliveryGroup,
    ) -> None:
        """Subscribe to a topic, whose name is relative to the node's namespace.

        ``qos`` is of the DDS subscription, if one is needed. The executor calls ``receiver``, a callback or the one of
        a group, with each message, or a publisher of this process in its thread. Raises TopicError: this process uses
        the topic with another type.
        """
        self.node: Any = node
        self.group = receiver if isinstance(receiver, DeliveryGroup) else None
        self.closed = False
        self.topic_name: str = node.resolve_topic_name(topic)
        self.message_type = message_type
        self.watch = InputWatch(self.topic_name)
        self.publishers = 0
        self._reads_whole = True
        self.on_publishers: Callable[[], None] = lambda: None
        self._topic = topic
        self._qos = qos
        self._callback: Any = receiver  # not called of a group
        self._dds_subscription: Any = None
        self._handle: Any = None
        self._local = 0
        node.qos_overrides.options("subscription", self.topic_name)
        self._manager = IntraProcessManager.of(node.context)
        self.collector = None if self.group is None else self._manager.collector(self.group)
        if self.collector is not None:
            node.add_input_check(self.collector.check)
            node.add_cleanup(node.remove_input_check, self.collector.check)
        self._manager.check_type(self)
        self._manager.add(self)
        node.add_cleanup(self.destroy)

    @property
    def reads_whole(self) -> bool:
        """See the class."""
        return self._reads_whole

    @reads_whole.setter
    def reads_whole(self, whole: bool) -> None:
        self._reads_whole = whole
        self._manager.note_readers(self.topic_name)

    def find_publishers(self) -> None:
        """Count the publishers, also those in other processes that are ignored while this process has one."""
        if self._handle is not None:
            self._count_matched()
        else:
            with (handle := self.node.handle):  # ``Node.count_publishers`` would parse the full name each time
                self._set_publishers(max(self._local, int(handle.get_count_publishers(self.topic_name))))

    def _count_matched(self) -> None:
        """Count the publishers over DDS; takes a microsecond."""
        self._set_publishers(int(self._handle.get_publisher_count()))

    def _set_publishers(self, count: int) -> None:
        if count != self.publishers:
            self.publishers = count
            self.on_publishers()

    def receive(self, data: bytes) -> None:
        """Handle a message of a publisher of this process."""
        if self.closed:
            return
        if self.group is not None:
            receive_in_round(self, data)
            return
        self.watch.record(time.monotonic())
        self.attempt(self._callback, data)

    def attempt(self, step: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a step of the node; None: it has raised, see ``fail``."""
        try:
            return step(*arguments)
        except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
            self.fail(error)
            return None

    def fail(self, error: Exception) -> None:
        """Receive nothing more, and have the node request the end of the program with an error."""
        self.closed = True
        self.node.request_exit(error)

    def connect(self, publishers: int) -> None:
        """Receive from this number of publishers of this process or, if there is none, over DDS."""
        self._use_dds(needed=not publishers)
        self._local = publishers
        self._set_publishers(publishers)

    def _use_dds(self, *, needed: bool) -> None:
        if needed and self._handle is None:
            self._dds_subscription = self.node.create_subscription(
                self.message_type, self._topic, self._on_message, self._qos, raw=True
            )
            self._handle = self._dds_subscription.handle
            self._handle.__enter__()  # once, as for publishers
            if self.collector is not None:
                self.collector.members.add(self)
        elif not needed and self._handle is not None:
            if self.collector is not None:
                self.collector.remove(self)
            self._handle.__exit__(None, None, None)
            self._handle = None
            self.node.destroy_subscription(self._dds_subscription)

    def _on_message(self, data: bytes) -> None:
        if self._handle is not None:
            self._count_matched()
            if self.collector is not None:
                self.collector.add(self, data)
                return
            self.watch.record(time.monotonic())
            self._callback(data)

    def destroy(self) -> None:
        """Receive nothing more, not even a message that is being published."""
        self.closed = True
        self._manager.remove(self)
        self._use_dds(needed=False)


class IntraProcessManager:
    """Connects the publishers and subscriptions of one context whenever one is added or removed."""

    _managers: ClassVar[WeakKeyDictionary[Context, IntraProcessManager]] = WeakKeyDictionary()
    _managers_lock = RLock()

    def __init__(self) -> None:
        self._delivery_locks: dict[str, RLock] = {}
        self._ends: dict[str, tuple[IntraProcessPublisher | IntraProcessSubscription, ...]] = {}
        self._lock = RLock()

    @classmethod
    def of(cls, context: Context) -> IntraProcessManager:
        """Return the manager of a context."""
        with cls._managers_lock:
            return cls._managers.setdefault(context, cls())

    def delivery_lock(self, arm: str) -> RLock:
        """Return the lock of the nodes of an arm, by its namespace.

        It is held while a group of them receives, and protects what they also use in other threads. A subscription that
        blocks a lossless publisher of one arm does not stop another arm.
        """
        return self._delivery_locks.setdefault(arm.rstrip("/"), RLock())

    def collector(self, group: DeliveryGroup) -> ArrivalCollector:
        """Return what collects the messages of a group over DDS, also those of its other subscriptions."""
        ends = (end for ends in self._ends.values() for end in ends if isinstance(end, IntraProcessSubscription))
        found = (end.collector for end in ends if end.group == group and end.collector is not None)
        return next(found, None) or ArrivalCollector()

    def check_type(self, end: IntraProcessPublisher | IntraProcessSubscription) -> None:
        """Compare the message type of a new publisher or subscription with that of its topic.

        Raises TopicError: this process uses the topic with another type.
        """
        for other in self._ends.get(end.topic_name, ()):
            if other.message_type is not end.message_type:
                raise TopicError(
                    f"is of type {_type_name(end.message_type)} here",
                    where=f"topic {end.topic_name}",
                    expected=f"{_type_name(other.message_type)}, as another node of this process has it",
                )

    def add(self, end: IntraProcessPublisher | IntraProcessSubscription) -> None:
        """Connect a publisher or subscription with the opposite ends of its topic."""
        with self._lock:
            self._ends[end.topic_name] = (*self._ends.get(end.topic_name, ()), end)
            self._connect(end.topic_name)

    def remove(self, end: IntraProcessPublisher | IntraProcessSubscription) -> None:
        """Disconnect a publisher or subscription; subscriptions without a publisher then use DDS."""
        with self._lock:
            ends = self._ends.get(end.topic_name, ())
            self._ends[end.topic_name] = tuple(other for other in ends if other is not end)
            self._connect(end.topic_name)

    def note_readers(self, topic: str) -> None:
        """Have the publishers of a topic note which subscriptions read all parts of a message."""
        for end in self._ends.get(topic, ()):
            if isinstance(end, IntraProcessPublisher):
                end.note_readers()

    def _connect(self, topic: str) -> None:
        ends = self._ends[topic]
        publishers = [end for end in ends if isinstance(end, IntraProcessPublisher)]
        subscriptions = tuple(end for end in ends if isinstance(end, IntraProcessSubscription))
        for subscription in subscriptions:
            subscription.connect(len(publishers))
        for publisher in publishers:
            publisher.connect(subscriptions)


def _type_name(message_type: type[Any]) -> str:
    """Return the ROS name of a message class, for instance ``posor_msgs/msg/RawScan``."""
    package, kind, *_ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"
