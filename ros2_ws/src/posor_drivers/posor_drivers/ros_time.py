"""ROS time for a thread that waits for ticks of it: the wall's, kept by the steady clock, or simulated."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from threading import Event
from time import monotonic_ns, sleep, time_ns
from typing import TYPE_CHECKING, Any

from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.clock import Clock

NS = 1_000_000_000
CHECK_NS = NS
"""Time between two comparisons of the wall's clock with the steady one."""
STEP_NS = 5_000_000
"""A greater difference between the two than what was expected is a step of the wall's clock."""
SLEW = 1e-3
"""A smaller one is followed, by at most this share of the time."""
LOOKS = 5
"""Comparisons at a time; the one that took the least time counts."""
PRECISE_NS = 5_000_000
"""The last part of waiting, in which nothing wakes the thread but the time."""
_PR_SET_TIMERSLACK = 29


def is_simulated(clock: Clock) -> bool:
    """Return whether a clock's time is that of the topic ``/clock``."""
    return isinstance(clock, ROSClock) and bool(clock.ros_time_is_active)


def wake_exactly() -> None:
    """Have Linux wake this thread when it asked for it, not up to 50 us later to save power (``PR_SET_TIMERSLACK``)."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)


class RosTime(ABC):
    """A clock to wait on, in one thread.

    Attributes:
        turn_ns: The time by which all drivers of a turn decide what is due, so that late ones take the same tick [ns].
        epoch: Another number whenever time has gone back or was stepped; what was counted before is void then.
        steps: How often the wall's clock was stepped.
        step_s: By how much, the last time [s].

    """

    def __init__(self) -> None:
        """Begin."""
        self.turn_ns = 0
        self.epoch = 0
        self.steps = 0
        self.step_s = 0.0
        self._wake = Event()

    @property
    @abstractmethod
    def now_ns(self) -> int:
        """ROS time [ns]; 0 while the time is simulated and no clock message has come."""

    @abstractmethod
    def wait(self, time_ns: int) -> None:
        """Wait until a time [ns], the end of an epoch, a call of ``wake``, or less."""

    def wake(self) -> None:
        """End a wait that would take long; may be called from any thread."""
        self._wake.set()

    @abstractmethod
    def close(self) -> None:
        """Give back what was taken."""


class WallTime(RosTime):
    """The wall's time, as the steady clock tells it.

    The steady clock never jumps, and the kernel wakes by it exactly. Linux disciplines the rate of both alike (NTP,
    PTP), so that their difference changes only where somebody sets the wall's. Once a second it is looked at: a small
    change is made up for over the next second, so that no tick comes early or late by it at once; a great one is a
    step.
    """

    def __init__(
        self,
        spin_ns: int,
        *,
        steady_ns: Callable[[], int] = monotonic_ns,
        wall_ns: Callable[[], int] = time_ns,
        sleep_s: Callable[[float], object] = sleep,
    ) -> None:
        """Compare the clocks for the first time.

        Args:
            spin_ns: The last part of a wait, in which the thread does not sleep but looks at the clock [ns].
            steady_ns: The steady clock.
            wall_ns: The wall's clock.
            sleep_s: Sleeps for a time [s] of the steady clock.

        """
        super().__init__()
        self.spin_ns = spin_ns
        self._steady_ns, self._wall_ns, self._sleep_s = steady_ns, wall_ns, sleep_s
        self._compared_ns, self._offset_ns = self._compare()
        self._slope = 0.0

    @property
    def now_ns(self) -> int:
        """The wall's time [ns]."""
        return self._at(self._steady_ns())

    def wait(self, time_ns: int) -> None:
        """Wait, in the end without being woken by anything else."""
        steady_ns = self._steady_ns()
        if steady_ns - self._compared_ns >= CHECK_NS:
            epoch = self.epoch
            self._follow()
            if self.epoch != epoch:
                return
        left_ns = time_ns - self._at(steady_ns)
        if left_ns > PRECISE_NS:
            self._wake.wait(min(left_ns - PRECISE_NS // 2, CHECK_NS) / NS)
            self._wake.clear()
            return
        if left_ns > self.spin_ns:
            self._sleep_s((left_ns - self.spin_ns) / NS)
        end_ns = steady_ns + left_ns
        while self._steady_ns() < end_ns:
            pass

    def close(self) -> None:
        """Give back nothing: nothing was taken."""

    def _at(self, steady_ns: int) -> int:
        since_ns = min(steady_ns - self._compared_ns, CHECK_NS)
        return steady_ns + self._offset_ns + int(since_ns * self._slope)

    def _compare(self) -> tuple[int, int]:
        """Return a time of the steady clock and how far the wall's is ahead of it [ns]."""
        looks = []
        for _ in range(LOOKS):
            before_ns, wall_ns, after_ns = self._steady_ns(), self._wall_ns(), self._steady_ns()
            looks.append((after_ns - before_ns, before_ns, wall_ns))
        took_ns, before_ns, wall_ns = min(looks)
        steady_ns = before_ns + took_ns // 2
        return steady_ns, wall_ns - steady_ns

    def _follow(self) -> None:
        """Compare the clocks; go on towards what is right, or begin anew if the wall's was stepped."""
        steady_ns, offset_ns = self._compare()
        believed_ns = self._at(steady_ns) - steady_ns
        off_ns = offset_ns - believed_ns
        self._compared_ns = steady_ns
        if abs(off_ns) > STEP_NS:
            self._offset_ns, self._slope = offset_ns, 0.0
            self.epoch += 1
            self.steps += 1
            self.step_s = off_ns / NS
        else:
            self._offset_ns, self._slope = believed_ns, max(-SLEW, min(SLEW, off_ns / CHECK_NS))


class SimulatedTime(RosTime):
    """The time of the topic ``/clock``."""

    def __init__(self, clock: Clock) -> None:
        """Watch over a clock, until ``close``."""
        super().__init__()
        self._clock = clock
        self._newest_ns = 0
        smallest = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._watch = clock.create_jump_callback(smallest, post_callback=self._jumped)

    def _jumped(self, _jump: Any) -> None:
        self._wake.set()

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return int(self._clock.now().nanoseconds)

    def wait(self, time_ns: int) -> None:
        """Wait for the next message of the clock, if the time has not come."""
        if not self._has_come(time_ns):
            self._wake.wait()
            self._wake.clear()
            self._has_come(time_ns)

    def _has_come(self, time_ns: int) -> bool:
        now_ns = self.now_ns
        if now_ns < self._newest_ns:
            self.epoch += 1
            self._newest_ns = now_ns
            return True
        self._newest_ns = now_ns
        return now_ns >= time_ns

    def close(self) -> None:
        """Watch no more."""
        self._watch.unregister()
