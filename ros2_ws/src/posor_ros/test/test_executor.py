# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The executor under load: many publishers and subscriptions of one process, which must neither hang nor starve."""

from __future__ import annotations

from pathlib import Path

import pytest
from posor_lab.harness.program import Program, script

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
