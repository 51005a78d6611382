# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Speed of the core: ``./run posor_lab bench_core`` (``make bench-core``).

Processor time for each design: microseconds for one scan with its covariances (``Posor.estimate``), and scans per
second of many scans in one call (``Posor.estimate_all``).
"""

from __future__ import annotations

import math
from statistics import median
from time import thread_time
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.designs import DesignName, design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import STATED_HOME
from posor.numerics.compiled import MODE
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.harness.random_poses import STACKS, TICK_NS
from posor_lab.lab_output import parse_study, write_json

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS = 9


def _measure_stack(stack: DesignName, single_count: int, batch_count: int) -> dict[str, float]:
    """Return the figures of one design after a check that single and batch estimates agree."""
    posor = Posor(design(stack))
    thetas = 0.05 * np.sin(np.arange(batch_count) * 1e-3)
    rotations = np.array([rotation_from_native(1e-3 * math.sin(t), 1e-3 * math.cos(t), t) for t in thetas])
    translations = np.tile([1e-4, -1e-4, 0.7e-3], (batch_count, 1))
    stamps = np.arange(1, batch_count + 1, dtype=np.int64) * TICK_NS
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(1)).editable()
    scans.at_home[0] = STATED_HOME
    batch = posor.estimate_all(scans)
    posor.reset()
    singles = [scans[n] for n in range(single_count)]
    for n, scan in enumerate(singles):
        estimate = posor.estimate(scan)
        if estimate.state != batch.states[n] or estimate.state is State.LOST or estimate.T_R_T is None:
            message = f"{stack}: scan {n} is lost, or its state differs between single and batch estimate"
            raise AssertionError(message)
        if not np.allclose(estimate.T_R_T.translation, batch.translations[n], rtol=0.0, atol=1e-12):
            message = f"{stack}: scan {n} differs by more than 1e-12 m between single and batch estimate"
            raise AssertionError(message)

    def time_per_scan(count: int, work: Callable[[], object]) -> float:
        """Return the median time per scan [s]."""
        seconds = []
        for _ in range(ROUNDS):
            posor.reset()
            begin = thread_time()
            work()
            seconds.append((thread_time() - begin) / count)
        return median(seconds)

    return {
        "scalar_us": 1e6 * time_per_scan(single_count, lambda: [posor.estimate(scan) for scan in singles]),
        "scans_per_s": 1.0 / time_per_scan(batch_count, lambda: posor.estimate_all(scans)),
    }


@reports_errors
def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark, print a table and write a JSON file."""
    parser = CommandLineParser(prog="bench_core", description=str(__doc__).splitlines()[0])
    options = parse_study(parser, "build/bench_core.json", arguments)
    figures = {stack: _measure_stack(stack, 2_000, 20_000) for stack in STACKS}
    title = f"Speed of the core, kernels by {MODE}; processor time, medians of {ROUNDS} rounds"
    columns = ("stack", "one scan, us", "many scans, scans/s")
    rows = [(stack, f"{row['scalar_us']:.1f}", f"{row['scans_per_s']:,.0f}") for stack, row in figures.items()]
    ReportTable(title, columns, rows).print(report_console(118))
    write_json(options.output, figures)
    return 0
