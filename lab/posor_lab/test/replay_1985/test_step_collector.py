# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The step collector with real publishers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseStamped
from posor.model.fault import State
from posor_lab.replay_1985.replay import StepCollector
from posor_msgs.msg import JointTransform
from posor_ros.node_program import ros_context
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.publisher import Publisher


@pytest.fixture
def collector(ros_domain: int) -> Iterator[StepCollector]:
    assert ros_domain
    with ros_context(["test"]), StepCollector("joint7") as node:
        yield node


@pytest.fixture
def send(collector: StepCollector) -> Callable[..., None]:
    """Return a function that publishes parts of a scan and waits until they are received."""
    kinds = {
        "transform": (JointTransform, "/joint7/transform"),
        "pose": (PoseStamped, "/endpoint/pose"),
        "truth": (PointStamped, "/truth/machining_centre"),
    }
    publishers: dict[str, Publisher] = {
        part: collector.create_publisher(kind, topic, KEEP_ALL_QOS) for part, (kind, topic) in kinds.items()
    }
    collector.receive_until(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))

    def publish(number: int, *parts: str, state: State = State.OK) -> None:
        before = collector.received
        for part in parts:
            message: Any = kinds[part][0]()
            message.header.stamp.sec = 100 + number
            if part == "transform":
                message.scan, message.state, message.native[5] = number, int(state), 0.1 * number
            elif part == "truth":
                message.point.z = 1e-3 * number
            else:
                message.pose.position.y = -1e-3 * number
            publishers[part].publish(message)
        collector.receive_until(lambda: collector.received == before + len(parts))

    return publish


def test_messages_of_a_scan_are_joined_in_any_order(collector: StepCollector, send: Callable[..., None]) -> None:
    send(2, "pose", "truth")
    send(1, "transform")
    assert collector.complete_steps() == []
    assert collector.missing() == [
        "machining-centre reading of scan 1",
        "transform of the scan at 102.000 s",
        "endpoint of scan 1",
    ]
    send(2, "transform")
    assert collector.complete_steps() == []  # step 1 comes first, whatever comes later
    send(1, "truth", "pose")
    first, second = collector.complete_steps()
    assert (first.number, second.number) == (1, 2)
    assert collector.missing() == []
    assert second.angles[2] == pytest.approx(0.2)
    assert second.truth.tolist() == [0.0, 0.0, 2e-3]
    assert second.endpoint.tolist() == [0.0, -2e-3, 0.0]


def test_a_lost_transform_needs_no_pose_and_a_degraded_one_does(
    collector: StepCollector, send: Callable[..., None]
) -> None:
    send(1, "truth", "transform", state=State.LOST)
    send(2, "truth", "transform", state=State.DEGRADED)
    (lost,) = collector.complete_steps()
    assert not lost.has_pose
    assert np.all(np.isnan(lost.endpoint))
    assert collector.missing() == ["endpoint of scan 2"]


def test_the_newest_diagnostics_are_stored(collector: StepCollector) -> None:
    publisher = collector.create_publisher(DiagnosticArray, "/diagnostics", KEEP_ALL_QOS)
    collector.receive_until(lambda: publisher.get_subscription_count() > 0)
    assert collector.status_value("/a: b", "key") is None
    for value in ("old", "new"):
        status = DiagnosticStatus(name="/a: b", message="fine", values=[KeyValue(key="key", value=value)])
        publisher.publish(DiagnosticArray(status=[status]))
    collector.receive_until(lambda: collector.status_value("/a: b", "key") == "new")
    assert collector.status_value("/a: b", "message") == "fine"
    assert collector.status_value("/a: b", "other") is None
