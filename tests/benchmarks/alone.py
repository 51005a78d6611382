"""The machine alone: waits for the ticks of a rate as drivers do, and does nothing: ``alone.py RATE SPIN_US FILE``.

What is late here is late for every program on this machine. Ends on SIGINT and then writes what it found (JSON).
"""

from __future__ import annotations

import gc
import json
import sys
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor_drivers.ros_time import WallTime, wake_exactly
from posor_drivers.simulator.ticks import first_tick_after, stamp_of
from posor_estimator.ros.main import StopSignal, own_arguments

from tests.benchmarks.accounts import PERCENTILES
from tests.benchmarks.machine import stolen_s

if TYPE_CHECKING:
    from collections.abc import Callable

READY = "waiting for ticks"
"""What it prints when it has begun."""


def lateness(rate: int, time: WallTime, stopped: Callable[[], bool]) -> dict[str, Any]:
    """Wait for tick after tick until told to stop; return how late each began [us] and how many were missed.

    As in a driver, a tick whose successor is due as well is missed.
    """
    late_ns, missed = array("q"), 0
    tick = first_tick_after(time.now_ns, rate)
    begun = tick
    while not stopped():
        due_ns = stamp_of(tick, rate)
        while (now_ns := time.now_ns) < due_ns:
            time.wait(due_ns)
        newest = first_tick_after(now_ns, rate) - 1
        late_ns.append(now_ns - stamp_of(newest, rate))
        missed += newest - tick
        tick = newest + 1
    late_us = np.array(late_ns) / 1e3
    shares = {name: float(np.percentile(late_us, share)) for name, share in PERCENTILES.items()}
    return {**shares, "expected": tick - begun, "missed": missed}


def main() -> None:
    """Run the program."""
    rate, spin_us, file = own_arguments(sys.argv)
    stop = StopSignal()
    gc.disable()
    wake_exactly()
    print(READY, flush=True)
    before_s = stolen_s()
    found = lateness(int(rate), WallTime(1000 * int(spin_us)), lambda: stop.requested)
    found["stolen_s"] = stolen_s() - before_s
    Path(file).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
