# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Receives the messages of an arm's nodes, with the times of arrival."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from posor.model.fault import USABLE_STATES, Fault, State
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_STATE_TOPIC, TRANSFORM_TOPIC
from posor_msgs.msg import EndpointState, JointTransform
from posor_msgs.srv import Acknowledge
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from posor_lab.reports.graph_receiver import GraphReceiver

if TYPE_CHECKING:
    from collections.abc import Sequence

    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches reliable and best-effort publishers


@dataclass(frozen=True)
class Arrival:
    """A message and when it came."""

    time_ns: int  # system time, which is the ROS time of the nodes
    message: Any


class ArrivalReceiver(GraphReceiver):
    """Stores transforms, endpoint states and poses, and diagnostics of an arm, with their times of arrival [ns]."""

    def __init__(self, arm: str, joints: Sequence[str] = ()) -> None:
        """Subscribe to the endpoint of the arm in the namespace ``arm``, and to the transforms of ``joints``."""
        super().__init__("arrivals")
        self._arm = arm
        self.diagnostics: list[tuple[int, DiagnosticStatus]] = []
        self._types: dict[str, type[Any]] = {f"{joint}/{TRANSFORM_TOPIC}": JointTransform for joint in joints}
        self._types |= {ENDPOINT_STATE_TOPIC: EndpointState, ENDPOINT_COVARIANCE_TOPIC: PoseWithCovarianceStamped}
        self._raw: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in self._types}
        for topic, kind in self._types.items():
            callback = partial(self._on_bytes, self._raw[topic])
            self.create_subscription(kind, f"/{arm}/{topic}", callback, QOS, raw=True)
        self._operators = {
            joint: self.create_client(Acknowledge, f"/{arm}/{joint}/posor_node/acknowledge") for joint in joints
        }

    def _on_bytes(self, store: list[tuple[int, bytes]], data: bytes) -> None:
        self.received += 1
        store.append((time.time_ns(), data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        super()._on_diagnostics(message)
        now_ns = time.time_ns()
        self.diagnostics += [(now_ns, status) for status in message.status]

    def count(self, topic: str) -> int:
        """Return how many messages of a topic, relative to the arm, have come."""
        return len(self._raw[topic])

    def since(self, topic: str, count: int) -> list[Arrival]:
        """Return the messages of a topic after the first ``count`` ones; -1: the newest message."""
        return self._arrivals(topic, self._raw[topic][count:])

    def between(self, topic: str, begin_ns: int, end_ns: int) -> list[Arrival]:
        """Return the messages of a topic that came between two times [ns]."""
        return self._arrivals(topic, [each for each in self._raw[topic] if begin_ns <= each[0] < end_ns])

    def _arrivals(self, topic: str, stored: Sequence[tuple[int, bytes]]) -> list[Arrival]:
        return [Arrival(time_ns, deserialize_message(data, self._types[topic])) for time_ns, data in stored]

    def acknowledge(self, joint: str) -> None:
        """Call ``~/acknowledge`` of a joint's posor_node, without waiting for the response."""
        client = self._operators[joint]
        if client.service_is_ready():
            client.call_async(Acknowledge.Request(caller="laboratory", reason="the fault has ended"))

    def acknowledge_latched(self) -> None:
        """Acknowledge every joint whose newest transform has a latched fault."""
        for joint in self._operators:
            if any(each.message.faults & Fault.LATCHED for each in self.since(f"{joint}/{TRANSFORM_TOPIC}", -1)):
                self.acknowledge(joint)

    def endpoints_between(self, begin_ns: int, end_ns: int) -> list[Arrival]:
        """Return the endpoint states with a pose that came between two times [ns]."""
        states = self.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)
        return [each for each in states if each.message.state in USABLE_STATES]

    def usable_endpoints(self, count: int) -> bool:
        """Return whether the newest ``count`` endpoint poses have come within the last second."""
        poses = self._raw[ENDPOINT_COVARIANCE_TOPIC]
        return len(poses) >= count and time.time_ns() - poses[-count][0] < NS

    def warnings(self, begin_ns: int, end_ns: int) -> list[tuple[int, DiagnosticStatus]]:
        """Return the statuses of the arm's nodes that are not OK and came between two times [ns], with the times."""
        return [
            (time_ns, status)
            for time_ns, status in self.diagnostics
            if begin_ns <= time_ns < end_ns and status.level != status.OK and status.name.startswith(f"/{self._arm}/")
        ]

    def first_naming_ns(self, words: Sequence[str], begin_ns: int, end_ns: int, joint: str = "") -> int | None:
        """Return when the first message between two times [ns] came that names a fault; None: no message does.

        ``words`` are names of fault flags, or words of a sentence; any of them counts. The transforms of ``joint`` may
        have one of the flags; empty: no joint.
        """
        flags = sum(int(Fault[word]) for word in words if word in Fault.__members__)
        transforms = self.between(f"{joint}/{TRANSFORM_TOPIC}", begin_ns, end_ns) if joint and flags else []
        states = self.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)
        times = [each.time_ns for each in transforms if each.message.faults & flags]
        times += [each.time_ns for each in states if any(word in each.message.reason for word in words)]
        warnings = self.warnings(begin_ns, end_ns)
        times += [time_ns for time_ns, status in warnings if any(word in status.message for word in words)]
        return min(times, default=None)

    def describe(self, begin_ns: int, end_ns: int, joint: str = "") -> str:
        """Return a sentence on the messages of a joint and the endpoint between two times [ns]."""
        parts = []
        if joint and (transforms := self.between(f"{joint}/{TRANSFORM_TOPIC}", begin_ns, end_ns)):
            counts = {state.name: sum(each.message.state == state for each in transforms) for state in State}
            flags = Fault.NONE
            for each in transforms:
                flags |= Fault(each.message.faults)
            names = ", ".join(flag.name or "" for flag in flags)
            parts.append(", ".join(f"{n} {name}" for name, n in counts.items() if n) + (f" ({names})" if names else ""))
        states = self.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)
        reasons = [f"endpoint: {each.message.reason}" for each in states if each.message.reason]
        warnings = [
            f"{status.name.rpartition('/')[2]} {status.message}" for _, status in self.warnings(begin_ns, end_ns)
        ]
        return "; ".join([*parts, *(reasons or warnings)[:1]]) or "nothing published"
