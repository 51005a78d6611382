"""Plays everything around one node: publishes its inputs, receives its answers, acknowledges its faults."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from posor_ros.lifecycle_node import LISTENERS_STATUS
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.task import Future
from std_srvs.srv import Trigger

from posor_lab.harness.graph import RETRY_S
from posor_lab.reports.graph_receiver import GraphReceiver

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_lab.reports.graph_receiver import GraphWatch

Topic = tuple[type[Any], str]
"""Type and name of a topic."""


class NodePlayer(GraphReceiver):
    """Publishes to all topics of a node and keeps its serialised answers.

    Attributes:
        inputs: Publishers, in the order of the topics.
        answers: Answers so far.

    """

    def __init__(self, node: str, inputs: Sequence[Topic], answer: Topic) -> None:
        """Open the topics.

        Args:
            node: Full name of the node, such as ``/arm/chain_node``.
            inputs: Type and name of the topics it subscribes to, within its namespace.
            answer: Type and name of the topic with its answers, likewise.

        """
        super().__init__("player")
        namespace = node.rpartition("/")[0]
        self._node, self._answer = node, answer[1]
        self.answers: list[bytes] = []
        self.inputs = [self.create_publisher(kind, f"{namespace}/{topic}", KEEP_ALL_QOS) for kind, topic in inputs]
        self.create_subscription(answer[0], f"{namespace}/{self._answer}", self._on_answer, KEEP_ALL_QOS, raw=True)
        self._operator = self.create_client(Trigger, f"{node}/acknowledge")

    def _on_answer(self, data: bytes) -> None:
        self.received += 1
        self.answers.append(data)

    def is_ready(self) -> bool:
        """Return whether all inputs will be answered: the node is active, and each publisher has matched.

        An inactive node answers nothing, and an answer is not sent to a subscription that the node has not discovered.
        """
        listeners = self.status_value(f"{self._node}: {LISTENERS_STATUS}", self._answer)
        is_active = self.status_value(f"{self._node}: lifecycle", "message") == "active"
        return is_active and listeners == "1" and all(each.get_subscription_count() for each in self.inputs)

    def acknowledge(self, watch: GraphWatch) -> None:
        """Release a latched fault, as an operator does; repeat the call until there is a response.

        A service drops its response to a client that it has not discovered.
        """
        watch.wait(self._operator.service_is_ready, lambda: "the service acknowledge")
        calls, next_s = list[Future](), 0.0

        def has_response() -> bool:
            nonlocal next_s
            if (now_s := time.monotonic()) >= next_s:
                calls.append(self._operator.call_async(Trigger.Request()))
                next_s = now_s + RETRY_S
            return any(call.done() for call in calls)

        watch.wait(has_response, lambda: "the response of acknowledge")
