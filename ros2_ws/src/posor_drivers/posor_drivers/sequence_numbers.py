# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lost messages of a topic, by gaps in the sequence numbers of its publishers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class SequenceNumbers:
    """Counts lost messages of a topic with any number of publishers.

    rclpy of Jazzy states the sequence number of a message, but not its publisher. So a number that is not the next one
    of any publisher counts as a gap after the nearest lower number. If this is another publisher's, the sum of the gaps
    is still right: it is the sum of the last numbers, less that of the first ones, less the messages received since.

    A publisher may have any number when its first message is received. So while fewer publishers are received than the
    topic has had, a gap counts as the begin of one of them. It stays hidden if that publisher never sends a message.

    Attributes:
        lost: Messages known to be lost.

    """

    def __init__(self, count_publishers: Callable[[], int]) -> None:
        """``count_publishers`` returns how many publishers the topic has had; called for numbers out of sequence."""
        self.lost = 0
        self._count_publishers = count_publishers
        self._last: list[int] = []  # of each publisher that was received

    def add(self, number: int) -> None:
        """Count a message that was received."""
        before = max((each for each in self._last if each < number), default=None)
        if before is None or (before != number - 1 and self._count_publishers() > len(self._last)):
            self._last.append(number)
            return
        self.lost += number - before - 1
        self._last[self._last.index(before)] = number
