"""Receives what the graph publishes during a replay and puts it together, step by step."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from posor_estimator.core.fault import Fault, State
from posor_estimator.ros.main import WAKE_S
from posor_estimator.ros.messages import is_usable, stamp_ns
from posor_estimator.ros.qos import DIAGNOSTICS_TOPIC, ENDPOINT_TOPIC, TRANSFORM_TOPIC, TRUTH_TOPIC
from posor_msgs.msg import JointTransform
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from posor_bringup.motion import Step

if TYPE_CHECKING:
    from collections.abc import Callable

KEEP_ALL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, reliability=ReliabilityPolicy.RELIABLE)
"""For a replay that loses nothing."""


class Collector(Node):
    """Subscribes to one joint's transforms, the endpoint and the machining centre, and joins them by stamp."""

    def __init__(self, joint: str) -> None:
        """Subscribe.

        Args:
            joint: Namespace of the joint, such as ``joint1``.

        """
        super().__init__("demo")
        self.transforms: dict[int, JointTransform] = {}
        self.poses: dict[int, PoseStamped] = {}
        self.truths: dict[int, PointStamped] = {}
        self.received = 0
        self._statuses: dict[str, DiagnosticStatus] = {}
        topics: tuple[tuple[type[Any], str, dict[int, Any]], ...] = (
            (JointTransform, f"/{joint}/{TRANSFORM_TOPIC}", self.transforms),
            (PoseStamped, f"/{ENDPOINT_TOPIC}", self.poses),
            (PointStamped, TRUTH_TOPIC, self.truths),
        )
        for kind, topic, store in topics:
            self.create_subscription(kind, topic, partial(self._keep, store), KEEP_ALL_QOS)
        self.create_subscription(DiagnosticArray, DIAGNOSTICS_TOPIC, self._note, KEEP_ALL_QOS)
        # One executor for good: messages that arrive while one executor gives way to the next are never taken.
        self._executor = EventsExecutor()
        self._executor.add_node(self)

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

    def forget(self, node: str) -> None:
        """Forget what a node said of itself, such as ``/chain_node``: it is no more."""
        self._statuses = {name: said for name, said in self._statuses.items() if not name.startswith(f"{node}:")}

    def missing(self) -> list[str]:
        """Return what has not arrived although something else of the same scan has."""
        known = sorted(self.truths.keys() | self.transforms.keys() | self.poses.keys())
        lacking = [f"machining-centre reading of {self._scan(stamp)}" for stamp in known if stamp not in self.truths]
        lacking += [f"transform of {self._scan(stamp)}" for stamp in known if stamp not in self.transforms]
        lacking += [
            f"endpoint of {self._scan(stamp)}"
            for stamp, transform in self.transforms.items()
            if is_usable(transform) and stamp not in self.poses
        ]
        return lacking

    def _scan(self, stamp: int) -> str:
        transform = self.transforms.get(stamp)
        return f"the scan at {stamp / 1e9:.3f} s" if transform is None else f"scan {transform.scan}"

    def steps(self) -> list[Step]:
        """Return the complete steps received so far, up to the first of which something is still missing.

        Complete is a step with transform and truth, and with an endpoint if the transform is usable.
        """
        steps = []
        for stamp in sorted(self.truths.keys() | self.transforms.keys()):
            transform = self.transforms.get(stamp)
            if transform is None or stamp not in self.truths or (is_usable(transform) and stamp not in self.poses):
                break
            steps.append(self._step(stamp))
        return steps

    def _step(self, stamp: int) -> Step:
        transform, truth, pose = self.transforms[stamp], self.truths[stamp].point, self.poses.get(stamp)
        point = None if pose is None else pose.pose.position
        return Step(
            number=int(transform.scan),
            state=State(transform.state),
            faults=Fault(transform.faults),
            scan_status=int(transform.scan_status),
            angles=np.array(transform.native[3:6], dtype=float),
            truth=np.array([truth.x, truth.y, truth.z]),
            endpoint=np.full(3, np.nan) if point is None else np.array([point.x, point.y, point.z]),
        )
