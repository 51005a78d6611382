# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A thread that waits for ticks as a driver does and does nothing else: ``empty_loop.py RATE SPIN_US FILE``.

A tick that is late here is late for every program on this host. Ends on SIGINT and writes its figures (JSON).
"""

from __future__ import annotations

import gc
import json
import sys
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.numerics.stamps import first_tick_after, tick_stamp_ns
from posor_drivers.ros_clock import WallClock, disable_timer_slack
from posor_ros.node_program import StopSignal, non_ros_arguments

from posor_lab.benchmark.tick_statistics import percentiles_us, stolen_s

if TYPE_CHECKING:
    from collections.abc import Callable

READY = "waiting for ticks"  # printed before the first tick


def measure_lateness(rate: int, clock: WallClock, stopped: Callable[[], bool]) -> dict[str, Any]:
    """Wait for ticks until stopped; return percentiles of the lateness [us] and the number of missed ticks.

    As in a driver, a tick is missed if the next one is due as well.
    """
    late_ns, missed = array("q"), 0
    tick = first_tick_after(clock.now_ns, rate)
    first = tick
    while not stopped():
        due_ns = tick_stamp_ns(tick, rate)
        while (now_ns := clock.now_ns) < due_ns:
            clock.wait(due_ns)
        newest = first_tick_after(now_ns, rate) - 1
        late_ns.append(now_ns - tick_stamp_ns(newest, rate))
        missed += newest - tick
        tick = newest + 1
    return {**percentiles_us(np.array(late_ns)), "expected": tick - first, "missed": missed}


def main() -> None:
    """Run the program."""
    rate, spin_us, file = non_ros_arguments(sys.argv)
    gc.disable()
    disable_timer_slack()
    with StopSignal() as stop:
        print(READY, flush=True)
        before_s = stolen_s()
        lateness = measure_lateness(int(rate), WallClock(1000 * int(spin_us)), lambda: stop.requested)
        lateness["stolen_s"] = stolen_s() - before_s
        Path(file).write_text(json.dumps(lateness), encoding="utf-8")


if __name__ == "__main__":
    main()
