# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A spin of the executor that handles all events of some time, and ends in time although events keep coming.

To begin a spin takes about as long as to receive a message, so a program that receives much does not spin for each
event. The executor looks at the time only while no event waits: callbacks end the spin of a process that has too much
to do, so that it still checks its inputs and heeds signals.
"""

from __future__ import annotations

from math import inf
from time import monotonic
from typing import Any

from rclpy.task import Future


class TimedSpin:
    """The present spin of an executor; one that was never run has no end."""

    def __init__(self) -> None:
        self._until = Future()
        self._end_s = inf

    def run(self, executor: Any, duration_s: float) -> None:
        """Handle events for a time [s], or until ``end``."""
        self._end_s = monotonic() + duration_s
        if self._until.done():
            self._until = Future()
        executor.spin_until_future_complete(self._until, duration_s)

    def end_if_due(self) -> None:
        """End the spin after the present event if its time is over."""
        if monotonic() >= self._end_s:
            self.end()

    def end(self) -> None:
        """End the spin after the present event, or at once if there is none; from any thread."""
        if not self._until.done():
            self._until.set_result(None)
