# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from posor.numerics.stamps import tick_stamp_ns
from posor_lab.benchmark.empty_loop import measure_lateness

RATE = 2000
FIRST = 1_800_000_000 * RATE


class LateClock:
    """A WallClock that returns 100 us after each tick, and once 1350 us after."""

    def __init__(self) -> None:
        self.now_ns = tick_stamp_ns(FIRST, RATE)
        self.waits = 0

    def wait(self, time_ns: int) -> None:
        self.waits += 1
        self.now_ns = time_ns + (1_350_000 if self.waits == 4 else 100_000)


def test_empty_loop_misses_the_ticks_that_a_driver_would_miss() -> None:
    clock = LateClock()
    lateness = measure_lateness(RATE, clock, lambda: clock.waits == 10)  # type: ignore[arg-type]
    assert [lateness[key] for key in ("expected", "missed", "p50_us", "max_us")] == [12, 2, 100.0, 350.0]
