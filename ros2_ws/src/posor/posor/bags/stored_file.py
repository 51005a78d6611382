# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A file of a bag: its topics, and the span of its log times. See ``mcap_storage.py`` and ``sqlite_storage.py``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np
from rosbags.interfaces import Connection

from posor.bags.recorded_topics import connection_of

if TYPE_CHECKING:
    from pathlib import Path

    from posor.bags.recorded_topics import BagMetadata, StoredTopic, Unread

LAST_TIME_NS = int(np.iinfo(np.int64).max)


class StoredFile(ABC):
    """An open file of a bag.

    Attributes:
        path: The file, as errors name it.
        connections: Its topics that can be read, with the number of their messages.
        unread: What is left out.
        notes: What else is missing, a sentence each.
        start_ns: First log time of all messages.
        end_ns: Last log time of all messages; before the first one: the file holds no message.

    """

    def __init__(self, path: Path) -> None:
        """Open the file that errors call ``path``."""
        self.path = path
        self.connections: list[Connection] = []
        self.unread: list[Unread] = []
        self.notes: list[str] = []
        self.start_ns, self.end_ns = LAST_TIME_NS, -1

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def _add_topic(self, topic: StoredTopic, messages: int, metadata: BagMetadata) -> None:
        found = connection_of(topic, messages, metadata)
        if isinstance(found, Connection):
            self.connections.append(found)
        elif messages:
            self.unread.append(found)
