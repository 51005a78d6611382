# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Topics within one process and between processes; nodes of two contexts communicate over DDS, as two processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import RLock, Thread
from typing import Any

import pytest
from posor.errors import ParameterError, TopicError
from posor.node_parameters import NodeParameters
from posor_lab.harness.graph import Graph, values_of
from posor_lab.harness.in_process_nodes import NodeProcess
from posor_lab.harness.program import wait_until
from posor_msgs.msg import JointTransform, RawScan
from posor_ros import intra_process
from posor_ros.delivery_round import Delivery, DeliveryGroup, DeliveryRound, run_after_round
from posor_ros.intra_process import IntraProcessPublisher, IntraProcessSubscription
from posor_ros.lifecycle_node import LISTENERS_STATUS, PosorNode
from posor_ros.qos import KEEP_ALL_QOS
from rclpy.serialization import serialize_message

pytestmark = pytest.mark.usefixtures("ros_domain")

TOPIC = "/joint/raw"
MESSAGES = [bytes(serialize_message(RawScan(scan=number, samples=1))) for number in range(3)]


class IdleNode(PosorNode[NodeParameters]):
    """A node without topics of its own, whose hooks fail on request."""

    NAME = "idle"
    Parameters = NodeParameters

    failure: Exception | None = None

    def activate(self) -> None:
        if self.failure is not None:
            raise self.failure

    deactivate = activate


@pytest.fixture
def process() -> Iterator[NodeProcess]:
    with NodeProcess() as process:
        yield process


def publish_from(node: IdleNode, topic: str = TOPIC, **options: Any) -> IntraProcessPublisher:
    return IntraProcessPublisher(node, RawScan, topic, KEEP_ALL_QOS, **options)


def subscribe(process: NodeProcess, callback: Callable[[bytes], None]) -> IntraProcessSubscription:
    node = process.start(IdleNode, f"/subscriber{len(process.nodes)}")
    return IntraProcessSubscription(node, RawScan, TOPIC, KEEP_ALL_QOS, callback)


@pytest.mark.parametrize("first", ["subscription", "publisher"])
def test_the_published_object_is_delivered_within_a_process(process: NodeProcess, first: str) -> None:
    node, subscriber = process.start(IdleNode, "/joint"), process.start(IdleNode, "/posor")
    received: list[bytes] = []
    if first == "publisher":
        publisher = publish_from(node, "raw")
    IntraProcessSubscription(subscriber, RawScan, TOPIC, KEEP_ALL_QOS, received.append)
    if first == "subscription":
        publisher = publish_from(node, "raw")
    assert publisher.topic_name == TOPIC
    wait_until(lambda: publisher.subscription_count == 1, "the end of the DDS subscription", process.spin_once)
    for data in MESSAGES:
        publisher.publish(data)
    assert [a is b for a, b in zip(received, MESSAGES, strict=True)] == [True] * 3
    assert not [each for each in subscriber.subscriptions if each.topic_name == TOPIC]


def test_other_processes_receive_the_same_messages(process: NodeProcess) -> None:
    publisher = publish_from(process.start(IdleNode, "/joint"))
    with Graph() as graph:
        received_over_dds = graph.collect(RawScan, TOPIC, raw=True)
        graph.wait_until(lambda: publisher.subscription_count == 1, "the subscription")
        received: list[bytes] = []
        subscription = subscribe(process, received.append)
        assert publisher.subscription_count == 2
        assert publisher.publish(MESSAGES[0])
        subscription.destroy()
        assert publisher.subscription_count == 1
        assert publisher.publish(MESSAGES[1])
        graph.wait_until(lambda: len(received_over_dds) == 2, "both messages")
    assert received_over_dds == MESSAGES[:2]
    assert received == MESSAGES[:1]


