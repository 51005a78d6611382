# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Receives the messages of a graph, or plays all neighbours of a node, while a supervisor runs the processes."""

from __future__ import annotations

import math
import time
from collections import Counter
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, Self, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from posor.ros_names import DIAGNOSTICS_TOPIC
from posor_bringup.supervisor import ProcessError, Supervisor
from posor_msgs.srv import Acknowledge
from posor_ros.lifecycle_node import LISTENERS_STATUS
from posor_ros.node_program import SPIN_TIMEOUT_S
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from posor_lab.harness.graph import RETRY_S
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.reports.console_progress import InterruptedRunError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from posor_bringup.supervisor import ProgramCommand, RunningProgram

Topic = tuple[type[Any], str]  # type and name of a topic


MessageT = TypeVar("MessageT")

SILENCE_LIMIT_S = 60.0  # a run is given up when no message has arrived for this time
WAITING_S = 1.0  # a longer wait is shown, once in this time


class GraphReceiver(Node):
    """Stores messages by stamp, and the newest diagnostic status of each name; ``received``: messages stored."""

    def __init__(self, name: str) -> None:
        """Subscribe to the diagnostics; ``store_topic`` adds topics."""
        super().__init__(name)
        self.received = 0
        self.statuses: dict[str, DiagnosticStatus] = {}
        self._status_counts: Counter[str] = Counter()
        self.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, self._on_diagnostics, KEEP_ALL_QOS)
        # One executor for the whole life: messages that arrive between two executors are lost.
        self._executor = EventsExecutor()
        self._executor.add_node(self)

    def store_topic(self, message_type: type[MessageT], topic: str) -> dict[int, MessageT]:
        """Subscribe to a topic; return the dictionary that will hold its messages by stamp [ns]."""
        store: dict[int, MessageT] = {}
        self.create_subscription(message_type, topic, partial(self._on_message, store), KEEP_ALL_QOS)
        return store

    def receive_until(self, condition: Callable[[], bool]) -> None:
        """Receive until a condition holds; it is checked after each event and at least every ``SPIN_TIMEOUT_S``."""
        while not condition():
            self._executor.spin_once(timeout_sec=SPIN_TIMEOUT_S)

    def receive_for(self, seconds: float) -> None:
        """Receive for a time."""
        end_s = time.monotonic() + seconds
        self.receive_until(lambda: time.monotonic() >= end_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self)
        self._executor.shutdown()
        self.destroy_node()

    def _on_message(self, store: dict[int, Any], message: Any) -> None:
        self.received += 1
        store[stamp_ns(message)] = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses |= {status.name: status for status in message.status}
        self._status_counts.update(status.name for status in message.status)

    def status_value(self, status: str, key: str) -> str | None:
        """Return a value of the newest diagnostic status of a name (``/chain_node: endpoint``); None: not received.

        The key ``message`` stands for the message of the status.
        """
        newest = self.statuses.get(status)
        if newest is None:
            return None
        return {**{item.key: item.value for item in newest.values}, "message": newest.message}.get(key)

    def status_count(self, status: str) -> int:
        """Return how often a diagnostic status was received."""
        return self._status_counts[status]

    def forget_node(self, node: str) -> None:
        """Forget the diagnostics of a node that has ended, such as ``/chain_node``."""
        self.statuses = {name: status for name, status in self.statuses.items() if not name.startswith(f"{node}:")}


