"""Topics between nodes: over DDS to other processes, straight from hand to hand within one.

An `Outlet` publishes the bytes of messages, an `Inlet` receives them. Where both ends of a topic live in one process
(in one rclpy context), the outlet calls the inlet with the very bytes that it publishes, in its own thread, and the
inlet makes no DDS subscription; it makes one as soon as no outlet of its topic is left. A node need not know which it
is: it gets the same bytes either way, and an inactive publisher hands on nothing. Where nobody has subscribed over DDS,
nothing is given to it either.

Within a process nothing is ever lost on the way or out of order, whatever the quality of service, and the publisher
goes on when the listener is done. Publishers in other processes are not heard where the same topic has an outlet here.

Both close with their node, when what it has configured is undone, if nobody destroys them before.

What a listener raises is its own failure, as in a callback of rclpy: its node asks for the end of the program with that
exception (`PosorNode.request_exit`) and hears nothing more; the publisher and the other listeners go on.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import HistoryPolicy

from posor_estimator.errors import TopicError
from posor_estimator.ros.exchange import exchange_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.qos import QoSProfile

    from posor_estimator.ros.node import PosorNode

LINGER_S = 5.0
"""How long a topic that keeps everything waits, when it is closed, for its reliable subscriptions to have it.

Longer than Fast DDS takes by itself to ask them, 3 s."""
LOOK_S = 2e-3
"""Time between two looks at whether they have."""
PATIENCE_S = 60.0
"""How long a subscription may make a publisher wait that keeps everything; one that has died is forgotten sooner."""


class Outlet:
    """A publisher of serialised messages, silent while its node is not active."""

    def __init__(
        self,
        node: PosorNode[Any],
        message_type: type[Any],
        topic: str,
        qos: QoSProfile,
        *,
        on_count: Callable[[int], None] | None = None,
        given_up: Callable[[], bool] = lambda: False,
    ) -> None:
        """Make the publisher.

        Args:
            node: Whose topic it is.
            message_type: Class of its messages.
            topic: Its name, as the node knows it.
            qos: For the publisher.
            on_count: Told the number of listeners whenever it changes, in any thread.
            given_up: Asked while a subscription makes ``publish`` wait: whether to wait no longer.

        Raises:
            TopicError: An inlet or outlet of this process knows the topic by another type.

        """
        self.topic_name: str = node.resolve_topic_name(topic)
        self.message_type = message_type
        self._node = node
        self._on_count = on_count
        self._given_up = given_up
        self._subscriptions = 0
        self._keeps_all = qos.history == HistoryPolicy.KEEP_ALL
        self._inlets: tuple[Inlet, ...] = ()
        self._exchange = exchange_of(node.context)
        self._exchange.check(self)
        events = None if on_count is None else PublisherEventCallbacks(matched=self._matched)
        self._publisher = node.create_publisher(message_type, topic, qos, event_callbacks=events)
        self._handle = self._publisher.handle
        # Entered once for all: rclpy enters and leaves it in every call, which costs more than the call.
        self._in_use = ExitStack()
        self._in_use.enter_context(self._handle)
        self._exchange.add_outlet(self)
        self._is_open = True
        node.when_cleaned_up(self.destroy)

    @property
    def count(self) -> int:
        """How many listeners the topic has: subscriptions over DDS and inlets of this process."""
        return int(self._handle.get_subscription_count()) + len(self._inlets)

    @property
    def is_wanted(self) -> bool:
        """Whether anybody listens: else a message need not be made."""
        return bool(self._inlets) or bool(self._handle.get_subscription_count())

    def publish(self, data: bytes) -> bool:
        """Hand a serialised message to the inlets of this process, then send it to all others.

        Returns:
            Whether it is on its way to all who listen.

        Raises:
            TopicError: A subscription makes us wait for too long.

        """
        if not self._node.may_publish:
            return False
        for inlet in self._inlets:
            inlet.take(data)
        return not self._handle.get_subscription_count() or self._send(data)

    def _send(self, data: bytes) -> bool:
        """Send over DDS; where everything is kept, a full history means that a subscription makes us wait."""
        waiting_since = None
        while waiting_since is None or not self._given_up():
            try:
                self._handle.publish_raw(data)
            except RuntimeError:
                if not self._keeps_all:
                    raise
                waiting_since = waiting_since or time.monotonic()
                if time.monotonic() - waiting_since > PATIENCE_S:
                    raise TopicError(
                        f"a subscription has taken nothing for {PATIENCE_S:g} s",
                        where=f"topic {self.topic_name}",
                        expected="one that keeps up, or a qos_depth other than 0",
                    ) from None
                if not self._node.may_publish:
                    return False
            else:
                return True
        return False

    def deliver(self, within_s: float, given_up: Callable[[], bool] = lambda: False) -> bool:
        """Wait until every reliable subscription over DDS has all messages; return whether they have.

        Other threads go on meanwhile; rclpy's own way to wait would hold them all up.

        Args:
            within_s: How long to wait at most [s].
            given_up: Asked again and again: whether to wait no longer.

        """
        deadline = time.monotonic() + within_s
        while not self._publisher.wait_for_all_acked(Duration()):
            if given_up() or time.monotonic() > deadline:
                return False
            time.sleep(LOOK_S)
        return True

    def destroy(self) -> None:
        """Close the topic; inlets of this process then listen to other processes.

        Where everything is kept, messages that are still on their way to reliable subscriptions are waited for.
        """
        if not self._is_open:
            return
        self._is_open = False
        self._exchange.remove_outlet(self)
        if self._keeps_all and not self.deliver(LINGER_S):
            self._node.get_logger().warning(f"not all messages of {self.topic_name} were received")
        self._in_use.close()
        self._node.destroy_publisher(self._publisher)

    def connect(self, inlets: tuple[Inlet, ...]) -> None:
        """Take these for the inlets from now on."""
        if inlets != self._inlets:
            self._inlets = inlets
            self._tell()

    def _matched(self, event: Any) -> None:
        self._subscriptions = event.current_count
        self._tell()

    def _tell(self) -> None:
        if self._on_count is not None:
            self._on_count(self._subscriptions + len(self._inlets))


class Inlet:
    """A subscription that receives serialised messages, be they from this process or from another."""

    def __init__(
        self,
        node: PosorNode[Any],
        message_type: type[Any],
        topic: str,
        qos: QoSProfile,
        callback: Callable[[bytes], None],
    ) -> None:
        """Subscribe.

        Args:
            node: Who listens.
            message_type: Class of the messages.
            topic: Name of the topic, as the node knows it.
            qos: For the subscription, where there is need of one.
            callback: Called with each message: by the executor, or in the thread of a publisher of this process.

        Raises:
            TopicError: An inlet or outlet of this process knows the topic by another type.

        """
        self.topic_name: str = node.resolve_topic_name(topic)
        self.message_type = message_type
        self._node = node
        self._topic = topic
        self._qos = qos
        self._callback = callback
        self._subscription: Any = None
        self._deaf = False
        self._exchange = exchange_of(node.context)
        self._exchange.check(self)
        self._exchange.add_inlet(self)
        node.when_cleaned_up(self.destroy)

    def has_publisher(self) -> bool:
        """Return whether anybody publishes the topic."""
        return self._subscription is None or self._node.count_publishers(self.topic_name) > 0

    def take(self, data: bytes) -> None:
        """Receive a message from an outlet of this process."""
        if self._deaf:
            return
        try:
            self._callback(data)
        except Exception as error:  # noqa: BLE001  it ends the program, from the main thread
            self._deaf = True
            self._node.request_exit(error)

    def listen(self, *, over_dds: bool) -> None:
        """Open the DDS subscription, or close it."""
        if over_dds and self._subscription is None:
            self._subscription = self._node.create_subscription(
                self.message_type, self._topic, self._callback, self._qos, raw=True
            )
        elif not over_dds and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def destroy(self) -> None:
        """Hear nothing any more, not even from a publisher that is about to."""
        self._deaf = True
        self._exchange.remove_inlet(self)
        self.listen(over_dds=False)
