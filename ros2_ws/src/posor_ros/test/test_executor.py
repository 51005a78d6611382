# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The executor under load: many publishers and subscriptions of one process, which must neither hang nor starve."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING

import pytest
from posor.node_parameters import NodeParameters
from posor_lab.harness.program import Program, script
from posor_ros.lifecycle_node import INPUT_CHECK_S, PosorNode
from posor_ros.node_program import NodeGroup, node_executor, ros_context
from posor_ros.timed_spin import TimedSpin
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.usefixtures("ros_domain")

BUSY = script(Path(__file__).with_name("busy_node.py"))


@pytest.mark.parametrize("seconds", [2, *(pytest.param(15, marks=pytest.mark.long) for _ in range(3))])
def test_twelve_publishers_at_500_hz_do_not_block_the_executor(seconds: int) -> None:
    """With events of deadlines the lock order of rmw_fastrtps 8.4.3 blocks such a process for good within 12 s."""
    with Program(BUSY) as node:
        node.wait_for_line(f"second {seconds}:")
        of_seconds = [line.split(": ")[1].split() for line in node.stdout if line.startswith("second")]
        assert all(int(count) > 0 for counts in of_seconds[1:] for count in counts)
        assert (node.end(), node.errors) == (0, [])


class SlowNode(PosorNode[NodeParameters]):
    """A node whose checks take most of the time between two checks."""

    NAME = "slow"
    Parameters = NodeParameters


def test_every_node_is_checked_where_the_checks_of_all_take_longer_than_their_interval() -> None:
    checked, until_s = Counter[int](), time.monotonic() + 20.0

    def check(number: int) -> None:
        time.sleep(0.7 * INPUT_CHECK_S)
        checked[number] += 1

    with ros_context(["test"]), NodeGroup() as nodes:
        for number in range(4):
            node = SlowNode(namespace=f"/slow{number}")
            node.add_input_check(lambda number=number: check(number))  # type: ignore[misc]
            nodes.add(node)
        nodes.run(lambda: checked[3] > 1 or time.monotonic() > until_s)
    assert min(checked[number] for number in range(4)) > 1


class LoadedNode(PosorNode[NodeParameters]):
    """A node whose events are never all handled: each makes another one before it ends."""

    NAME = "loaded"
    Parameters = NodeParameters
    in_flight = 10

    def __init__(self) -> None:
        super().__init__()
        self.checked, self.until_s = 0, time.monotonic() + 20.0
        self.add_input_check(self._count)

    def _count(self) -> None:
        self.checked += 1

    def feed_messages(self) -> None:
        publisher = self.create_publisher(Empty, "~/load", self.in_flight)

        def handle(_message: Empty) -> None:
            if self._is_due():
                publisher.publish(Empty())

        self.create_subscription(Empty, "~/load", handle, self.in_flight)
        for _ in range(self.in_flight):
            publisher.publish(Empty())

    def feed_requests(self) -> None:
        client = self.create_client(Trigger, "~/load")

        def handle(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            if self._is_due():
                client.call_async(Trigger.Request())
            return response

        self.create_service(Trigger, "~/load", handle)
        client.wait_for_service()
        for _ in range(self.in_flight):
            client.call_async(Trigger.Request())

    def _is_due(self) -> bool:
        time.sleep(2e-3)  # longer than an event takes to come
        return time.monotonic() < self.until_s


@pytest.mark.parametrize("feed", [LoadedNode.feed_messages, LoadedNode.feed_requests])
def test_node_that_has_too_much_to_do_is_checked_and_heeds_signals(feed: Callable[[LoadedNode], None]) -> None:
    with ros_context(["test"]), NodeGroup() as nodes:
        node = LoadedNode()
        feed(node)
        nodes.add(node)
        nodes.run(lambda: node.checked > 3)
        assert time.monotonic() < node.until_s


def test_spin_ends_at_once_from_another_thread() -> None:
    with ros_context(["test"]):
        node, spin, begin_s = LoadedNode(), TimedSpin(), time.monotonic()
        with node_executor([node]) as executor:
            for _ in range(2):
                timer = Timer(0.2, spin.end)
                timer.start()
                spin.run(executor, 60.0)
                timer.join()
        node.stop()
        assert time.monotonic() - begin_s < 30.0