def test_a_message_is_read_whole_over_dds_and_where_a_subscription_of_the_process_says_so(process: NodeProcess) -> None:
    publisher = publish_from(process.start(IdleNode, "/joint"))
    assert not publisher.is_read_whole
    first, second = subscribe(process, print), subscribe(process, print)
    assert publisher.is_read_whole
    first.reads_whole = False
    assert publisher.is_read_whole
    second.reads_whole = False
    assert not publisher.is_read_whole
    with Graph() as graph:
        graph.collect(RawScan, TOPIC, raw=True)
        graph.wait_until(lambda: publisher.is_read_whole, "a subscription over DDS")


def test_a_blocking_subscription_is_awaited_and_then_named(
    process: NodeProcess, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def publish_until_blocked() -> None:
        while True:
            assert publisher.publish(MESSAGES[0])

    publisher = publish_from(node := process.start(IdleNode, "/joint"))
    monkeypatch.setattr(intra_process, "PUBLISH_TIMEOUT_S", 0.5)
    with Graph() as graph:
        graph.node.create_subscription(RawScan, TOPIC, print, KEEP_ALL_QOS)
        graph.wait_until(lambda: publisher.subscription_count == 1, "the subscription")
        with pytest.raises(
            TopicError, match=r"topic /joint/raw: a subscription has taken nothing for 0\.5 s; expected"
        ):
            publish_until_blocked()
        node.stop_requested = lambda: True
        assert not publisher.publish(MESSAGES[0])
        answers = iter([False, False, True])
        assert not publisher.wait_for_all_acked(60.0, lambda: next(answers))
        assert list(answers) == []
        monkeypatch.setattr(intra_process, "DESTROY_TIMEOUT_S", 0.1)
        publisher.destroy()
        assert "not all messages of /joint/raw were received" in capfd.readouterr().err


def test_a_subscription_uses_dds_while_its_process_has_no_publisher(process: NodeProcess) -> None:
    received: list[bytes] = []
    subscription = subscribe(process, received.append)
    assert subscription.publishers == 0
    with Graph() as graph:
        remote = graph.node.create_publisher(RawScan, TOPIC, KEEP_ALL_QOS)

        def wait_for_subscriptions(count: int) -> None:
            graph.wait_until(lambda: remote.get_subscription_count() == count, "the subscriptions", process.spin_once)

        wait_for_subscriptions(1)
        remote.publish(MESSAGES[0])
        graph.wait_until(lambda: received == MESSAGES[:1], "a message over DDS", process.spin_once)
        publisher = publish_from(process.start(IdleNode, "/joint"))
        wait_for_subscriptions(0)
        assert subscription.publishers == 1
        graph.wait_until(lambda: subscription.publishers == 2, "both", subscription.find_publishers)
        publisher.publish(MESSAGES[1])
        assert received == MESSAGES[:2]
        publisher.destroy()
        wait_for_subscriptions(1)
        remote.publish(MESSAGES[2])
        graph.wait_until(lambda: received == MESSAGES, "a message over DDS again", process.spin_once)
        assert subscription.publishers == 1
        subscription.destroy()
        wait_for_subscriptions(0)


def test_topics_close_with_their_nodes() -> None:
    with Graph() as graph:

        def has_ends(count: int) -> bool:
            return graph.node.count_publishers("/published") == graph.node.count_subscribers(TOPIC) == count

        with NodeProcess() as process:
            publish_from(process.start(IdleNode, "/joint"), "/published")
            subscribe(process, print)
            graph.wait_until(lambda: has_ends(1), "both")
        graph.wait_until(lambda: has_ends(0), "neither")


def test_an_inactive_node_publishes_nothing(process: NodeProcess) -> None:
    received: list[bytes] = []
    node = process.start(IdleNode, "/joint")
    publisher = publish_from(node)
    subscribe(process, received.append)
    with Graph() as graph:
        received_over_dds = graph.collect(RawScan, TOPIC, raw=True)
        graph.wait_until(lambda: publisher.subscription_count == 2, "the subscription")
        node.trigger_deactivate()
        assert not publisher.publish(MESSAGES[0])
        node.trigger_activate()
        assert publisher.publish(MESSAGES[1])
        graph.wait_until(lambda: bool(received_over_dds), "the message of the active node")
    assert received == received_over_dds == [MESSAGES[1]]


@pytest.mark.parametrize("failure", [ParameterError("refused"), ZeroDivisionError("a bug")])
@pytest.mark.parametrize("hook", ["activate", "deactivate"])
def test_a_node_with_a_failed_hook_publishes_only_if_it_stays_active(
    process: NodeProcess, hook: str, failure: Exception
) -> None:
    received: list[bytes] = []
    node = process.start(IdleNode, "/joint")
    publisher = publish_from(node)
    subscribe(process, received.append)
    if hook == "activate":
        node.trigger_deactivate()
    node.failure = failure
    getattr(node, f"trigger_{hook}")()
    stays_active = hook == "deactivate" and isinstance(failure, ParameterError)
    assert publisher.publish(MESSAGES[0]) == stays_active
    assert received == MESSAGES[:stays_active]
    node.failure = None


def test_the_diagnostics_count_the_subscriptions_in_any_process(process: NodeProcess) -> None:
    node = process.start(IdleNode, "/joint")
    publisher = publish_from(node, count_listeners=True)
    name = f"/joint/idle: {LISTENERS_STATUS}"
    with Graph() as observer:
        observer.watch_diagnostics()

        def wait_for_count(count: int) -> None:
            def has_count() -> bool:
                latest = observer.latest(name)
                return latest is not None and values_of(latest).get(TOPIC) == str(count)

            observer.wait_until(has_count, f"{count} subscriptions", process.spin_once)
            assert publisher.subscription_count == count
            assert publisher.has_subscriptions == (count > 0)

        wait_for_count(0)
        subscription = subscribe(process, print)
        wait_for_count(1)
        with Graph() as graph:
            graph.collect(RawScan, TOPIC)
            wait_for_count(2)
            subscription.destroy()
            wait_for_count(1)
        wait_for_count(0)


def test_the_ends_of_a_topic_must_have_the_same_type(process: NodeProcess) -> None:
    node = process.start(IdleNode, "/joint")
    publish_from(node, "raw")
    with pytest.raises(TopicError) as caught:
        IntraProcessSubscription(node, JointTransform, "raw", KEEP_ALL_QOS, print)
    assert str(caught.value) == (
        "topic /joint/raw: is of type posor_msgs/msg/JointTransform here; "
        "expected posor_msgs/msg/RawScan, as another node of this process has it."
    )


def test_an_exception_in_a_callback_ends_its_program_but_not_the_publisher(process: NodeProcess) -> None:
    received: list[bytes] = []
    received_by_broken: list[bytes] = []

    def fail(data: bytes) -> None:
        received_by_broken.append(data)
        raise TopicError(f"{len(data)} bytes are too many", where="topic /joint/raw")

    subscribe(process, fail)
    subscribe(process, received.append)
    publisher = publish_from(process.start(IdleNode, "/joint"))
    for data in MESSAGES:
        publisher.publish(data)
    assert received == MESSAGES
    assert received_by_broken == MESSAGES[:1]
    assert [node.exit_requested for node in process.nodes] == [True, False, False]
    broken = process.nodes[0]
    broken.request_exit(TopicError("is a later failure", where="topic /joint/raw"))
    with pytest.raises(TopicError, match="bytes are too many"):
        broken.raise_failure()


class Rounds:
    """Two topics whose subscriptions form a group, which passes each message on to a group of one subscription."""

    def __init__(self, process: NodeProcess) -> None:
        self.events: list[str] = []
        self.failure: Exception | None = None
        self.lock = RLock()
        source = process.start(IdleNode, "/source")
        self.first, self.second = (publish_from(source, topic) for topic in ("first", "second"))
        self.onward = publish_from(source, "onward")
        self.members = [self.subscribe(process, topic, self.receive) for topic in ("first", "second")]
        self.subscribe(process, "onward", self.receive_onward)

    def subscribe(self, process: NodeProcess, topic: str, receive: Any) -> IntraProcessSubscription:
        node = process.start(IdleNode, f"/{topic}")
        group = DeliveryGroup(receive, self.lock)
        return IntraProcessSubscription(node, RawScan, f"/source/{topic}", KEEP_ALL_QOS, group)

    def receive(self, deliveries: list[Delivery]) -> Callable[[], None]:
        self.events.append(f"group {[MESSAGES.index(data) for _, data in deliveries]}")
        if self.failure is not None:
            raise self.failure
        self.onward.publish(deliveries[0][1])
        return lambda: self.events.append("rest")

    def receive_onward(self, deliveries: list[Delivery]) -> None:
        self.events.append(f"onward {[MESSAGES.index(data) for _, data in deliveries]}")


@pytest.fixture
def rounds(process: NodeProcess) -> Rounds:
    return Rounds(process)


def test_a_group_receives_the_messages_of_a_round_in_one_call_at_its_end(rounds: Rounds) -> None:
    with DeliveryRound():
        rounds.second.publish(MESSAGES[1])
        rounds.first.publish(MESSAGES[0])
        assert rounds.events == []
    assert rounds.events == ["group [1, 0]", "onward [1]", "rest"]


def test_a_second_message_of_a_topic_ends_the_first_part_of_a_round(rounds: Rounds) -> None:
    with DeliveryRound():
        rounds.first.publish(MESSAGES[0])
        rounds.second.publish(MESSAGES[0])
        rounds.first.publish(MESSAGES[1])
    assert rounds.events == ["group [0, 0]", "onward [0]", "rest", "group [1]", "onward [1]", "rest"]


def test_outside_of_a_round_a_group_receives_each_message_at_once(rounds: Rounds) -> None:
    for data in MESSAGES[:2]:
        rounds.first.publish(data)
    assert rounds.events == ["group [0]", "onward [0]", "rest", "group [1]", "onward [1]", "rest"]


def test_what_a_group_publishes_in_the_end_is_delivered_in_the_same_round(rounds: Rounds) -> None:
    def receive(deliveries: list[Delivery]) -> Callable[[], None]:
        def publish_onward() -> None:
            rounds.onward.publish(deliveries[0][1])

        return publish_onward

    for member in rounds.members:
        member.group = DeliveryGroup(receive, rounds.lock)
    with DeliveryRound():
        rounds.first.publish(MESSAGES[0])
        rounds.second.publish(MESSAGES[1])
    assert rounds.events == ["onward [0]"]


def test_work_after_a_round_runs_once_all_messages_of_the_thread_are_delivered(rounds: Rounds) -> None:
    def work() -> None:
        rounds.events.append("work")

    with DeliveryRound():
        run_after_round(work)
        with DeliveryRound():
            rounds.first.publish(MESSAGES[0])
    assert rounds.events == ["group [0]", "onward [0]", "rest", "work"]
    run_after_round(work)
    assert rounds.events[-2:] == ["work", "work"]


def test_a_round_is_of_one_thread(rounds: Rounds) -> None:
    with DeliveryRound():
        rounds.first.publish(MESSAGES[0])
        other = Thread(target=rounds.second.publish, args=(MESSAGES[1],))
        other.start()
        other.join()
        assert rounds.events == ["group [1]", "onward [1]", "rest"]


def test_a_destroyed_subscription_receives_nothing_of_the_round(rounds: Rounds) -> None:
    with DeliveryRound():
        rounds.first.publish(MESSAGES[0])
        rounds.second.publish(MESSAGES[1])
        rounds.members[0].destroy()
    assert rounds.events == ["group [1]", "onward [1]", "rest"]


def test_a_failure_in_a_round_ends_the_nodes_of_the_group(rounds: Rounds) -> None:
    rounds.failure = ValueError("of the group")
    for _ in range(2):
        with DeliveryRound():
            rounds.first.publish(MESSAGES[0])
            rounds.second.publish(MESSAGES[1])
    assert rounds.events == ["group [0, 1]"]
    assert all(member.node.exit_requested for member in rounds.members)
    with pytest.raises(ValueError, match="of the group"):
        rounds.members[0].node.raise_failure()
