"""The pace of a live source: on ticks, in order, never bunched; and a wait that ends at once."""

from __future__ import annotations

from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import pytest
from posor_drivers.live import Misses, live
from posor_drivers.ros_wait import RosWait
from posor_drivers.sources.base import LiveSource, SourceMessage
from posor_estimator.ros.message_types import MessageTypes
from posor_estimator.ros.parameters import ParameterGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.time import Time

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PERIOD = 10


class Metronome(LiveSource[ParameterGroup]):
    """Ticks every 10 ns; each is published 3 ns later. Six in a run, counted from the first multiple of six."""

    Parameters = ParameterGroup
    endless = False
    record = "nothing"

    def open(self) -> Sequence[Any]:
        return []

    def inputs(self) -> Sequence[Any]:
        return []

    def begin(self, now_ns: int) -> tuple[int, int | None]:
        self.begun = [*getattr(self, "begun", []), now_ns]
        first = now_ns // PERIOD + 1
        return first, None if self.endless else -(-first // 6) * 6 + 5

    def newest(self, now_ns: int) -> int:
        return now_ns // PERIOD

    def due_ns(self, tick: int) -> int:
        return tick * PERIOD + 3

    def messages(self, tick: int) -> Iterator[SourceMessage]:
        yield SourceMessage("raw", tick * PERIOD, str(tick).encode())
        yield SourceMessage("truth", tick * PERIOD, b"")


class Wall:
    """Stands in for a RosWait: a clock that comes to each time waited for, or as late as it is told."""

    def __init__(self, now_ns: int, late: dict[int, int] | None = None, *, ends_at: int | None = None) -> None:
        self.now_ns = now_ns
        self.late = late or {}
        self.ends_at = ends_at
        self.ended = False

    def until(self, time_ns: int) -> bool:
        if self.ends_at is not None and time_ns >= self.ends_at:
            self.ended = True
            return False
        if time_ns in self.late:
            going_back = self.late[time_ns] < self.now_ns
            self.now_ns = self.late.pop(time_ns)
            return not going_back
        self.now_ns = max(self.now_ns, time_ns)
        return True


def ticks(wall: Wall, source: Metronome | None = None) -> tuple[list[int], int]:
    misses = Misses()
    source = source or Metronome(ParameterGroup(), MessageTypes())
    dues = list(live(source, wall, misses))  # type: ignore[arg-type]
    assert [due.topic for due in dues] == ["raw", "truth"] * (len(dues) // 2)
    assert {due.after_s for due in dues} <= {0.0}
    return [int(due.content) for due in dues if due.topic == "raw"], misses.count


def test_run_goes_from_the_next_tick_to_the_end_of_a_cycle() -> None:
    assert ticks(Wall(600)) == (list(range(61, 72)), 0)
    assert ticks(Wall(599)) == (list(range(60, 66)), 0)


def test_ticks_that_were_missed_are_counted_and_left_out() -> None:
    # Asked to wait for tick 62 at 623, the process comes back at 655: 62, 63, 64 are over, 65 is due.
    assert ticks(Wall(600, {623: 655})) == ([61, *range(65, 72)], 3)


def test_a_little_late_is_not_missed() -> None:
    assert ticks(Wall(600, {623: 632})) == (list(range(61, 72)), 0)


def test_scan_is_missed_only_when_the_next_one_is_due_not_when_it_has_happened() -> None:
    assert ticks(Wall(600, {623: 651})) == ([61, 64, *range(65, 72)], 2)


def test_last_tick_is_published_even_if_the_process_wakes_after_the_end() -> None:
    assert ticks(Wall(600, {693: 90_000})) == ([*range(61, 69), 71], 2)


def test_waiting_that_is_ended_ends_the_run() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    source.endless = True
    assert ticks(Wall(600, ends_at=1000), source) == (list(range(61, 100)), 0)


def test_clock_that_goes_back_begins_the_run_again() -> None:
    source = Metronome(ParameterGroup(), MessageTypes())
    assert ticks(Wall(600, {643: 23}), source) == ([61, 62, 63, *range(3, 12)], 0)
    assert source.begun == [600, 23]


@pytest.fixture
def simulated_clock() -> Any:
    clock: Any = Clock(clock_type=ClockType.ROS_TIME)
    clock._set_ros_time_is_active(enabled=True)  # what rclpy's own time source does
    return clock


def at(clock: Any, now_ns: int) -> None:
    clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))


class Waiter:
    """A thread that waits, and what came of it."""

    def __init__(self, wait: RosWait, time_ns: int) -> None:
        self.came = Event()
        self.reached: bool | None = None
        self._begun = Event()
        self.thread = Thread(target=self._run, args=(wait, time_ns), daemon=True)
        self.thread.start()
        assert self._begun.wait(30.0)

    def _run(self, wait: RosWait, time_ns: int) -> None:
        self._begun.set()
        self.reached = wait.until(time_ns)
        self.came.set()


def test_simulated_time_is_waited_for(simulated_clock: Any) -> None:
    at(simulated_clock, 1000)
    wait = RosWait(simulated_clock)
    waiter = Waiter(wait, 2000)
    at(simulated_clock, 1999)
    assert not waiter.came.is_set()
    at(simulated_clock, 2000)
    assert waiter.came.wait(30.0)
    assert waiter.reached
    wait.end()


def test_waiting_ends_at_once_though_the_clock_stands_still(simulated_clock: Any) -> None:
    at(simulated_clock, 1000)
    wait = RosWait(simulated_clock)
    waiter = Waiter(wait, 2000)
    wait.end()
    assert waiter.came.wait(30.0)
    assert waiter.reached is False
    assert wait.until(0) is False


def test_waiting_on_the_wall_ends_at_once_though_the_time_is_far() -> None:
    clock = Clock(clock_type=ClockType.ROS_TIME)
    wait = RosWait(clock)
    assert wait.until(wait.now_ns)
    waiter = Waiter(wait, wait.now_ns + 3600 * 10**9)
    wait.end()
    assert waiter.came.wait(30.0)
    assert waiter.reached is False


def test_waiting_tells_that_time_has_gone_back(simulated_clock: Any) -> None:
    at(simulated_clock, 1000)
    wait = RosWait(simulated_clock)
    assert wait.until(1000)
    waiter = Waiter(wait, 2000)
    at(simulated_clock, 500)
    assert waiter.came.wait(30.0)
    assert waiter.reached is False
    assert not wait.ended
    assert wait.until(400)
    wait.end()
