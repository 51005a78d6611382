# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Timing statistics of a node's publications: of the last second, for present stamps, with limits that warn."""

from __future__ import annotations

import math
from time import time_ns
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from posor.node_parameters import LimitParameters
from posor.numerics.stamps import NS
from posor_ros.diagnostics import Level
from posor_ros.publication_timing import Timing, time_statistics
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.time import Time


def simulated_clock() -> Any:
    clock: Any = Clock(clock_type=ClockType.ROS_TIME)
    clock._set_ros_time_is_active(enabled=True)  # what rclpy's own time source does
    return clock


class TimedNode:
    def __init__(self, clock: Any, **limits: float) -> None:
        self.clock = clock
        self.status = Mock()
        self.timing = Timing(self.status, clock, lambda: LimitParameters(**limits))

    def publish(self, now_ns: int, stamp_ns: int) -> None:
        self.clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))
        self.timing.record(stamp_ns)

    def report(self) -> tuple[Level, str]:
        self.timing.report()
        level, message = self.status.report.call_args.args[:2]
        return level, message

    @property
    def values(self) -> dict[str, Any]:
        values: dict[str, Any] = self.status.report.call_args.args[2]
        return values


def test_statistics_equal_the_textbook_formulas() -> None:
    values = np.random.default_rng(5).integers(1, 10**9, 50)
    figures = {"mean": values.mean(), "sd": values.std(ddof=1), "min": values.min(), "max": values.max()}
    expected = {f"period_{key}": figure / NS for key, figure in figures.items()}
    assert time_statistics("period", values) == pytest.approx(expected)
    assert time_statistics("x", np.array([7]))["x_sd"] == 0.0


def test_latency_and_period_in_simulated_time_warn_beyond_their_limits() -> None:
    node = TimedNode(simulated_clock(), latency=0.5, jitter=0.2)
    for second in (100, 101, 102):
        node.publish(second * NS + NS // 4, second * NS)
    assert node.report() == (Level.OK, "in time")
    assert node.values == {
        **{f"latency_{key}": 0.25 for key in ("mean", "min", "max")},
        **{f"period_{key}": 1.0 for key in ("mean", "min", "max")},
        "latency_sd": 0.0,
        "period_sd": 0.0,
    }
    node.publish(103 * NS + NS * 3 // 4, 103 * NS)
    assert node.report() == (Level.WARN, "latency above 0.5 s")
    assert node.values["period_mean"] == 1.5
    for quarter in (4, 8, 9):
        now_ns = 104 * NS + quarter * NS // 4
        node.publish(now_ns, now_ns)
    assert node.report() == (Level.WARN, "period off its mean by more than 0.2 s")
    assert node.report() == (Level.OK, "nothing was published")


def test_system_time_is_used_without_simulated_time() -> None:
    node = TimedNode(Clock(clock_type=ClockType.ROS_TIME))
    before = time_ns()
    node.timing.record(before)
    node.report()
    assert 0.0 <= node.values["latency_max"] <= (time_ns() - before) / NS
    assert "period_mean" not in node.values


def test_a_stamp_of_a_recording_has_no_latency() -> None:
    node = TimedNode(Clock(clock_type=ClockType.ROS_TIME), latency=1e-3)
    for _ in range(2):
        node.timing.record(478_000_000 * NS)  # February 1985
    assert node.report() == (Level.OK, "in time")
    assert not any(name.startswith("latency") for name in node.values)
    assert node.values["period_mean"] > 0.0


def test_the_pause_before_a_restart_is_no_period() -> None:
    node = TimedNode(simulated_clock())
    node.publish(NS, NS)
    node.timing.restart()
    node.status.report.assert_called_with(Level.OK, "nothing was published")
    for second in (1000, 1001):
        node.publish(second * NS, second * NS)
    node.report()
    assert node.values["period_max"] == 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_limit_must_be_positive(value: float) -> None:
    with pytest.raises(ValueError, match="greater than 0"):
        LimitParameters(latency=value)
