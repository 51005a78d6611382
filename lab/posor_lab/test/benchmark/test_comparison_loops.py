# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the loop's bag with a reprocessed bag: differences are found and named."""

from __future__ import annotations

from pathlib import Path

import pytest
from geometry_msgs.msg import PointStamped
from posor.bags.bag_writer import BagWriter
from posor.errors import BagError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import POINT_STAMPED
from posor_lab.benchmark.comparison_loops import check_same_messages
from rclpy.serialization import serialize_message

TOPICS = ("/one", "/other")


def write_bag(bag: Path, numbers: list[float], topics: tuple[str, ...] = TOPICS) -> Path:
    """Write a bag with these numbers on each topic, one each nanosecond."""
    with BagWriter(bag) as writer:
        for topic in topics:
            writer.add_topic(topic, POINT_STAMPED, MessageTypes().definition(POINT_STAMPED), [])
        for time_ns, number in enumerate(numbers, start=1):
            message = PointStamped()
            message.point.x = number
            for topic in topics:
                writer.write(topic, time_ns, serialize_message(message))
    return bag


def test_reprocessed_bag_may_be_longer(tmp_path: Path) -> None:
    check_same_messages(
        write_bag(tmp_path / "looped", [1.0, float("nan")]), write_bag(tmp_path / "long", [1.0, float("nan"), 3.0])
    )


@pytest.mark.parametrize(
    ("numbers", "topics", "difference"),
    [
        ([1.0, 2.0000000000000004], TOPICS, "message 1 of /one"),
        ([1.0], TOPICS, "message 1 of /one"),
        ([1.0, 2.0], TOPICS[:1], "message 0 of /other"),
        ([1.0, 2.0], (*TOPICS, "/third"), "message 0 of /third"),
    ],
)
def test_first_difference_is_named(
    tmp_path: Path, numbers: list[float], topics: tuple[str, ...], difference: str
) -> None:
    looped, other = write_bag(tmp_path / "looped", [1.0, 2.0]), write_bag(tmp_path / "other", numbers, topics)
    with pytest.raises(BagError) as caught:
        check_same_messages(looped, other)
    assert str(caught.value) == (
        f"{other}: {difference} differs from that of the loop message by message; expected the same bits."
    )
