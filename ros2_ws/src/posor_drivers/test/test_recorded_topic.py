"""A recorded topic: lost messages are counted, and the subscription fits all publishers."""

from __future__ import annotations

import pytest
from posor_drivers.recorded_topic import DEPTH, RecordedTopic, strictest_request
from posor_lab.harness.graph import Graph
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.usefixtures("ros_domain")
def test_lost_messages_are_counted() -> None:
    with Graph() as graph:
        tap = Node("_tap", context=graph.node.context, enable_rosout=False)
        publisher = graph.node.create_publisher(String, "/words", BEST_EFFORT)
        topic = RecordedTopic(tap, "/words", "std_msgs/msg/String", [BEST_EFFORT])
        graph.wait_until(lambda: publisher.get_subscription_count() == 1 and topic.matched, "the subscription")
        publisher.publish(String(data="first"))
        graph.wait_until(lambda: topic.received == 1, "the first message", lambda: list(topic.take_messages()))
        for index in range(DEPTH + 300):  # more than the subscription holds, and nothing is taken meanwhile
            publisher.publish(String(data=str(index)))
        taken = [deserialize_message(data, String).data for _, data in topic.take_messages()]
        assert taken == [str(index) for index in range(300, DEPTH + 300)]
        assert (topic.received, topic.lost) == (1 + DEPTH, 300)
        tap.destroy_node()


@pytest.mark.parametrize(
    ("offers", "reliable", "latched"),
    [
        ([RELIABLE], True, False),
        ([BEST_EFFORT], False, False),
        ([RELIABLE, BEST_EFFORT], False, False),
        ([LATCHED], True, True),
        ([LATCHED, RELIABLE], True, False),
    ],
)
def test_request_is_the_strictest_that_all_offers_satisfy(
    offers: list[QoSProfile], *, reliable: bool, latched: bool
) -> None:
    profile = strictest_request(offers, 9)
    assert profile.depth == 9
    assert (profile.reliability == ReliabilityPolicy.RELIABLE) == reliable
    assert (profile.durability == DurabilityPolicy.TRANSIENT_LOCAL) == latched
