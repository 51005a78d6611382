# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a group receives over DDS: together where ticks come complete, and not later than the next tick or check."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import RLock
from typing import Any

import pytest
from posor.node_parameters import NodeParameters
from posor_lab.harness.graph import Graph
from posor_lab.harness.in_process_nodes import NodeProcess
from posor_lab.harness.program import wait_until
from posor_msgs.msg import RawScan
from posor_ros import arrival_collector
from posor_ros.arrival_collector import JUDGED_TICKS, MAX_TICK_S, ArrivalCollector
from posor_ros.delivery_round import Delivery, DeliveryGroup
from posor_ros.input_watch import InputWatch
from posor_ros.intra_process import IntraProcessSubscription
from posor_ros.lifecycle_node import PosorNode
from posor_ros.qos import SENSOR_QOS
from rclpy.serialization import serialize_message

JOINTS = 3
QUICK_S, SLOW_S = 0.1 * MAX_TICK_S, MAX_TICK_S  # between two messages of a tick
PERIOD_S = 10.0 * MAX_TICK_S


class Member:
    """A subscription of a group."""

    def __init__(self, number: int, group: DeliveryGroup) -> None:
        self.node: Any = number
        self.group: DeliveryGroup | None = group
        self.closed, self.watch, self.topic_name = False, InputWatch(""), f"joint_{number}"

    def attempt(self, step: Callable[..., Any], *arguments: Any) -> Any:
        return step(*arguments)

    def fail(self, error: Exception) -> None:
        raise error


class Arrivals:
    """Messages that arrive for three joints at stated times; ``rounds`` are the joints and ticks of each delivery."""

    def __init__(self) -> None:
        self.now_s, self.takes_s = 100.0, 0.0  # ``takes_s``: time of a delivery
        self.rounds: list[list[tuple[int, int]]] = []
        group = DeliveryGroup(self.receive, RLock())
        self.members = [Member(number, group) for number in range(JOINTS)]
        self.collector = ArrivalCollector(lambda: self.now_s)
        self.collector.members.update(self.members)

    def receive(self, deliveries: list[Delivery]) -> None:
        self.now_s += self.takes_s
        self.rounds.append([(member.node, data[4]) for member, data in deliveries])

    def tick(self, tick: int, joints: Any = range(JOINTS), *, between_s: float = QUICK_S) -> list[list[int]]:
        """Have messages with the stamp of a tick arrive; return the joints of each delivery."""
        self.rounds.clear()
        self.now_s += PERIOD_S
        for joint in joints:
            self.now_s += between_s
            self.collector.add(self.members[joint], bytes([0, 1, 0, 0, tick % 256, 0, 0, 0, 0, 0, 0, 0]))
        return self.joints()

    def joints(self) -> list[list[int]]:
        """Return the joints of each delivery since the beginning of the last tick."""
        return [[joint for joint, _ in each] for each in self.rounds]


@pytest.fixture
def arrivals() -> Arrivals:
    return Arrivals()


def test_messages_of_a_tick_wait_for_each_other(arrivals: Arrivals) -> None:
    assert arrivals.tick(0) == [[0, 1, 2]]
    assert arrivals.tick(1, [2, 0, 1]) == [[2, 0, 1]]


def test_a_missing_message_delays_the_others_until_the_next_tick(arrivals: Arrivals) -> None:
    assert arrivals.tick(50, [0, 2]) == []
    assert arrivals.tick(51) == [[0, 2], [0, 1, 2]]


def test_a_missing_message_delays_the_others_until_a_check(arrivals: Arrivals) -> None:
    arrivals.tick(50, [0, 2])
    arrivals.collector.check()
    assert arrivals.joints() == []
    arrivals.now_s += SLOW_S + QUICK_S
    arrivals.collector.check()
    arrivals.collector.check()
    assert arrivals.joints() == [[0, 2]]
    assert arrivals.tick(50, [1]) == []  # late; it may begin a tick of the same stamp
    assert arrivals.tick(51) == [[1], [0, 1, 2]]


def test_nothing_waits_for_a_joint_that_is_gone(arrivals: Arrivals) -> None:
    for tick in range(50, 50 + JUDGED_TICKS):
        arrivals.tick(tick, [0, 2])
    assert arrivals.tick(80, [0, 2]) == [[0], [2]]
    for tick in range(100, 100 + JUDGED_TICKS):
        arrivals.tick(tick)
    assert arrivals.tick(150) == [[0, 1, 2]]  # it is back


