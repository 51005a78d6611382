# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tick scheduler: drivers of one rate share a thread until they end, are stopped, or fail."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event, get_ident

import pytest
from posor_drivers.ros_clock import TickClock
from posor_drivers.sources.source import SourceMessage
from posor_drivers.tick_scheduler import Pause, TickScheduler, TickTask
from posor_ros.idle_scheduler import run_when_idle
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

PERIOD_NS = 2_000_000


Log = list[tuple[str, int]]
FOREVER = 10**9


class Driver:
    """Publishes ticks of a shared clock into ``log``; ends after ``count`` ticks, with ``error`` if it is set."""

    log: Log

    def __init__(self, clock: Clock, name: str, count: int = FOREVER, rate: float = 500.0) -> None:
        self.name, self.count = name, count
        self.threads = set[int]()
        self.ended = Event()
        self.error: Exception | None = None
        self.failure: Exception | None = None
        self.scheduler, self.task = TickScheduler.add_task(clock, rate, 0, self.make_task)

    def make_task(self, clock: TickClock) -> TickTask:
        return TickTask(clock, self.publications(clock), self.publish, self.end)

    def publications(self, clock: TickClock) -> Iterator[SourceMessage | Pause]:
        tick = clock.now_ns // PERIOD_NS
        for _ in range(self.count):
            tick += 1
            yield Pause(tick * PERIOD_NS)
            assert clock.now_ns >= tick * PERIOD_NS
            yield SourceMessage("raw", 0, tick, 0.0)
        if self.error is not None:
            raise self.error

    def publish(self, publication: SourceMessage) -> None:
        self.threads.add(get_ident())
        self.log.append((self.name, publication.data))

    def end(self, error: Exception | None) -> None:
        self.failure = error
        self.ended.set()

    def stop(self) -> None:
        assert self.task.end()
        self.scheduler.remove_task(self.task)
        assert not self.task.end()

    def wait_for_ticks(self, count: int) -> list[str]:
        """Wait until ``count`` further ticks of any driver are in the log; return their drivers."""
        before = len(self.log)
        while len(self.log) < before + count:
            assert not self.ended.wait(0.001)
        return [name for name, _ in self.log[before:]]


@pytest.fixture
def clock() -> Clock:
    Driver.log = []
    return Clock(clock_type=ClockType.ROS_TIME)


def test_drivers_of_one_rate_share_a_thread_and_keep_their_order(clock: Clock) -> None:
    first, second = Driver(clock, "first", 20), Driver(clock, "second", 20)
    assert first.scheduler is second.scheduler
    assert first.ended.wait(30.0)
    assert second.ended.wait(30.0)
    assert first.threads == second.threads != {get_ident()}
    assert (first.failure, second.failure) == (None, None)
    for tick in {tick for name, tick in Driver.log if name == "second"}:
        names = [name for name, at in Driver.log if at == tick]
        assert names in (["first", "second"], ["second"])
    due_ns, begun_ns = first.task.lateness.drain()
    assert due_ns.size == 20
    assert (begun_ns >= due_ns - 100_000).all()


def test_idle_work_waits_for_the_ticks_of_the_drivers(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MAX_WAIT_PERIODS", "MAX_WAIT_NS"):
        monkeypatch.setattr(f"posor_ros.idle_scheduler.{name}", 10**18)  # work never runs during a tick
    in_tick, waiting = Event(), Event()
    waited: list[bool] = []

    class ObservedEvent(Event):
        def wait(self, timeout: float | None = None) -> bool:
            waiting.set()
            return super().wait(timeout)

    monkeypatch.setattr("posor_ros.idle_scheduler._tick_ended", ObservedEvent())

    class SlowDriver(Driver):
        def publish(self, publication: SourceMessage) -> None:
            if not in_tick.is_set():
                in_tick.set()
                waited.append(waiting.wait(30.0))
            super().publish(publication)

    driver = SlowDriver(clock, "slow")
    assert in_tick.wait(30.0)
    assert run_when_idle(lambda: None)
    assert waited == [True]
    driver.stop()
    assert run_when_idle(lambda: None)


def test_drivers_of_other_rates_have_other_threads(clock: Clock) -> None:
    fast, slow = (Driver(clock, str(rate), rate=rate) for rate in (500.0, 250.0))
    fast.wait_for_ticks(3)
    while not slow.threads:
        slow.wait_for_ticks(1)
    assert fast.threads.isdisjoint(slow.threads)
    for driver in (fast, slow):
        driver.stop()


def test_thread_ends_with_its_last_driver_and_a_new_one_starts(clock: Clock) -> None:
    first, second = Driver(clock, "first"), Driver(clock, "second")
    first.stop()
    assert set(second.wait_for_ticks(3)) == {"second"}
    second.stop()
    count = len(Driver.log)
    third = Driver(clock, "third", 2)
    assert third.scheduler is not first.scheduler
    assert third.ended.wait(30.0)
    assert len(Driver.log) == count + 2


def test_failing_clock_ends_all_drivers_with_its_error(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    drivers = [Driver(clock, "first"), Driver(clock, "second")]
    broken = OSError("no clock")

    def wait(_until_ns: int) -> None:
        raise broken

    monkeypatch.setattr(drivers[0].scheduler.clock, "wait", wait)
    for driver in drivers:
        assert driver.ended.wait(30.0)
        assert driver.failure is broken
        assert not driver.task.end()
    third = Driver(clock, "third", 2)
    assert third.scheduler is not drivers[0].scheduler
    assert third.ended.wait(30.0)
    assert third.failure is None


def test_failing_driver_does_not_affect_the_others(clock: Clock) -> None:
    sound, failing = Driver(clock, "sound"), Driver(clock, "failing", 2)
    failing.error = OSError("no light")
    assert failing.ended.wait(30.0)
    assert failing.failure is failing.error
    assert not failing.task.end()
    sound.wait_for_ticks(3)
    sound.stop()
