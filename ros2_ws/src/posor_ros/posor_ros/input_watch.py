# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrivals of one input, and the sentence on its silence."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

SILENT_PERIODS = 10  # median periods without input that count as silence, unless ``max_silence`` is longer
PERIODS = 5  # number of last measured periods whose median is used, so that neither a pause nor a burst changes it


class InputWatch:
    """Arrivals of one input; its ``name`` for the reports is a topic or a source."""

    __slots__ = ("_arrivals", "_arrived_s", "_counted", "_counted_s", "_periods", "name")

    def __init__(self, name: str) -> None:
        """Create a watch; ``restart`` starts it."""
        self.name = name
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self.restart(-math.inf)

    def restart(self, now_s: float) -> None:
        """Forget all arrivals; silence begins at a steady time [s]."""
        self._arrivals = self._counted = 0
        self._arrived_s = self._counted_s = now_s
        self._periods.clear()

    def record(self, now_s: float) -> None:
        """Record an arrival at a steady time [s]; takes a fraction of a microsecond."""
        self._arrivals += 1
        self._arrived_s = now_s

    def silence(self, now_s: float, limit_s: float) -> str:
        """Return the sentence on a silence that exceeds the limit [s] and ``SILENT_PERIODS``; else empty."""
        arrivals, arrived_s = self._arrivals, self._arrived_s
        if arrivals > self._counted:
            if self._counted:
                self._periods.append((arrived_s - self._counted_s) / (arrivals - self._counted))
            self._counted, self._counted_s = arrivals, arrived_s
        age_s = now_s - arrived_s
        if age_s <= limit_s or (self._periods and age_s <= SILENT_PERIODS * median(self._periods)):
            return ""
        return f"no input on {self.name} {'for' if arrivals else 'since activation,'} {age_s:.2f} s"
