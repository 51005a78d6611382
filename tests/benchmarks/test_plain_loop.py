"""Bags that are to be the same: what differs between them is found and named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from geometry_msgs.msg import PointStamped
from posor_drivers.bag_writer import BagWriter
from posor_estimator.errors import BagError
from posor_estimator.ros.message_types import POINT_STAMPED, MessageTypes
from rclpy.serialization import serialize_message

from tests.benchmarks.plain_loop import check_same

if TYPE_CHECKING:
    from pathlib import Path

TOPICS = ("/one", "/other")


def written(bag: Path, numbers: list[float], topics: tuple[str, ...] = TOPICS) -> Path:
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


def test_bag_may_go_on_after_the_plain_loop_has_ended(tmp_path: Path) -> None:
    check_same(written(tmp_path / "plain", [1.0, float("nan")]), written(tmp_path / "long", [1.0, float("nan"), 3.0]))


@pytest.mark.parametrize(
    ("numbers", "topics", "said"),
    [
        ([1.0, 2.0000000000000004], TOPICS, "message 1 of /one"),
        ([1.0], TOPICS, "message 1 of /one"),
        ([1.0, 2.0], TOPICS[:1], "message 0 of /other"),
        ([1.0, 2.0], (*TOPICS, "/third"), "message 0 of /third"),
    ],
)
def test_what_differs_is_named(tmp_path: Path, numbers: list[float], topics: tuple[str, ...], said: str) -> None:
    plain, other = written(tmp_path / "plain", [1.0, 2.0]), written(tmp_path / "other", numbers, topics)
    with pytest.raises(BagError) as caught:
        check_same(plain, other)
    assert str(caught.value) == (
        f"{other}: {said} is another than the plain loop's; expected the same to the last bit."
    )
