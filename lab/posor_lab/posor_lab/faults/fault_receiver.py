"""Receives what the nodes of an arm publish, with the times of arrival."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from posor.model.fault import Fault, State
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC, ENDPOINT_STATE_TOPIC, TRANSFORM_TOPIC
from posor_msgs.msg import EndpointState, JointTransform
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from posor_lab.reports.graph_receiver import GraphReceiver

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Matches reliable and best-effort publishers."""


@dataclass(frozen=True)
class Arrival:
    """A message and when it came."""

    time_ns: int  # system time, which is the ROS time of the nodes
    message: Any


class FaultReceiver(GraphReceiver):
    """Stores transforms, endpoint states, endpoint poses and diagnostics of an arm in the order of arrival."""

    def __init__(self, arm: str, joints: Sequence[str]) -> None:
        """Subscribe to the topics of the arm in the namespace ``arm``."""
        super().__init__("faults")
        self._arm = arm
        self.diagnostics: list[tuple[int, DiagnosticStatus]] = []
        self._raw: dict[str, list[tuple[int, bytes]]] = {}
        self._types: dict[str, type[Any]] = {}
        for joint in joints:
            self._store(JointTransform, f"{joint}/{TRANSFORM_TOPIC}")
        self._store(EndpointState, ENDPOINT_STATE_TOPIC)
        self._store(PoseWithCovarianceStamped, ENDPOINT_COVARIANCE_TOPIC)
        self._acknowledgements = {
            joint: self.create_client(Trigger, f"/{arm}/{joint}/posor_node/acknowledge") for joint in joints
        }

    def _store(self, message_type: type[Any], topic: str) -> None:
        self._raw[topic], self._types[topic] = [], message_type
        callback = partial(self._on_bytes, self._raw[topic])
        self.create_subscription(message_type, f"/{self._arm}/{topic}", callback, QOS, raw=True)

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

    def newest(self, topic: str) -> Arrival | None:
        """Return the newest message of a topic; None: nothing has come."""
        return next(self._arrivals(topic, self._raw[topic][-1:]), None)

    def since(self, topic: str, count: int) -> list[Arrival]:
        """Return the messages of a topic after the first ones, ``count`` of them."""
        return list(self._arrivals(topic, self._raw[topic][count:]))

    def between(self, topic: str, begin_ns: int, end_ns: int) -> list[Arrival]:
        """Return the messages of a topic that came between two times [ns]."""
        return list(self._arrivals(topic, [each for each in self._raw[topic] if begin_ns <= each[0] < end_ns]))

    def _arrivals(self, topic: str, stored: Sequence[tuple[int, bytes]]) -> Iterator[Arrival]:
        for time_ns, data in stored:
            yield Arrival(time_ns, deserialize_message(data, self._types[topic]))

    def receive_for(self, seconds: float) -> None:
        """Receive for a time."""
        end_s = time.monotonic() + seconds
        self.receive_until(lambda: time.monotonic() >= end_s)

    def acknowledge(self, joint: str) -> None:
        """Call ``~/acknowledge`` of a joint's posor_node, without waiting for the response."""
        client = self._acknowledgements[joint]
        if client.service_is_ready():
            client.call_async(Trigger.Request())

    def usable_endpoints(self, count: int) -> bool:
        """Return whether the newest ``count`` endpoint poses have come within the last second."""
        poses = self._raw[ENDPOINT_COVARIANCE_TOPIC]
        return len(poses) >= count and time.time_ns() - poses[-count][0] < NS

    def first_naming_ns(self, words: Sequence[str], begin_ns: int, end_ns: int, joint: str = "") -> int | None:
        """Return when the first message came that names a fault; None: there is none.

        Args:
            words: Names of fault flags, or words of a sentence; any of them counts.
            begin_ns: Earliest arrival [ns].
            end_ns: Latest arrival [ns].
            joint: Joint whose transforms may have one of the flags; empty: none.

        """
        flags = sum(int(Fault[word]) for word in words if word in Fault.__members__)
        times = []
        if joint and flags:
            transforms = self.between(f"{joint}/{TRANSFORM_TOPIC}", begin_ns, end_ns)
            times += [each.time_ns for each in transforms if each.message.faults & flags][:1]
        states = self.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)
        times += [each.time_ns for each in states if any(word in each.message.reason for word in words)][:1]
        times += [
            time_ns
            for time_ns, status in self.diagnostics
            if begin_ns <= time_ns < end_ns
            and status.level != status.OK
            and status.name.startswith(f"/{self._arm}/")
            and any(word in status.message for word in words)
        ][:1]
        return min(times, default=None)

    def describe(self, begin_ns: int, end_ns: int, joint: str = "") -> str:
        """Return a sentence on what came between two times [ns] about a joint and the endpoint."""
        parts = []
        transforms = self.between(f"{joint}/{TRANSFORM_TOPIC}", begin_ns, end_ns) if joint else []
        if transforms:
            counts = {state.name: sum(each.message.state == state for each in transforms) for state in State}
            flags = Fault.NONE
            for each in transforms:
                flags |= Fault(each.message.faults)
            names = ", ".join(flag.name or "" for flag in flags)
            parts.append(", ".join(f"{n} {name}" for name, n in counts.items() if n) + (f" ({names})" if names else ""))
        states = self.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)
        reasons = [each.message.reason for each in states if each.message.reason]
        warnings = [
            f"{status.name.rpartition('/')[2]} {status.message}"
            for time_ns, status in self.diagnostics
            if begin_ns <= time_ns < end_ns and status.level != status.OK and f"/{self._arm}/" in status.name
        ]
        parts += [f"endpoint: {reasons[0]}"] if reasons else warnings[:1]
        return "; ".join(parts) or "nothing published"
