"""The figures of a node's timing: of the last second, from the present only, with limits that warn."""

from __future__ import annotations

import math
from time import time_ns
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.moments import NS, ROOM, Moments, figures
from posor_estimator.ros.parameters import LimitParameters
from posor_estimator.ros.timing import Timing
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.time import Time

if TYPE_CHECKING:
    from collections.abc import Mapping


class Line:
    """Takes what a status line would be told."""

    def __init__(self) -> None:
        self.level, self.message, self.values = Level.STALE, "", dict[str, Any]()

    def report(self, level: Level, message: str, values: Mapping[str, Any] | None = None) -> None:
        self.level, self.message, self.values = level, message, {**(values or {})}


class Told:
    """A clock that says what it is told to."""

    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        return self.now


def simulated_clock() -> Any:
    clock: Any = Clock(clock_type=ClockType.ROS_TIME)
    clock._set_ros_time_is_active(enabled=True)  # what rclpy's own time source does
    return clock


def at(clock: Any, now_ns: int) -> None:
    clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))


def timing(clock: Any, **limits: float) -> tuple[Timing, Any]:
    line: Any = Line()
    return Timing(line, clock, lambda: LimitParameters(**limits)), line


def test_moments_are_taken_once_and_in_order() -> None:
    clock = Told()
    moments = Moments(clock)
    assert [times.size for times in moments.take()] == [0, 0]
    for clock.now in (5, 7, 9):
        moments.note(clock.now - 1)
    told, happened = moments.take()
    assert (told.tolist(), happened.tolist()) == ([4, 6, 8], [5, 7, 9])
    assert [times.size for times in moments.take()] == [0, 0]


def test_more_moments_than_there_is_room_for_leave_the_last_ones() -> None:
    clock = Told()
    moments = Moments(clock)
    for clock.now in range(10 + ROOM + 3):
        moments.note(-clock.now)
    told, happened = moments.take()
    assert np.array_equal(happened, np.arange(13, 13 + ROOM))
    assert np.array_equal(told, -happened)


def test_figures_are_those_of_the_textbook() -> None:
    values = np.random.default_rng(5).integers(1, 10**9, 50)
    told = figures("period", values)
    assert told == pytest.approx(
        {
            "period_mean": values.mean() / NS,
            "period_sd": values.std(ddof=1) / NS,
            "period_min": values.min() / NS,
            "period_max": values.max() / NS,
        }
    )
    assert figures("x", np.array([7]))["x_sd"] == 0.0


def test_latency_and_period_of_simulated_time_are_of_the_last_second_and_warn_beyond_the_limits() -> None:
    clock = simulated_clock()
    node, line = timing(clock, latency=0.5, jitter=0.2)
    for second in (100, 101, 102):
        at(clock, second * NS + NS // 4)
        node.note(second * NS)
    node.report()
    assert (line.level, line.message) == (Level.OK, "in time")
    assert line.values == {
        "latency_mean": 0.25,
        "latency_sd": 0.0,
        "latency_min": 0.25,
        "latency_max": 0.25,
        "period_mean": 1.0,
        "period_sd": 0.0,
        "period_min": 1.0,
        "period_max": 1.0,
    }
    at(clock, 103 * NS + NS * 3 // 4)
    node.note(103 * NS)
    node.report()
    assert (line.level, line.message) == (Level.WARN, "latency above 0.5 s")
    assert line.values["period_mean"] == 1.5
    for quarter in (4, 8, 9):
        at(clock, 104 * NS + quarter * NS // 4)
        node.note(104 * NS + quarter * NS // 4)
    node.report()
    assert (line.level, line.message) == (Level.WARN, "period off its mean by more than 0.2 s")
    node.report()
    assert (line.level, line.message) == (Level.OK, "nothing was published")


def test_the_wall_is_the_clock_where_time_is_not_simulated() -> None:
    node, line = timing(Clock(clock_type=ClockType.ROS_TIME))
    before = time_ns()
    node.note(before)
    node.report()
    assert 0.0 <= line.values["latency_max"] <= (time_ns() - before) / NS
    assert "period_mean" not in line.values


def test_stamp_of_a_recording_has_no_latency() -> None:
    node, line = timing(Clock(clock_type=ClockType.ROS_TIME), latency=1e-3)
    for _ in range(2):
        node.note(478_000_000 * NS)  # February 1985
    node.report()
    assert (line.level, line.message) == (Level.OK, "in time")
    assert not any(name.startswith("latency") for name in line.values)
    assert line.values["period_mean"] > 0.0


def test_time_without_publications_before_a_restart_is_no_period() -> None:
    clock = simulated_clock()
    node, line = timing(clock)
    at(clock, NS)
    node.note(NS)
    node.restart()
    assert line.message == "nothing was published"
    for second in (1000, 1001):
        at(clock, second * NS)
        node.note(second * NS)
    node.report()
    assert line.values["period_max"] == 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_limits_are_times(value: float) -> None:
    with pytest.raises(ValueError, match="greater than 0"):
        LimitParameters(latency=value)
