# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""bench: speed of the stack (``make bench``).

Measures latency, lost ticks, processor time and memory of the graph, from the stamp of a scan to the endpoint's pose in
another process, beside the same graph with nodes that compute nothing, and beside a live page; their growth with joints
and rate; the speed of the estimator alone and of offline processing. Prints tables, writes a JSON file and a page.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import report_console
from posor_bringup.bringup_options import prepare_output_folder
from posor_ros.node_program import ros_context
from rich.console import Console

from posor_lab.benchmark.benchmark_sections import SECTIONS, BenchmarkArms, BenchmarkPlan, BenchmarkSections
from posor_lab.benchmark.benchmark_tables import host_lines, result_tables
from posor_lab.benchmark.graph_load import LAYOUTS
from posor_lab.benchmark.graph_measurement import GraphMeasurement
from posor_lab.benchmark.growth_lines import growth_page
from posor_lab.benchmark.offline_benchmark import SECONDS
from posor_lab.benchmark.pass_through_nodes import register_nodes
from posor_lab.benchmark.tick_statistics import host_description
from posor_lab.harness.browser import missing_for_pages
from posor_lab.harness.ros_domain import isolated_network
from posor_lab.lab_output import check_writable, write_json
from posor_lab.reports.console_progress import interruption_check
from posor_lab.reports.trial_program import Option
from posor_lab.reports.trial_program import parse_options as parse

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor_ros.node_program import StopSignal

PROGRAM = "make bench"
DEFAULT_SECTIONS = tuple(name for name in SECTIONS if name != "profile")
QUICK_SECTIONS = ("start", "graph", "layouts", "tick", "growth", "kernel", "offline")
GROWTH_HZ = 500
WIDTH = 118
OPTIONS = (
    Option("--quick", default=False, text="three minutes instead of fifteen: fewer and shorter runs"),
    Option("--seconds", 0.0, "time of each main graph; 0: 60, with --quick 6", least=1, most=3600),
    Option("--joints", 6, "joints of the main graph", least=1, most=16),
    Option("--rate", 2000, "rate of the main graph [Hz]", least=1, most=10_000),
    Option("--layout", "composed", "layout of the main graph", choices=tuple(LAYOUTS)),
    Option("--only", "", f"only some sections, separated by commas, of {', '.join(SECTIONS)}"),
    Option("--profile", default=False, text="also measure each stage of a tick"),
    Option("--output", Path("build/bench.json"), "file of the figures"),
)


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
    options = parse(PROGRAM, "Measure the speed of the stack.", OPTIONS, arguments, "make bench BENCH=--help")
    options.seconds = options.seconds or (6.0 if options.quick else 60.0)
    options.only = tuple(options.only.split(",")) if options.only else ()
    if unknown := [name for name in options.only if name not in SECTIONS]:
        expected = f"some of {', '.join(SECTIONS)}"
        raise ParameterError(f"--only: unknown section '{unknown[0]}'", where=PROGRAM, expected=expected)
    return options


def plan_of(options: Namespace) -> BenchmarkPlan:
    """Return the plan for the options."""
    quick = options.quick
    return BenchmarkPlan(
        joints=options.joints,
        rate=options.rate,
        layout=options.layout,
        seconds=options.seconds,
        rounds=1 if quick else 6,
        starts=3 if quick else 10,
        page_rounds=1 if quick else 12,
        point_s=min(options.seconds, 2.0 if quick else 5.0),
        offline_s=20 if quick else SECONDS,
        growth_joints=(1, 2) if quick else (1, 2, 4, 8, 16),
        growth_rate=GROWTH_HZ,
        growth_rates=() if quick else (500, 1000, 2000, 4000),
    )


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all sections could be measured."""
    options = parse_options(sys.argv[1:] if arguments is None else arguments)
    check_writable(options.output)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    results: dict[str, Any] = {"host": host_description()}
    console.print("\n".join(host_lines(results["host"])))
    try:
        with isolated_network(), ros_context([PROGRAM]) as stop:
            _measure_sections(options, results, stop, console)
    finally:
        if len(results) > 1:  # also after an error
            _write_results(options, results, console)
    return 0


def _measure_sections(options: Namespace, results: dict[str, Any], stop: StopSignal, console: Console) -> None:
    """Measure the selected sections and add their figures to ``results``."""
    plan = plan_of(options)
    selected = options.only or (QUICK_SECTIONS if options.quick else DEFAULT_SECTIONS)
    if options.profile:
        selected = (*selected, "profile")
    if not options.only and "page" in selected and (missing := missing_for_pages()):
        selected = tuple(name for name in selected if name != "page")
        console.print(f"the live page is not measured: {missing} is not installed")
    output = options.output.resolve()
    folder = prepare_output_folder(output.parent / output.stem, ("arms", "runs"))
    arms_folder = folder / "arms"
    arms = BenchmarkArms(arms_folder, max([plan.joints, *(plan.growth_joints if "growth" in selected else ())]))
    register_nodes(arms_folder)
    sys.path.append(str(arms_folder))  # for the section ``tick``
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(arms_folder), os.environ.get("PYTHONPATH")]))
    measurement = GraphMeasurement(folder / "runs", interruption_check(stop, PROGRAM))
    sections = BenchmarkSections(plan, measurement, arms, console.print)
    for name in SECTIONS:
        if name in selected:
            results |= getattr(sections, name)()


def _write_results(options: Namespace, results: dict[str, Any], console: Console) -> None:
    """Print the tables, write the JSON file and the page of the growth."""
    for table in result_tables(results).values():
        table.print(report_console(WIDTH))
    if "growth" in results:
        page = options.output.with_name(f"{options.output.stem}_growth.html")
        page.write_text(growth_page(results["growth"], options.joints, GROWTH_HZ), encoding="utf-8")
        console.print(f"plots written to {page}")
    write_json(options.output, results)
