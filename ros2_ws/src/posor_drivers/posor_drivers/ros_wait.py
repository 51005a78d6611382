"""Waiting for a time of the ROS clock, be it the wall's or simulated, in a way that can be ended at once."""

from __future__ import annotations

from threading import Event
from typing import TYPE_CHECKING, Any

from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration

if TYPE_CHECKING:
    from rclpy.clock import Clock

NS = 1_000_000_000


class RosWait:
    """Waits in one thread; ``end`` may be called from any other."""

    def __init__(self, clock: Clock) -> None:
        """Watch over a clock, until ``end``."""
        self._clock = clock
        self._wake = Event()
        self._newest_ns = 0
        self.ended = False
        smallest = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._watch = clock.create_jump_callback(smallest, post_callback=self._jumped)

    def _jumped(self, _jump: Any) -> None:
        self._wake.set()

    @property
    def now_ns(self) -> int:
        """ROS time [ns]; 0 while the time is simulated and no clock message has come."""
        return int(self._clock.now().nanoseconds)

    @property
    def _simulated(self) -> bool:
        return isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active

    def until(self, time_ns: int) -> bool:
        """Wait until a time [ns]; return whether it has come, false if the waiting was ended or time has gone back."""
        while not self.ended:
            self._wake.clear()
            now_ns = self.now_ns
            before_ns, self._newest_ns = self._newest_ns, now_ns
            if now_ns < before_ns:
                return False
            if now_ns >= time_ns:
                return True
            if not self.ended:  # an end that came before the flag was cleared
                self._wake.wait(None if self._simulated else (time_ns - now_ns) / NS)
        return False

    def end(self) -> None:
        """End all waiting, for good."""
        self.ended = True
        self._wake.set()
        self._watch.unregister()
