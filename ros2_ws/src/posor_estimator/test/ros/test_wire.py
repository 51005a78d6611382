"""Topics within one process and between processes: nodes of two contexts stand for two processes, DDS between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from posor_estimator.errors import ParameterError, TopicError
from posor_estimator.ros import wire
from posor_estimator.ros.node import PosorNode
from posor_estimator.ros.parameters import NodeParameters
from posor_estimator.ros.qos import KEEP_ALL_QOS
from posor_estimator.ros.wire import Inlet, Outlet
from posor_estimator.testing.graph import Graph
from posor_estimator.testing.process import Process
from posor_estimator.testing.program import wait_until
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import serialize_message

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.usefixtures("ros_domain")

MESSAGES = [bytes(serialize_message(RawScan(scan=number, samples=1))) for number in range(3)]


class PlainNode(PosorNode[NodeParameters]):
    """A node that does nothing by itself."""

    NAME = "plain"
    Parameters = NodeParameters


@pytest.fixture
def process() -> Iterator[Process]:
    with Process() as process:
        yield process


def plain(process: Process, namespace: str) -> PlainNode:
    return process.start(PlainNode, namespace)


def outlet_of(node: PlainNode, topic: str = "/joint/raw", **options: Any) -> Outlet:
    """Return an outlet of an active node."""
    return Outlet(node, RawScan, topic, KEEP_ALL_QOS, **options)


@pytest.mark.parametrize("first", ["inlet", "outlet"])
def test_within_a_process_the_very_bytes_are_handed_on_whoever_comes_first(process: Process, first: str) -> None:
    sender, listener = plain(process, "/joint"), plain(process, "/posor")
    taken: list[bytes] = []
    if first == "outlet":
        outlet = outlet_of(sender, "raw")
    Inlet(listener, RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
    if first == "inlet":
        outlet = outlet_of(sender, "raw")
    assert outlet.topic_name == "/joint/raw"
    assert outlet.count == 1
    for data in MESSAGES:
        outlet.publish(data)
    assert [a is b for a, b in zip(taken, MESSAGES, strict=True)] == [True] * 3
    assert not [s for s in listener.subscriptions if s.topic_name == "/joint/raw"]


def test_other_processes_get_the_same_messages(process: Process) -> None:
    outlet = outlet_of(plain(process, "/joint"))
    with Graph() as graph:
        received = graph.collect(RawScan, "/joint/raw", raw=True)
        graph.wait_until(lambda: outlet.count == 1, "the subscription")
        taken: list[bytes] = []
        inlet = Inlet(plain(process, "/posor"), RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
        assert outlet.count == 2
        assert outlet.publish(MESSAGES[0])
        inlet.destroy()
        assert outlet.count == 1
        assert outlet.publish(MESSAGES[1])
        graph.wait_until(lambda: len(received) == 2, "what was sent")
    assert received == MESSAGES[:2]
    assert taken == MESSAGES[:1]


def test_a_subscription_that_takes_nothing_is_waited_for_and_then_named(
    process: Process, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    asked: list[None] = []
    impatient = False

    def given_up() -> bool:
        asked.append(None)
        return impatient

    outlet = outlet_of(plain(process, "/joint"), given_up=given_up)
    monkeypatch.setattr(wire, "PATIENCE_S", 0.5)
    with Graph() as graph:
        graph.node.create_subscription(RawScan, "/joint/raw", print, KEEP_ALL_QOS)
        graph.wait_until(lambda: outlet.count == 1, "the subscription")
        with pytest.raises(
            TopicError, match=r"topic /joint/raw: a subscription has taken nothing for 0\.5 s; expected"
        ):
            publish_on(outlet)
        assert asked
        impatient = True
        asked.clear()
        assert not outlet.publish(MESSAGES[0])
        assert len(asked) == 1
        answers = iter([False, False, True])
        assert not outlet.deliver(60.0, lambda: next(answers))
        assert list(answers) == []
        monkeypatch.setattr(wire, "LINGER_S", 0.1)
        outlet.destroy()
        assert "not all messages of /joint/raw were received" in capfd.readouterr().err


def publish_on(outlet: Outlet) -> None:
    while True:
        assert outlet.publish(MESSAGES[0])


def test_an_inlet_hears_other_processes_while_its_own_has_no_outlet(process: Process) -> None:
    listener = plain(process, "/posor")
    taken: list[bytes] = []
    inlet = Inlet(listener, RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
    assert not inlet.has_publisher()
    with Graph() as graph:
        abroad = graph.node.create_publisher(RawScan, "/joint/raw", KEEP_ALL_QOS)

        def subscriptions(count: int) -> None:
            graph.wait_until(lambda: abroad.get_subscription_count() == count, "the subscriptions", process.turn)

        subscriptions(1)
        abroad.publish(MESSAGES[0])
        graph.wait_until(lambda: taken == MESSAGES[:1], "a message over DDS", process.turn)
        outlet = outlet_of(plain(process, "/joint"))
        subscriptions(0)
        assert inlet.has_publisher()
        outlet.publish(MESSAGES[1])
        assert taken == MESSAGES[:2]
        outlet.destroy()
        subscriptions(1)
        abroad.publish(MESSAGES[2])
        graph.wait_until(lambda: taken == MESSAGES, "a message over DDS again", process.turn)
        graph.wait_until(inlet.has_publisher, "the publisher in the graph", process.turn)
        inlet.destroy()
        subscriptions(0)


def test_topics_close_with_their_nodes() -> None:
    with Graph() as graph:

        def ends(publishers: int, subscriptions: int) -> bool:
            node = graph.node
            return (
                node.count_publishers("/joint/raw") == publishers and node.count_subscribers("/heard") == subscriptions
            )

        with Process() as process:
            outlet_of(plain(process, "/joint"), "raw")
            Inlet(plain(process, "/posor"), RawScan, "/heard", KEEP_ALL_QOS, print)
            graph.wait_until(lambda: ends(1, 1), "both")
        graph.wait_until(lambda: ends(0, 0), "neither")


def test_an_inactive_node_hands_on_nothing(process: Process) -> None:
    taken: list[bytes] = []
    node = plain(process, "/joint")
    outlet = outlet_of(node)
    Inlet(plain(process, "/posor"), RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
    with Graph() as graph:
        received = graph.collect(RawScan, "/joint/raw", raw=True)
        graph.wait_until(lambda: outlet.count == 2, "the subscription")
        node.trigger_deactivate()
        assert not outlet.publish(MESSAGES[0])
        node.trigger_activate()
        assert outlet.publish(MESSAGES[1])
        graph.wait_until(lambda: bool(received), "the message of the active node")
    assert taken == received == [MESSAGES[1]]


class FailingNode(PlainNode):
    """Fails in its hooks once it is told to."""

    failure: Exception | None = None

    def activate(self) -> None:
        if self.failure is not None:
            raise self.failure

    deactivate = activate


@pytest.mark.parametrize("failure", [ParameterError("refused"), ZeroDivisionError("a bug")])
@pytest.mark.parametrize("hook", ["activate", "deactivate"])
def test_a_node_whose_hook_fails_hands_on_nothing_unless_it_stays_active(
    process: Process, hook: str, failure: Exception
) -> None:
    taken: list[bytes] = []
    node = process.start(FailingNode, "/joint")
    outlet = outlet_of(node)
    Inlet(plain(process, "/posor"), RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
    if hook == "activate":
        node.trigger_deactivate()
    node.failure = failure
    getattr(node, f"trigger_{hook}")()
    stays = hook == "deactivate" and isinstance(failure, ParameterError)
    assert outlet.publish(MESSAGES[0]) == stays
    assert taken == MESSAGES[:stays]
    node.failure = None


def test_who_listens_is_told_as_they_come_and_go(process: Process) -> None:
    counts: list[int] = []
    outlet = outlet_of(plain(process, "/joint"), on_count=counts.append)
    assert not outlet.is_wanted
    inlet = Inlet(plain(process, "/posor"), RawScan, "/joint/raw", KEEP_ALL_QOS, print)
    with Graph() as graph:
        graph.collect(RawScan, "/joint/raw")
        graph.wait_until(lambda: counts == [1, 2], "two listeners", process.turn)
        assert outlet.is_wanted
        inlet.destroy()
        assert counts == [1, 2, 1]
        assert outlet.count == 1
        assert outlet.is_wanted
    wait_until(lambda: len(counts) == 4, "the listener's end", process.turn)
    assert not outlet.is_wanted
    assert counts == [1, 2, 1, 0]


def test_the_ends_of_a_topic_must_agree_on_its_type(process: Process) -> None:
    node = plain(process, "/joint")
    outlet_of(node, "raw")
    with pytest.raises(TopicError) as caught:
        Inlet(node, JointTransform, "raw", KEEP_ALL_QOS, print)
    assert str(caught.value) == (
        "topic /joint/raw: is of type posor_msgs/msg/JointTransform here; "
        "expected posor_msgs/msg/RawScan, as another node of this process has it."
    )


def test_what_a_listener_raises_ends_its_program_and_not_the_publisher(process: Process) -> None:
    sender, broken, sound = (plain(process, f"/{name}") for name in ("sender", "broken", "sound"))
    taken: list[bytes] = []

    heard: list[bytes] = []

    def fail(data: bytes) -> None:
        heard.append(data)
        raise TopicError(f"{len(data)} bytes are too many", where="topic /joint/raw")

    Inlet(broken, RawScan, "/joint/raw", KEEP_ALL_QOS, fail)
    Inlet(sound, RawScan, "/joint/raw", KEEP_ALL_QOS, taken.append)
    outlet = outlet_of(sender)
    for data in MESSAGES:
        outlet.publish(data)
    assert taken == MESSAGES
    assert heard == MESSAGES[:1]
    assert [node.exit_requested for node in (sender, broken, sound)] == [False, True, False]
    broken.request_exit(TopicError("is not what went wrong first", where="topic /joint/raw"))
    with pytest.raises(TopicError, match="bytes are too many"):
        broken.raise_failure()