class GraphWatch:
    """Receives messages while the processes of the graph run; ``running``: programs of ``running_graph`` by name."""

    def __init__(
        self,
        supervisor: Supervisor,
        receiver: GraphReceiver,
        run_name: str,
        *,
        on_received: Callable[[], None] = lambda: None,
        on_waiting: Callable[[str], None] = lambda _missing: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Create the watch of a run; its name is in error messages.

        ``on_received`` is called after messages have arrived, ``on_waiting`` with the text for what is missing while a
        wait lasts; ``interrupted`` returns whether the user has interrupted the run.
        """
        self.supervisor = supervisor
        self.running: dict[str, RunningProgram] = {}
        self._receiver = receiver
        self._run_name = run_name
        self._on_received = on_received
        self._on_waiting = on_waiting
        self._interrupted = interrupted

    def wait(
        self,
        condition: Callable[[], bool],
        missing: Callable[[], str],
        limit_s: float = math.inf,
        *,
        may_be_silent: bool = False,
    ) -> None:
        """Receive until a condition holds, for ``limit_s`` at most; ``missing`` returns what is missing.

        Raises InterruptedRunError: the user interrupted the run. Raises ProcessError: a process ended with an error,
        nothing arrived for ``SILENCE_LIMIT_S``, or ``limit_s`` passed.
        """
        received, since_s = -1, time.monotonic()
        shown_s = begin_s = since_s

        def is_done() -> bool:
            nonlocal received, since_s, shown_s
            if self._interrupted():
                raise InterruptedRunError("interrupted", where=self._run_name)
            self.supervisor.check()
            if self._receiver.received != received:
                received, since_s = self._receiver.received, time.monotonic()
                self._on_received()
            if condition():
                return True
            if time.monotonic() - begin_s > limit_s:
                raise ProcessError(f"missing after {limit_s:g} s: {missing()}", where=self._run_name)
            if time.monotonic() - since_s > SILENCE_LIMIT_S and not may_be_silent:
                what = f"no message for {SILENCE_LIMIT_S:g} s, missing: {missing()}"
                raise ProcessError(what, where=self._run_name)
            if time.monotonic() - shown_s > WAITING_S:
                shown_s = time.monotonic()
                self._on_waiting(missing())
            return False

        self._receiver.receive_until(is_done)

    def call(self, kind: type[Any], name: str, request: Any) -> Any:
        """Call a service and return its response.

        A service drops its response to a client that it has not discovered, so the call is repeated.
        """
        client: Any = self._receiver.create_client(kind, name)
        self.wait(client.service_is_ready, lambda: f"the service {name}")
        calls, next_s = list[Any](), 0.0

        def has_response() -> bool:
            nonlocal next_s
            if (now_s := time.monotonic()) >= next_s:
                calls.append(client.call_async(request))
                next_s = now_s + RETRY_S
            return any(call.done() for call in calls)

        self.wait(has_response, lambda: f"the response of {name}")
        self._receiver.destroy_client(client)
        return next(call for call in calls if call.done()).result()

    def wait_for(self, seconds: float, *, may_be_silent: bool = False) -> None:
        """Receive for a time."""
        end_s = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() >= end_s, lambda: "any message", may_be_silent=may_be_silent)


@contextmanager
def running_graph(
    programs: Sequence[ProgramCommand],
    receiver: GraphReceiver,
    folder: Path,
    run_name: str,
    interrupted: Callable[[], bool] = lambda: False,
) -> Iterator[GraphWatch]:
    """Run programs, with their logs in an existing folder, and a receiver for a ``with`` block."""
    with Supervisor(folder) as supervisor, receiver:
        watch = GraphWatch(supervisor, receiver, run_name, interrupted=interrupted)
        watch.running |= {program.name: supervisor.start(program) for program in programs}
        yield watch


class NodePlayer(GraphReceiver):
    """Publishes to all topics of a node and keeps its serialised answers."""

    def __init__(self, node: str, inputs: Sequence[Topic], answer: Topic) -> None:
        """Open the topics of a node such as ``/arm/chain_node``: its inputs and its answer, within its namespace."""
        super().__init__("player")
        namespace = node.rpartition("/")[0]
        self._node, self._answer = node, answer[1]
        self.answers: list[bytes] = []  # answers so far
        # publishers, in the order of the topics
        self.inputs = [self.create_publisher(kind, f"{namespace}/{topic}", KEEP_ALL_QOS) for kind, topic in inputs]
        self.create_subscription(answer[0], f"{namespace}/{self._answer}", self._on_answer, KEEP_ALL_QOS, raw=True)

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

    def acknowledge(self, watch: GraphWatch) -> bool:
        """Release a latched fault, as an operator does; return whether the node does not refuse it."""
        request = Acknowledge.Request(caller="laboratory", reason="the fault has ended")
        return bool(watch.call(Acknowledge, f"{self._node}/acknowledge", request).success)
