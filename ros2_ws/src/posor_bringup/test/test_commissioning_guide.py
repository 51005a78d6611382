# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recording beside the steps of a commissioning: what cannot be written is an error."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

import pytest
from posor.errors import PosorError
from posor_bringup.commissioning_guide import recording
from posor_lab.harness.full_disk import file_size_limit
from posor_lab.harness.graph import Graph
from posor_ros.node_program import ros_context
from std_msgs.msg import String

if TYPE_CHECKING:
    from pathlib import Path

SIZE = 200_000


@pytest.mark.usefixtures("ros_domain")
def test_a_recording_that_cannot_be_written_fails(tmp_path: Path) -> None:
    with ros_context(["commission"]), Graph() as graph:
        publisher = graph.publisher(String, "/text", subscriptions=0)

        def record() -> None:
            with recording(tmp_path / "bag", ["/text"], [], {}) as recorder:
                graph.wait_until(lambda: publisher.get_subscription_count() == 1, "the recorder")
                with file_size_limit(SIZE):
                    for _ in range(8):
                        publisher.publish(String(data=secrets.token_hex(SIZE)))
                    graph.wait_until(lambda: recorder.failure is not None, "the failure of the recorder")

        with pytest.raises(PosorError, match="File too large"):
            record()