def test_messages_wait_for_a_tick_with_a_gap_where_the_next_one_follows_at_once(arrivals: Arrivals) -> None:
    """As where the process is overloaded, and messages wait for it."""
    for tick in range(50, 50 + JUDGED_TICKS):
        arrivals.now_s -= PERIOD_S - QUICK_S
        arrivals.tick(tick, [0, 2])
    assert arrivals.tick(80) == [[0, 2], [0, 1, 2]]


def test_messages_wait_again_though_deliveries_one_by_one_take_longer_than_a_short_tick(arrivals: Arrivals) -> None:
    for tick in range(JUDGED_TICKS):
        arrivals.tick(tick, [0, 2])
    arrivals.takes_s = SLOW_S
    for tick in range(50, 50 + JUDGED_TICKS):
        arrivals.tick(tick)
    assert arrivals.tick(80) == [[0, 1, 2]]


def test_a_message_that_waits_for_a_subscription_that_leaves_dds_is_dropped(arrivals: Arrivals) -> None:
    """Its topic has a publisher in this process now, see ``IntraProcessSubscription``."""
    arrivals.tick(50, [0, 1])
    arrivals.collector.remove(arrivals.members[1])
    assert arrivals.tick(51, [0, 2]) == [[0], [0, 2]]


def test_nothing_waits_for_a_joint_that_is_always_late(arrivals: Arrivals) -> None:
    for tick in range(JUDGED_TICKS):
        arrivals.tick(tick, between_s=SLOW_S)
    assert arrivals.tick(50) == [[0], [1], [2]]


def test_ticks_that_took_long_at_times_change_nothing(arrivals: Arrivals) -> None:
    for tick in range(2 * JUDGED_TICKS):
        assert arrivals.tick(tick, between_s=SLOW_S if tick % 10 == 0 else QUICK_S) == [[0, 1, 2]]


def test_joints_with_other_stamps_do_not_wait(arrivals: Arrivals) -> None:
    for tick in range(JUDGED_TICKS):
        arrivals.tick(tick, [0, 1])
        arrivals.tick(100 + tick, [2])
    assert arrivals.tick(50, [0, 1]) == [[0], [1]]


def test_after_a_lost_message_ticks_are_collected_by_their_stamps_again(arrivals: Arrivals) -> None:
    arrivals.tick(50, [1, 2])
    assert arrivals.tick(51) == [[1, 2], [0, 1, 2]]
    assert arrivals.rounds[-1] == [(joint, 51) for joint in range(JOINTS)]


def test_a_repeated_message_is_delivered_too(arrivals: Arrivals) -> None:
    assert arrivals.tick(50, [0, 0, 1, 2]) == [[0], [0, 1, 2]]


def test_a_subscription_that_leaves_is_not_waited_for(arrivals: Arrivals) -> None:
    arrivals.collector.members.discard(arrivals.members[1])
    assert arrivals.tick(50, [0, 2]) == [[0, 2]]


class IdleNode(PosorNode[NodeParameters]):
    """A node without topics of its own."""

    NAME = "idle"
    Parameters = NodeParameters


@pytest.fixture
def process() -> Iterator[NodeProcess]:
    with NodeProcess() as process:
        yield process


@pytest.mark.usefixtures("ros_domain")
def test_messages_of_another_process_are_received_together(
    process: NodeProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrival_collector, "MAX_TICK_S", 10.0)  # on a busy host
    rounds: list[list[str]] = []
    lock = RLock()

    def receive(deliveries: list[Delivery]) -> None:
        rounds.append(sorted(subscription.topic_name for subscription, _ in deliveries))

    topics = [f"/joint{number}/raw" for number in range(JOINTS)]
    members = [
        IntraProcessSubscription(
            process.start(IdleNode, f"/joint{number}"), RawScan, topic, SENSOR_QOS, DeliveryGroup(receive, lock)
        )
        for number, topic in enumerate(topics)
    ]
    assert members[0].collector is not None
    assert all(member.collector is members[0].collector for member in members)
    with Graph() as graph:
        publishers = [graph.publisher(RawScan, topic) for topic in topics]
        wait_until(lambda: all(each.get_subscription_count() for each in publishers), "matches", process.spin_once)

        def publish() -> None:
            message = RawScan(samples=1)
            message.header.stamp.sec = publish.number = publish.number + 1  # type: ignore[attr-defined]
            data = bytes(serialize_message(message))
            for each in publishers:
                each.publish(data)
            for _ in range(2 * JOINTS):
                process.spin_once()

        publish.number = 0  # type: ignore[attr-defined]
        wait_until(lambda: topics in rounds, "all messages of a tick in one round", publish)
        members[1].destroy()
        rounds.clear()
        wait_until(lambda: [topics[0], topics[2]] in rounds, "a round without the one destroyed", publish)
