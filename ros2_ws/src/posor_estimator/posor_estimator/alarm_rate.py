# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""When scans without a pose are a fault, and when they are the false alarms that a sound sensor shows too.

A test with a false-alarm probability p rejects a share p of sound scans. ``AlarmRate`` calls it a fault if several
scans in a row have no pose, or if ``WINDOW`` scans hold more of them than sound scans would (binomial distribution).
"""

from __future__ import annotations

import math
from collections import deque

WINDOW = 1000  # number of scans over which the rate is judged
SIGNIFICANCE = 1e-6  # largest probability that ``WINDOW`` sound scans are reported as a fault


def alarm_limit(probability: float) -> int:
    """Return the smallest number of alarms in ``WINDOW`` scans that sound scans reach with at most ``SIGNIFICANCE``."""
    fewer = 0.0  # probability of fewer alarms than ``count``
    for count in range(1, WINDOW):
        fewer += math.comb(WINDOW, count - 1) * probability ** (count - 1) * (1.0 - probability) ** (WINDOW - count + 1)
        if 1.0 - fewer <= SIGNIFICANCE:
            return count
    return WINDOW


class AlarmRate:
    """Counts scans without a pose."""

    def __init__(self, probability: float, in_a_row: int) -> None:
        """Start without alarms.

        ``probability``: that a sound scan has no pose; ``in_a_row``: consecutive scans without a pose that are a fault.
        """
        self._recent: deque[int] = deque(maxlen=alarm_limit(probability))
        self._row = 0
        self._last = -2
        self._in_a_row = in_a_row

    def add(self, scan: int) -> bool:
        """Count a scan without a pose; return whether there is a fault.

        ``scan``: number of the scan, counted with and without a pose.
        """
        self._row = self._row + 1 if scan == self._last + 1 else 1
        self._last = scan
        if self._row >= self._in_a_row:
            self._recent.clear()  # a lasting fault is reported as such and does not count for the rate afterwards
            return True
        self._recent.append(scan)
        return bool(self.excess(scan))

    def forget(self) -> None:
        """Forget the scans without a pose, which something else explains: a joint that waits to be counted."""
        self._recent.clear()

    def excess(self, scan: int) -> str:
        """Return the sentence on too many scans without a pose among the last ``WINDOW``; else empty."""
        count = len(self._recent)
        if count < (self._recent.maxlen or 0) or scan - self._recent[0] >= WINDOW:
            return ""
        return f"{count} of the last {WINDOW} scans without a pose, more than false alarms explain"
