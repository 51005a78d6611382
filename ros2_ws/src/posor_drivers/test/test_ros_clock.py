# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Waiting for ROS time: wall time by the steady clock, simulated time by its messages."""

from __future__ import annotations

import time
from itertools import pairwise
from threading import Event, Semaphore, Thread
from typing import Any

import pytest
from posor.numerics.stamps import NS
from posor_drivers.ros_clock import MAX_SLEW, PRECISE_NS, STEP_NS, SimulatedClock, WallClock, is_simulated
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.time import Time

BEGIN = 1_000 * NS


class Clocks:
    """A steady clock that goes on only while somebody sleeps or looks, and a wall's clock that is set at will."""

    def __init__(self) -> None:
        self.steady = 77 * NS
        self.offset = BEGIN - self.steady
        self.slept = list[int]()

    def steady_ns(self) -> int:
        self.steady += 10
        return self.steady

    def wall_ns(self) -> int:
        return self.steady + self.offset

    def sleep_s(self, seconds: float) -> None:
        self.slept.append(round(seconds * NS))
        self.steady += round(seconds * NS)

    def wall_time(self, spin_ns: int = 0) -> WallClock:
        return WallClock(spin_ns, steady_ns=self.steady_ns, wall_ns=self.wall_ns, sleep_s=self.sleep_s)


def run_for(clocks: Clocks, wall: WallClock, duration_ns: int) -> list[int]:
    """Wait for ticks a millisecond apart; return how far from the wall's clock each came [ns]."""
    off, begin = [], clocks.steady
    while clocks.steady - begin < duration_ns:
        tick_ns = (wall.now_ns // 1_000_000 + 1) * 1_000_000
        while wall.now_ns < tick_ns:
            wall.wait(tick_ns)
        off.append(clocks.wall_ns() - tick_ns)
    return off


def test_ticks_follow_the_wall_clock() -> None:
    clocks = Clocks()
    wall = clocks.wall_time()
    assert abs(wall.now_ns - BEGIN) < 200
    off = run_for(clocks, wall, 2 * NS)
    assert min(off) > -50
    assert max(off) < 200


def test_last_part_of_a_wait_is_polled() -> None:
    clocks = Clocks()
    wall = clocks.wall_time(spin_ns=20_000)
    due = wall.now_ns + 400_000
    wall.wait(due)
    assert clocks.slept == [pytest.approx(380_000, abs=100)]
    assert wall.now_ns >= due


def test_small_change_of_the_wall_clock_is_slewed() -> None:
    clocks = Clocks()
    wall = clocks.wall_time()
    clocks.offset += STEP_NS // 2
    before = wall.now_ns
    wall.wait(before + 1000)
    assert wall.steps == 0
    off = run_for(clocks, wall, 6 * NS)
    changes = [later - earlier for earlier, later in pairwise(off)]
    assert max(map(abs, changes)) < 1_000_000 * MAX_SLEW + 200
    assert abs(off[-1]) < 200
    assert (wall.epoch, wall.steps) == (0, 0)


@pytest.mark.parametrize("step_s", [0.5, -0.5, 3600.0])
def test_step_of_the_wall_clock_is_detected_with_the_next_wait(step_s: float) -> None:
    clocks = Clocks()
    wall = clocks.wall_time()
    clocks.offset += round(step_s * NS)
    begin = clocks.steady
    wall.wait(wall.now_ns + 1_000_000)
    assert clocks.steady - begin < 1000
    assert (wall.epoch, wall.steps) == (1, 1)
    assert wall.step_s == pytest.approx(step_s, abs=1e-6)
    assert abs(wall.now_ns - clocks.wall_ns()) < 200
    assert max(map(abs, run_for(clocks, wall, 3 * NS))) < 200
    assert wall.steps == 1


def test_real_clocks_agree() -> None:
    wall = WallClock(0)
    due = time.time_ns() + PRECISE_NS // 2
    wall.wait(due)
    assert time.time_ns() >= due - 100_000


def test_long_wait_can_be_interrupted() -> None:
    wall, woken = WallClock(0), Event()

    def wait() -> None:
        for _ in range(3):
            wall.wait(wall.now_ns + 3600 * NS)
        woken.set()

    thread = Thread(target=wait, daemon=True)
    thread.start()
    while not woken.is_set():
        wall.wake()
        woken.wait(0.01)
    thread.join()


@pytest.fixture
def clock() -> Any:
    clock: Any = Clock(clock_type=ClockType.ROS_TIME)
    assert not is_simulated(clock)
    clock._set_ros_time_is_active(enabled=True)  # what rclpy's own time source does
    assert is_simulated(clock)
    return clock


def at(clock: Any, now_ns: int) -> None:
    clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))


class Waiter:
    """A thread that waits for a simulated time as a ticker does."""

    def __init__(self, simulated: SimulatedClock, time_ns: int) -> None:
        self.came = Event()
        self._looked = Semaphore(0)
        self._thread = Thread(target=self._run, args=(simulated, time_ns), daemon=True)
        self._thread.start()
        assert self.waits()

    def _run(self, simulated: SimulatedClock, time_ns: int) -> None:
        epoch = simulated.epoch
        while simulated.now_ns < time_ns and simulated.epoch == epoch:
            self._looked.release()
            simulated.wait(time_ns)
        self.came.set()
        self._looked.release()

    def waits(self) -> bool:
        """Return whether it goes on waiting after it has looked at the time once more."""
        assert self._looked.acquire(timeout=30.0)
        return not self.came.is_set()


def test_simulated_time_is_waited_for(clock: Any) -> None:
    at(clock, 1000)
    simulated = SimulatedClock(clock)
    waiter = Waiter(simulated, 2000)
    at(clock, 1999)
    assert waiter.waits()
    at(clock, 2000)
    assert waiter.came.wait(30.0)
    assert simulated.epoch == 0
    simulated.close()


def test_simulated_time_that_goes_back_starts_a_new_epoch(clock: Any) -> None:
    at(clock, 1000)
    simulated = SimulatedClock(clock)
    simulated.wait(1000)
    waiter = Waiter(simulated, 2000)
    at(clock, 500)
    assert waiter.came.wait(30.0)
    assert (simulated.epoch, simulated.now_ns) == (1, 500)
    simulated.wait(400)
    assert simulated.epoch == 1
    simulated.close()
