# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The executor under load: many publishers and subscriptions of one process, which must neither hang nor starve."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

import pytest
from posor.node_parameters import NodeParameters
from posor_lab.harness.program import Program, script
from posor_ros.lifecycle_node import INPUT_CHECK_S, PosorNode
from posor_ros.node_program import NodeGroup, ros_context

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
