"""How regularly and how soon a node publishes: the figures of the last second, as a line of its diagnostics."""

from __future__ import annotations

from time import time_ns
from typing import TYPE_CHECKING

import numpy as np
from rclpy.clock import ROSClock

from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.moments import NS, Moments, figures

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.clock import Clock

    from posor_estimator.core.types import IntArray
    from posor_estimator.ros.diagnostics import Status, Value
    from posor_estimator.ros.parameters import LimitParameters

STATUS = "timing"
"""Name of the status line."""
OF_THE_PRESENT_NS = 10 * NS
"""A stamp that is further than this from the present comes from a recording, and has no latency."""


class Timing:
    """Period and latency of what a node publishes.

    Every `PosorNode` has one, as ``self.timing``. A node calls ``self.timing.note(stamp_ns)`` right after it has
    published what belongs to one scan, always from the same thread; all else (the status line ``timing`` once a second,
    the parameters ``limits.*``) happens without it. The line's values are in seconds and of the last second in which
    anything was published.

    Attributes:
        note: Takes the stamp [ns] of what was published just now; costs a fraction of a microsecond.

    """

    def __init__(self, status: Status, clock: Clock, limits: Callable[[], LimitParameters]) -> None:
        """Have nothing noted yet.

        Args:
            status: The line.
            clock: The node's clock, to which the stamps belong.
            limits: Returns the limits in force.

        """
        self._status = status
        self._clock = clock
        self._limits = limits
        self._moments = Moments()
        self.note = self._moments.note
        self.restart()

    def restart(self) -> None:
        """Forget what was noted: the time without publications that ends now was no period."""
        # Where ROS time is the wall's, it is the same clock, read without the way through rclpy.
        simulated = isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active
        self._moments.now_ns = self._simulated_ns if simulated else time_ns
        self._moments.take()
        self._last_ns = np.empty(0, np.int64)
        self._status.report(Level.OK, "nothing was published")

    def report(self) -> None:
        """Bring the line up to date with what was noted since the last call; called once a second."""
        stamps_ns, times_ns = self._moments.take()
        periods_ns = np.diff(np.concatenate([self._last_ns, times_ns]))
        self._last_ns = times_ns[-1:]
        if not times_ns.size:
            self._status.report(Level.OK, "nothing was published")
            return
        self._tell(periods_ns, times_ns - stamps_ns)

    def _tell(self, periods_ns: IntArray, latencies_ns: IntArray) -> None:
        limits, late = self._limits(), []
        latency = figures("latency", latencies_ns, OF_THE_PRESENT_NS)
        if latency and latency["latency_max"] > limits.latency:
            late.append(f"latency above {limits.latency:g} s")
        period = figures("period", periods_ns)
        if period:
            mean = period["period_mean"]
            if max(mean - period["period_min"], period["period_max"] - mean) > limits.jitter:
                late.append(f"period off its mean by more than {limits.jitter:g} s")
        values: dict[str, Value] = {**latency, **period}
        self._status.report(Level.WARN if late else Level.OK, "; ".join(late) or "in time", values)

    def _simulated_ns(self) -> int:
        return int(self._clock.now().nanoseconds)
