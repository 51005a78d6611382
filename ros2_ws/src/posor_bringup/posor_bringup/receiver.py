"""A node that receives what a graph publishes, by stamp, and what its nodes say of themselves."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor_estimator.ros.main import WAKE_S
from posor_estimator.ros.messages import stamp_ns
from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from collections.abc import Callable

MessageT = TypeVar("MessageT")

KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For a run that loses nothing."""


class Receiver(Node):
    """Keeps messages by stamp, and the newest of each diagnostic status.

    Attributes:
        received: How many messages have been kept.

    """

    def __init__(self, name: str) -> None:
        """Receive diagnostics; ``keep`` adds topics."""
        super().__init__(name)
        self.received = 0
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._heard: Counter[str] = Counter()
        self.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, self._note, KEEP_ALL_QOS)
        # One executor for good: messages that arrive while one executor gives way to the next are never taken.
        self._executor = EventsExecutor()
        self._executor.add_node(self)

    def keep(self, kind: type[MessageT], topic: str) -> dict[int, MessageT]:
        """Subscribe to a topic; return where its messages will be, by stamp [ns]."""
        store: dict[int, MessageT] = {}
        self.create_subscription(kind, topic, partial(self._keep, store), KEEP_ALL_QOS)
        return store

    def receive_until(self, done: Callable[[], bool]) -> None:
        """Receive until ``done()``; it is asked after each event, at least every ``WAKE_S``."""
        while not done():
            self._executor.spin_once(timeout_sec=WAKE_S)

    def close(self) -> None:
        """Stop receiving."""
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()

    def _keep(self, store: dict[int, Any], message: Any) -> None:
        self.received += 1
        store[stamp_ns(message)] = message

    def _note(self, message: DiagnosticArray) -> None:
        self._statuses |= {status.name: status for status in message.status}
        self._heard.update(status.name for status in message.status)

    def value(self, status: str, key: str) -> str | None:
        """Return what a node said last in its diagnostics; None if it has not said it yet.

        Args:
            status: Name of the status, such as ``/chain_node: endpoint``.
            key: Key of the value; ``message`` for the status' message.

        """
        said = self._statuses.get(status)
        if said is None:
            return None
        return {**{item.key: item.value for item in said.values}, "message": said.message}.get(key)

    def heard(self, status: str) -> int:
        """Return how often a status has come."""
        return self._heard[status]

    def forget(self, node: str) -> None:
        """Forget what a node said of itself, such as ``/chain_node``: it is no more."""
        self._statuses = {name: said for name, said in self._statuses.items() if not name.startswith(f"{node}:")}
