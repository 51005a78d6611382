# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A node of the test: receives, publishes and calls services in the ROS domain of the environment."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.srv import ChangeState, GetState
from posor.estimation.forward import scans_at
from posor.messages.raw_scan import ScanTemplate
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import DARK_SUBTRACTED
from posor.numerics.stamps import NS
from posor.ros_names import DIAGNOSTICS_TOPIC
from posor_msgs.msg import RawScan
from posor_ros.message_classes import schema_of_class
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from posor_lab.harness.program import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.estimation.posor import Posor
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray

LOSSLESS = KEEP_ALL_QOS  # receives every message of a reliable publisher
RETRY_S = 10.0  # time without a response after which a service is called again
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class Graph:
    """A node with its own context, to be used as a context manager; ``diagnostics``: all statuses received."""

    def __init__(self) -> None:
        """Create the node."""
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node("test_graph", context=self._context, enable_rosout=False)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.diagnostics: list[DiagnosticStatus] = []

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Destroy the node."""
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def wait_until(
        self, condition: Callable[[], bool], what: str, meanwhile: Callable[[], object] = lambda: None
    ) -> None:
        """Receive messages and call ``meanwhile`` until ``condition`` holds."""

        def step() -> None:
            self.receive()
            meanwhile()

        wait_until(condition, what, step)

    def receive(self) -> None:
        """Execute one event, or let a short time pass."""
        self._executor.spin_once(timeout_sec=0.05)

    def collect(
        self, message_type: type[Any], topic: str, qos: QoSProfile = LOSSLESS, *, raw: bool = False
    ) -> list[Any]:
        """Subscribe; return the list to which messages are appended (bytes if ``raw``)."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos, raw=raw)
        return messages

    def publisher(
        self, message_type: type[Any], topic: str, qos: QoSProfile = LOSSLESS, *, subscriptions: int = 1
    ) -> Any:
        """Return a publisher once it has the given number of subscriptions."""
        publisher = self.node.create_publisher(message_type, topic, qos)
        self.wait_until(lambda: publisher.get_subscription_count() >= subscriptions, f"subscriptions to {topic}")
        return publisher

    def call(self, service_type: type[Any], name: str, request: Any) -> Any:
        """Call a service once it is available and return its response.

        A service that has not discovered its client yet drops the response, which cannot be observed; so a call without
        a response is repeated.
        """
        client = self.node.create_client(service_type, name)
        self.wait_until(client.service_is_ready, f"service {name}")
        calls = [client.call_async(request)]
        deadline = time.monotonic() + RETRY_S

        def call_again() -> None:
            nonlocal deadline
            if time.monotonic() > deadline:
                calls.append(client.call_async(request))
                deadline = time.monotonic() + RETRY_S

        self.wait_until(lambda: any(future.done() for future in calls), f"a response of {name}", call_again)
        self.node.destroy_client(client)
        return next(future for future in calls if future.done()).result()

    def change_state(self, node: str, transition: int) -> bool:
        """Request a transition of a lifecycle node; return whether it succeeded."""
        request = ChangeState.Request()
        request.transition.id = transition
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def state(self, node: str) -> str:
        """Return the label of a lifecycle node's state."""
        return str(self.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label)

    def watch_diagnostics(self) -> None:
        """Collect all diagnostics from now on."""

        def on_diagnostics(array: Any) -> None:
            self.diagnostics.extend(array.status)

        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, on_diagnostics, LOSSLESS)

    def latest(self, name: str) -> DiagnosticStatus | None:
        """Return the newest diagnostic status of that name, for instance ``/joint1/driver_node: source``."""
        return next((status for status in reversed(self.diagnostics) if status.name == name), None)

    def wait_for_status(self, name: str, text: str) -> DiagnosticStatus:
        """Return the newest diagnostic status of that name once its message contains ``text``."""
        self.wait_until(lambda: text in getattr(self.latest(name), "message", ""), f"'{text}' from {name}")
        return self.latest(name)


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the key-value pairs of a diagnostic status."""
    return {pair.key: pair.value for pair in status.values}


def wait_for_value(graph: Graph, name: str, key: str, text: str) -> DiagnosticStatus:
    """Return the newest status of that name once its value ``key`` contains ``text``."""

    def has_value() -> bool:
        latest = graph.latest(name)
        return latest is not None and text in values_of(latest).get(key, "")

    graph.wait_until(has_value, f"'{text}' in {key} of {name}")
    return graph.latest(name)


def scan_message(scan: Scan) -> Any:
    """Return a scan of one sample as its message."""
    message = RawScan(scan=scan.number, samples=1, status=scan.status & DARK_SUBTRACTED)
    for name in ("supply_voltage", "temperature", "reference_voltage"):
        setattr(message, name, getattr(scan, name))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(scan.stamp_ns, NS)
    message.header.frame_id = "receiving"
    message.gap_voltages, message.ring_voltages = scan.gap_voltages, scan.ring_voltages
    message.diode_currents, message.lit_sources = scan.diode_currents.ravel(), list(scan.lit_sources)
    return message


def scan_templates(posor: Posor, thetas: FloatArray, seed: int) -> list[ScanTemplate]:
    """Return noisy scans of a joint whose gap is 0.7 mm, one at each theta [rad], without stamps and numbers."""
    count, serialize = len(thetas), schema_of_class(RawScan).serialize
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
    places, stamps_ns = np.tile([0.0, 0.0, 0.7e-3], (count, 1)), np.zeros(count, dtype=np.int64)
    scans = scans_at(posor.stack, rotations, places, stamps_ns, noise=np.random.default_rng(seed))
    return [ScanTemplate(serialize(scan_message(scans[n]))) for n in range(count)]


def set_stamp(message: Any, seconds: int) -> Any:
    """Set the stamp of a message to a quarter of a second after ``seconds``; return the message."""
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, 250_000_000
    return message


def stamp_seconds(messages: list[Any]) -> list[int]:
    """Return the whole seconds of the messages' stamps."""
    return [message.header.stamp.sec for message in messages]
