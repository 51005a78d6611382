# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Regularity and latency of a node's publications over the last second, as a status line of its diagnostics."""

from __future__ import annotations

from time import time_ns
from typing import TYPE_CHECKING

import numpy as np
from posor.numerics.stamps import NEVER_NS, NS, TimestampLog
from posor.numerics.summary_statistics import FIGURES, figures_of
from rclpy.clock import ROSClock

from posor_ros.diagnostics import Level

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.node_parameters import LimitParameters
    from posor.numerics.array_types import IntArray
    from rclpy.clock import Clock

    from posor_ros.diagnostics import Status, Value

TIMING_STATUS = "timing"  # name of the status line
MAX_LATENCY_NS = 10 * NS  # a stamp further than this from the present belongs to a recording and has no latency


def time_statistics(name: str, times_ns: IntArray, limit_ns: int = NEVER_NS) -> dict[str, float]:
    """Return mean, standard deviation, minimum and maximum [s] of times [ns], (n,); empty without times.

    Times whose absolute value reaches the limit are left out.
    """
    out = np.empty(FIGURES)
    if not figures_of(times_ns, limit_ns, out):
        return {}
    keys = (f"{name}_{key}" for key in ("mean", "sd", "min", "max"))
    return dict(zip(keys, (out * 1e-9).tolist(), strict=True))


class Timing:
    """Period and latency of a node's publications.

    Every `PosorNode` has one, ``self.timing``. A node calls ``self.timing.record(stamp_ns)`` right after the
    publications of one scan, always from the same thread. The status line ``timing``, once a second, and the parameters
    ``limits.*`` need no further call. Its values are in seconds, over the last second in which anything was published.

    Attributes:
        record: Takes the stamp [ns] of the scan published just now; takes a fraction of a microsecond.
        now_ns: Returns the node's ROS time [ns]; of an active node.

    """

    def __init__(self, status: Status, clock: Clock, limits: Callable[[], LimitParameters]) -> None:
        """Create an empty record; ``clock`` stamps the scans, ``limits`` returns the limits in force."""
        self._status = status
        self._clock = clock
        self._limits = limits
        self._log = TimestampLog()
        self.record = self._log.record
        self.restart()

    def restart(self) -> None:
        """Discard the record: the pause that ends now is not a period."""
        # Where ROS time is system time, time_ns() is the same clock, without the detour through rclpy.
        simulated = isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active
        self.now_ns = self._log.now_ns = self._simulated_ns if simulated else time_ns
        self._log.drain()
        self._last_ns = np.empty(0, np.int64)
        self._status.report(Level.OK, "nothing was published")

    def report(self) -> None:
        """Report the statistics since the last call; called once a second."""
        stamps_ns, times_ns = self._log.drain()
        periods_ns = np.diff(np.concatenate([self._last_ns, times_ns]))
        self._last_ns = times_ns[-1:]
        if not times_ns.size:
            self._status.report(Level.OK, "nothing was published")
            return
        limits, warnings = self._limits(), []
        latency = time_statistics("latency", times_ns - stamps_ns, MAX_LATENCY_NS)
        if latency and latency["latency_max"] > limits.latency:
            warnings.append(f"latency above {limits.latency:g} s")
        period = time_statistics("period", periods_ns)
        if period:
            mean = period["period_mean"]
            if max(mean - period["period_min"], period["period_max"] - mean) > limits.jitter:
                warnings.append(f"period off its mean by more than {limits.jitter:g} s")
        values: dict[str, Value] = {**latency, **period}
        self._status.report(Level.WARN if warnings else Level.OK, "; ".join(warnings) or "in time", values)

    def _simulated_ns(self) -> int:
        return int(self._clock.now().nanoseconds)
