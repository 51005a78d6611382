# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS time for a thread that waits for ticks: wall time kept by the steady clock, or simulated time."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from threading import Event
from time import monotonic_ns, sleep, time_ns
from typing import TYPE_CHECKING, Any

from posor.numerics.stamps import NS
from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.clock import Clock

CHECK_PERIOD_NS = NS
"""Time between two comparisons of the wall clock with the steady clock."""
STEP_NS = 5_000_000
"""A greater deviation of the wall clock is a step."""
MAX_SLEW = 1e-3
"""Greatest change of rate with which smaller deviations are followed."""
COMPARISONS = 5
"""Comparisons at a time; the shortest one counts."""
PRECISE_NS = 5_000_000
"""Last part of a wait, which ``wake`` does not interrupt."""
_PR_SET_TIMERSLACK = 29


def is_simulated(clock: Clock) -> bool:
    """Return whether a clock follows the topic ``/clock``."""
    return isinstance(clock, ROSClock) and bool(clock.ros_time_is_active)


def disable_timer_slack() -> None:
    """Make Linux wake this thread on time instead of up to 50 us later to save power (``PR_SET_TIMERSLACK``)."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


class TickClock(ABC):
    """A clock that one thread waits on.

    Attributes:
        turn_ns: Time at which the thread last woke; all drivers of the thread use it, so late ones take the same tick.
        epoch: Changes whenever time has gone back or was stepped; tick counts of an earlier epoch are invalid.
        steps: Number of steps of the wall clock.
        step_s: Size of the last step [s].

    """

    def __init__(self) -> None:
        self.turn_ns = 0
        self.epoch = 0
        self.steps = 0
        self.step_s = 0.0
        self._wake = Event()

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """ROS time [ns]; 0 for simulated time before the first clock message."""

    @abstractmethod
    def wait(self, time_ns: int) -> None:
        """Wait until a time [ns], the end of an epoch, or ``wake``; may return early."""

    def wake(self) -> None:
        """Interrupt a long wait; may be called from any thread."""
        self._wake.set()

    def close(self) -> None:  # noqa: B027  most clocks hold no resources
        """Release all resources."""


class WallClock(TickClock):
    """Wall time computed from the steady clock.

    The steady clock never jumps, and the kernel wakes threads by it. Linux disciplines the rate of both clocks alike
    (NTP, PTP), so their difference changes only when the wall clock is set. They are compared once a second: a small
    change is slewed over the next second, so that no tick moves by it at once; a large one is a step. A step is looked
    for with every wait, so that the drivers of a host, in any process, follow it with their next ticks.
    """

    def __init__(
        self,
        spin_ns: int,
        *,
        steady_ns: Callable[[], int] = monotonic_ns,
        wall_ns: Callable[[], int] = time_ns,
        sleep_s: Callable[[float], object] = sleep,
    ) -> None:
        """Compare the clocks for the first time; tests replace the clocks and the sleep.

        ``spin_ns`` is the last part of a wait, in which the thread polls the clock instead of sleeping [ns].
        """
        super().__init__()
        self.spin_ns = spin_ns
        self._steady_ns, self._wall_ns, self._sleep_s = steady_ns, wall_ns, sleep_s
        self._compared_ns, self._offset_ns = self._compare_clocks()
        self._slope = 0.0

    @property
    def now_ns(self) -> int:
        """Wall time [ns]."""
        return self._wall_time_at(self._steady_ns())

    def wait(self, time_ns: int) -> None:
        """Wait; ``wake`` does not interrupt the last part."""
        steady_ns = self._steady_ns()
        seems_stepped = abs(self._wall_ns() - self._wall_time_at(steady_ns)) > STEP_NS  # or this thread was interrupted
        if seems_stepped or steady_ns - self._compared_ns >= CHECK_PERIOD_NS:
            epoch = self.epoch
            self._follow_wall_clock()
            if self.epoch != epoch:
                return
        left_ns = time_ns - self._wall_time_at(steady_ns)
        if left_ns > PRECISE_NS:
            self._wake.wait(min(left_ns - PRECISE_NS // 2, CHECK_PERIOD_NS) / NS)
            self._wake.clear()
            return
        if left_ns > self.spin_ns:
            self._sleep_s((left_ns - self.spin_ns) / NS)
        end_ns = steady_ns + left_ns
        while self._steady_ns() < end_ns:
            pass

    def _wall_time_at(self, steady_ns: int) -> int:
        since_ns = min(steady_ns - self._compared_ns, CHECK_PERIOD_NS)
        return steady_ns + self._offset_ns + int(since_ns * self._slope)

    def _compare_clocks(self) -> tuple[int, int]:
        """Return a steady time and the offset of the wall clock [ns]."""
        comparisons = []
        for _ in range(COMPARISONS):
            before_ns, wall_ns, after_ns = self._steady_ns(), self._wall_ns(), self._steady_ns()
            comparisons.append((after_ns - before_ns, before_ns, wall_ns))
        duration_ns, before_ns, wall_ns = min(comparisons)
        steady_ns = before_ns + duration_ns // 2
        return steady_ns, wall_ns - steady_ns

    def _follow_wall_clock(self) -> None:
        """Compare the clocks; slew towards the wall clock, or start a new epoch if it was stepped."""
        steady_ns, offset_ns = self._compare_clocks()
        present_ns = self._wall_time_at(steady_ns) - steady_ns
        deviation_ns = offset_ns - present_ns
        self._compared_ns = steady_ns
        if abs(deviation_ns) > STEP_NS:
            self._offset_ns, self._slope = offset_ns, 0.0
            self.epoch += 1
            self.steps += 1
            self.step_s = deviation_ns / NS
        else:
            self._offset_ns = present_ns
            self._slope = max(-MAX_SLEW, min(MAX_SLEW, deviation_ns / CHECK_PERIOD_NS))


class SimulatedClock(TickClock):
    """Time of the topic ``/clock``."""

    def __init__(self, clock: Clock) -> None:
        """Watch a clock until ``close``."""
        super().__init__()
        self._clock = clock
        self._newest_ns = 0
        every_change = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._jump_callback = clock.create_jump_callback(every_change, post_callback=self._on_jump)

    def _on_jump(self, _jump: Any) -> None:
        self._wake.set()

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return int(self._clock.now().nanoseconds)

    def wait(self, time_ns: int) -> None:
        """Wait for the next clock message unless the time has come."""
        if not self._has_come(time_ns):
            self._wake.wait()
            self._wake.clear()
            self._has_come(time_ns)

    def _has_come(self, time_ns: int) -> bool:
        """Return whether a time has come, or time has gone back, which starts a new epoch."""
        now_ns = self.now_ns
        went_back = now_ns < self._newest_ns
        self.epoch += went_back
        self._newest_ns = now_ns
        return went_back or now_ns >= time_ns

    def close(self) -> None:
        """Stop watching the clock."""
        self._jump_callback.unregister()
