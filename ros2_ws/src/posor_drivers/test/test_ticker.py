"""The thread of the ticks: drivers of one rate in turn, each until it is done, stopped or fails."""

from __future__ import annotations

from threading import Event, Semaphore, get_ident
from time import sleep
from typing import TYPE_CHECKING

import pytest
from posor_drivers.ticker import Beat, Ticker
from posor_drivers.timeline import Due, Pause
from posor_estimator.ros.turns import between_ticks
from rclpy.clock import Clock
from rclpy.clock_type import ClockType

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_drivers.ros_time import RosTime

PERIOD_NS = 2_000_000


class Driver:
    """Publishes ticks of a shared clock; ends after a number of them, with an error if told so."""

    def __init__(self, clock: Clock, log: list[tuple[str, int]], name: str, count: int, rate: float = 500.0) -> None:
        self.log, self.name, self.count = log, name, count
        self.threads = set[int]()
        self.waited = False
        self.ended = Event()
        self.error: Exception | None = None
        self.failure: Exception | None = None
        self.ticker, self.beat = Ticker.joined(clock, rate, 0, self.made)

    def made(self, time: RosTime) -> Beat:
        return Beat(time, self.dues(time), self.publish, self.end)

    def dues(self, time: RosTime) -> Iterator[Due | Pause]:
        tick = time.now_ns // PERIOD_NS
        for _ in range(self.count):
            tick += 1
            yield Pause(tick * PERIOD_NS)
            assert time.now_ns >= tick * PERIOD_NS
            yield Due("raw", tick, 0.0)
        if self.error is not None:
            raise self.error

    def publish(self, due: Due) -> None:
        self.threads.add(get_ident())
        self.log.append((self.name, due.content))

    def end(self, error: Exception | None) -> None:
        self.failure = error
        self.ended.set()


@pytest.fixture
def clock() -> Clock:
    return Clock(clock_type=ClockType.ROS_TIME)


def test_drivers_of_one_rate_share_a_thread_and_go_in_turn(clock: Clock) -> None:
    log = list[tuple[str, int]]()
    first, second = Driver(clock, log, "first", 20), Driver(clock, log, "second", 20)
    assert first.ticker is second.ticker
    assert first.ended.wait(30.0)
    assert second.ended.wait(30.0)
    assert first.threads == second.threads != {get_ident()}
    assert (first.failure, second.failure) == (None, None)
    for tick in {tick for name, tick in log if name == "second"}:
        names = [name for name, at in log if at == tick]
        assert names in (["first", "second"], ["second"])
    due_ns, begun_ns = first.beat.late.take()
    assert due_ns.size == 20
    assert (begun_ns >= due_ns - 100_000).all()


def test_what_can_wait_waits_for_the_drivers_and_goes_on_between_their_ticks(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("PATIENCE", "MOST_PATIENCE_NS"):
        monkeypatch.setattr(f"posor_estimator.ros.turns.{name}", 10**18)  # else it goes on anyway
    log = list[tuple[str, int]]()
    at_work, looked = Event(), Semaphore(0)

    def look_again(seconds: float) -> None:
        looked.release()
        sleep(seconds)

    monkeypatch.setattr("posor_estimator.ros.turns.sleep", look_again)

    class Slow(Driver):
        def publish(self, due: Due) -> None:
            if not self.threads:
                super().publish(due)
                at_work.set()
                self.waited = all(looked.acquire(timeout=30.0) for _ in range(3))
            super().publish(due)

    driver = Slow(clock, log, "slow", 10**9)
    assert at_work.wait(30.0)
    assert between_ticks()
    assert driver.waited
    assert driver.beat.end()
    driver.ticker.remove(driver.beat)
    assert between_ticks()


def test_drivers_of_other_rates_have_other_threads(clock: Clock) -> None:
    log = list[tuple[str, int]]()
    drivers = [Driver(clock, log, str(rate), 3, rate) for rate in (500.0, 250.0)]
    for driver in drivers:
        assert driver.ended.wait(30.0)
    assert len(set.union(*(driver.threads for driver in drivers))) == 2


def test_thread_ends_with_its_last_driver_and_another_begins(clock: Clock) -> None:
    log = list[tuple[str, int]]()
    one = Driver(clock, log, "one", 10**9)
    other = Driver(clock, log, "other", 10**9)
    assert one.beat.end()
    one.ticker.remove(one.beat)
    before = len(log)
    while len(log) < before + 3:
        assert not other.ended.wait(0.001)
    assert {name for name, _ in log[before:]} == {"other"}
    assert other.beat.end()
    other.ticker.remove(other.beat)
    assert not other.beat.end()
    after = len(log)
    again = Driver(clock, log, "again", 2)
    assert again.ticker is not one.ticker
    assert again.ended.wait(30.0)
    assert len(log) == after + 2


def test_time_that_cannot_be_waited_for_ends_all_drivers_with_its_error(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = list[tuple[str, int]]()
    one, other = Driver(clock, log, "one", 10**9), Driver(clock, log, "other", 10**9)
    broken = OSError("no clock")

    def wait(_until_ns: int) -> None:
        raise broken

    monkeypatch.setattr(one.ticker.time, "wait", wait)
    for driver in (one, other):
        assert driver.ended.wait(30.0)
        assert driver.failure is broken
        assert not driver.beat.end()
    again = Driver(clock, log, "again", 2)
    assert again.ticker is not one.ticker
    assert again.ended.wait(30.0)
    assert again.failure is None


def test_one_that_fails_leaves_the_others_alone(clock: Clock) -> None:
    log = list[tuple[str, int]]()
    sound = Driver(clock, log, "sound", 10**9)
    failing = Driver(clock, log, "failing", 2)
    failing.error = OSError("no light")
    assert failing.ended.wait(30.0)
    assert failing.failure is failing.error
    assert not failing.beat.end()
    before = len(log)
    while len(log) < before + 3:
        assert not sound.ended.wait(0.001)
    assert sound.beat.end()
    sound.ticker.remove(sound.beat)
