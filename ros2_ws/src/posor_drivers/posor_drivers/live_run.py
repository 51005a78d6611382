"""Publishes what a live source has, when it is due: in the thread of the process's ticker."""

from __future__ import annotations

from threading import Thread
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType

from posor_drivers.replayer import LOOKOUT_S, ReplayState
from posor_drivers.ros_time import is_simulated
from posor_drivers.ticker import Beat, Ticker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rclpy.node import Node

    from posor_drivers.ros_time import RosTime
    from posor_drivers.timeline import Due, Pause


class LiveRun:
    """Waits until it may start, then takes part in the ticker of its rate until it is stopped or the run ends."""

    def __init__(
        self,
        node: Node,
        rate: float,
        spin_us: int,
        dues: Callable[[RosTime], Iterator[Due | Pause]],
        publish: Callable[[Due], None],
        may_start: Callable[[], bool],
        on_state: Callable[[ReplayState, Exception | None], None],
    ) -> None:
        """Prepare a run.

        Args:
            node: The driver.
            rate: Ticks of the source per second.
            spin_us: See the driver's parameter.
            dues: Makes the timeline for a ROS time; called when the run begins.
            publish: Publishes one message.
            may_start: Whether enough listeners are there; asked until it is so.
            on_state: Told of each new state, with the error when it failed. May take its time.

        """
        self._node = node
        self._rate = rate
        self._spin_ns = 1000 * spin_us
        self._dues = dues
        self._publish = publish
        self._may_start = may_start
        self._report = on_state
        self._ticker: Ticker | None = None
        self._beat: Beat | None = None
        self._ending: Thread | None = None
        self._timer: Any = None
        self._simulated = False
        self.stopping = False

    @property
    def beat(self) -> Beat | None:
        """The driver's part in the ticker, once it has one."""
        return self._beat

    @property
    def clock_has_changed(self) -> bool:
        """Whether the time has become simulated, or is no longer, since the run began."""
        return self._beat is not None and is_simulated(self._node.get_clock()) != self._simulated

    def start(self) -> None:
        """Begin as soon as there are enough listeners; the executor looks."""
        self._report(ReplayState.WAITING, None)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._node.create_timer(LOOKOUT_S, self._look, clock=steady)

    def _look(self) -> None:
        if self._timer is not None and self._may_start():
            self._stop_looking()
            self._simulated = is_simulated(self._node.get_clock())
            self._report(ReplayState.RUNNING, None)
            self._ticker, self._beat = Ticker.joined(self._node.get_clock(), self._rate, self._spin_ns, self._begun)

    def _begun(self, time: RosTime) -> Beat:
        return Beat(time, self._dues(time), self._publish, self._on_end)

    def _stop_looking(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None

    def stop(self) -> bool:
        """Stop after the message in hand; return whether there was anything left to do."""
        self.stopping = True
        self._stop_looking()
        if self._ticker is None or self._beat is None:
            return True
        was_left = self._beat.end()
        self._ticker.remove(self._beat)
        if self._ending is not None:
            self._ending.join()
        return was_left

    def _on_end(self, error: Exception | None) -> None:
        """Report the end in a thread of its own: what is late to be delivered must not hold back other drivers."""
        state = ReplayState.ENDED if error is None else ReplayState.FAILED
        self._ending = Thread(target=self._report, args=(state, error), name="end of run")
        self._ending.start()
