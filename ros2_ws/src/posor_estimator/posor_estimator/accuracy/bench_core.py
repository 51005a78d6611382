"""Speed of the core: ``./run posor_estimator bench_core`` (``make bench-core``).

For each design, of processor time: microseconds for one scan with its covariances in a lane, from arrays to arrays, and
from a scan to an estimate of its own (``Posor.locate``); scans per second in one call. The floor in the same run is the
loop that fills the lane and does not run it. A node's way, from bytes to bytes, is timed by ``bench_messages.py``.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from statistics import median
from time import thread_time
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from posor_estimator.accuracy.poses import STACKS, TICK_NS
from posor_estimator.accuracy.report import writable, write_json
from posor_estimator.core.compiled import COMPILING
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.fault import State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS = 9


def bench(stack: DesignName, scalar: int, vectorised: int) -> dict[str, float]:
    """Return the figures of one design; checks first that both ways give the same numbers."""
    posor = Posor(design(stack))
    thetas = 0.05 * np.sin(np.arange(vectorised) * 1e-3)
    rotations = np.array([rotation_from_native(1e-3 * math.sin(t), 1e-3 * math.cos(t), t) for t in thetas])
    translations = np.tile([1e-4, -1e-4, 0.7e-3], (vectorised, 1))
    stamps = np.arange(1, vectorised + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(1))
    scans.at_home[0] = 1
    together = posor.locate_all(scans)
    posor.reset()
    singles = [scans[n] for n in range(scalar)]
    alone = [posor.locate(scan) for scan in singles]
    for n, estimate in enumerate(alone):
        if estimate.state != together.states[n] or estimate.state is State.LOST or estimate.T_R_T is None:
            message = f"{stack}: scan {n} is not the same alone and together, or lost"
            raise AssertionError(message)
        if not np.allclose(estimate.T_R_T.translation, together.translations[n], rtol=0.0, atol=1e-12):
            message = f"{stack}: scan {n} differs by more than 1e-12 m between the two ways"
            raise AssertionError(message)

    def timed(count: int, work: Callable[[], object]) -> float:
        seconds = []
        for _ in range(ROUNDS):
            posor.reset()
            begin = thread_time()
            work()
            seconds.append((thread_time() - begin) / count)
        return median(seconds)

    lane = posor.lane()

    def in_lane(run: Callable[[], object]) -> None:
        for scan in singles:
            lane.fill(scan)
            run()

    in_turn = timed(scalar, lambda: in_lane(lane.run))
    floor = timed(scalar, lambda: in_lane(lambda: None))
    one = timed(scalar, lambda: [posor.locate(scan) for scan in singles])
    many = timed(vectorised, lambda: posor.locate_all(scans))
    return {
        "lane_us": 1e6 * in_turn,
        "lane_floor_us": 1e6 * floor,
        "scalar_us": 1e6 * one,
        "scans_per_s": 1.0 / many,
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark, print a table and write a JSON file."""
    parser = argparse.ArgumentParser(prog="bench_core", description=str(__doc__).splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("build/bench_core.json"), help="JSON file to write")
    options = parser.parse_args(arguments)
    try:
        writable(options.output)
    except PosorError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    figures = {stack: bench(stack, 2_000, 20_000) for stack in STACKS}
    how = "compiled" if COMPILING else "not compiled"
    title = f"Speed of the core, kernels {how}; processor time, medians of {ROUNDS} rounds"
    table = Table(title=title, title_justify="left")
    for column in ("stack", "in a lane, us", "floor: filling it, us", "scan to estimate, us", "together, scans/s"):
        table.add_column(column)
    for stack, row in figures.items():
        figures_us = [f"{row[name]:.1f}" for name in ("lane_us", "lane_floor_us", "scalar_us")]
        table.add_row(stack, *figures_us, f"{row['scans_per_s']:,.0f}")
    Console(width=118).print(table)
    write_json(options.output, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
