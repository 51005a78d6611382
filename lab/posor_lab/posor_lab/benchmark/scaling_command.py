# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""scaling: figures for the planning of a cell of many arms (``make scaling``).

Measures one arm, and the reprocessing of its bags on two Dask workers; computes bandwidth, hosts, discovery, clocks and
cost of the cell. Prints tables, writes a JSON file, and with ``--page`` the tables of docs/how_to/scaling.md.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import report_console
from posor_bringup.bringup_options import prepare_output_folder
from posor_ros.node_program import ros_context
from rich.console import Console

from posor_lab.benchmark.benchmark_sections import BenchmarkArms
from posor_lab.benchmark.benchmark_tables import host_lines, to_markdown
from posor_lab.benchmark.graph_load import GraphLoad
from posor_lab.benchmark.graph_measurement import GraphMeasurement
from posor_lab.benchmark.performance_page import replace_tables
from posor_lab.benchmark.scaling_measurement import PROGRAM, measure_cluster, measure_recorded_arm
from posor_lab.benchmark.scaling_tables import scaling_tables
from posor_lab.benchmark.tick_statistics import host_description
from posor_lab.harness.ros_domain import isolated_network
from posor_lab.lab_output import check_writable, write_json
from posor_lab.reports.console_progress import interruption_check
from posor_lab.reports.trial_program import Option, parse_options

if TYPE_CHECKING:
    from collections.abc import Sequence

WIDTH = 118
WORKERS = (1, 2)
OPTIONS = (
    Option("--arms", 12, "arms of the cell", least=1, most=1000),
    Option("--joints", 6, "joints of an arm", least=1, most=16),
    Option("--rate", 1000, "scans per second of each joint", least=1, most=10_000),
    Option("--seconds", 10.0, "time of each measured graph", least=1, most=3600),
    Option("--bag-seconds", 30, "length of each of four bags for the cluster", least=1, most=36_000),
    Option("--cores", 8, "cores of a host of the cell", least=1, most=1024),
    Option("--share", 0.5, "share of the cores that the nodes may use", least=0.01, most=1.0),
    Option("--speed", 1.0, "speed of the endpoint [m/s]", least=0.0),
    Option("--price", 0.05, "price of a core hour, in any currency", least=0.0),
    Option("--output", Path("build/scaling.json"), "file of the figures"),
    Option("--page", "", "page whose tables are replaced, such as docs/how_to/scaling.md"),
)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all figures could be measured."""
    argv = sys.argv[1:] if arguments is None else arguments
    options = parse_options(PROGRAM, "Measure one arm, compute a cell.", OPTIONS, argv, "make scaling SCALING=--help")
    check_writable(options.output)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    folder = prepare_output_folder(options.output.resolve().with_suffix(""), ("arms", "runs", "cluster"))
    with isolated_network(), ros_context([PROGRAM]) as stop:
        interrupted = interruption_check(stop, PROGRAM)
        host = host_description()
        arms = BenchmarkArms(folder / "arms", options.joints)
        load = GraphLoad(arms[options.joints], "graph", "composed", options.rate)
        console.print(f"one arm, {options.joints} joints at {options.rate} Hz, its endpoint received, then recorded")
        received = GraphMeasurement(folder / "runs", interrupted).measure_graph(load, options.seconds)
        arm = measure_recorded_arm(load, options.seconds, folder / "runs" / "recorded", interrupted)
        console.print(f"reprocessing of {options.bag_seconds} s on {' and '.join(map(str, WORKERS))} Dask workers")
        cluster = measure_cluster(load.arm, arms.bag, folder / "cluster", options.bag_seconds, WORKERS)
    cell = {name: getattr(options, name) for name in ("arms", "joints", "rate", "cores", "share", "speed", "price")}
    ticks_per_s = (received.expected - received.counters["ticks_missed"]) / options.seconds
    arm |= {"name": load.arm.name, "tick_s_received": sum(received.cpu_cores.values()) / ticks_per_s}
    results: dict[str, Any] = {"host": host, "cell": cell, "arm": arm, "cluster": cluster}
    shutil.rmtree(folder / "runs")
    tables = scaling_tables(results)
    console.print("\n".join(host_lines(host)))
    for table in tables.values():
        table.print(report_console(WIDTH))
    if options.page:
        page, texts = Path(options.page), {name: to_markdown(table) for name, table in tables.items()}
        texts["host"] = "\n".join(host_lines(host)) + "\n"
        page.write_text(replace_tables(page.read_text(encoding="utf-8"), texts, tuple(texts)), encoding="utf-8")
    write_json(options.output, results)
    return 0
