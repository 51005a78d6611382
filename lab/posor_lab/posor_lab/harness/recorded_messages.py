# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag as rosbags reads them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.rosbag2 import Reader

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path


def read_bag(path: Path, topics: Collection[str] | None = None) -> list[tuple[str, int, bytes]]:
    """Return topic, log time [ns] and bytes of the messages of some topics, in order; None: of all."""
    with Reader(path) as reader:
        chosen = [each for each in reader.connections if topics is None or each.topic in topics]
        return [(each.topic, time_ns, bytes(data)) for each, time_ns, data in reader.messages(chosen)]
