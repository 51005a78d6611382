"""bench: speed of the stack (``make bench``).

Measures latency, lost ticks, processor time and memory of the graph, from the stamp of a scan to the endpoint's pose in
another process, beside the same graph with nodes that compute nothing; their growth with joints and rate; the speed of
the estimator alone and of offline processing. Prints tables, writes a JSON file and a picture.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor_bringup.bringup_options import prepare_output_folder
from posor_ros.node_program import StopSignal
from posor_ros.ros_domain import isolated_network
from rich.console import Console

from posor_lab.benchmark.benchmark_sections import SECTIONS, BenchmarkArms, BenchmarkPlan, BenchmarkSections
from posor_lab.benchmark.benchmark_tables import host_lines, result_tables
from posor_lab.benchmark.graph_load import LAYOUTS
from posor_lab.benchmark.graph_measurement import GraphMeasurement
from posor_lab.benchmark.growth_lines import draw_growth
from posor_lab.benchmark.host_state import host_description
from posor_lab.benchmark.offline_benchmark import SECONDS
from posor_lab.benchmark.pass_through_nodes import register_nodes
from posor_lab.harness.graph import Graph
from posor_lab.output_files import check_writable, write_json

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

DEFAULT_SECTIONS = tuple(name for name in SECTIONS if name != "profile")
QUICK_SECTIONS = ("graph", "growth", "kernel", "offline")
MAX_RATE_HZ = 10_000
MAX_JOINTS = 16
GROWTH_HZ = 500
WIDTH = 118


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value is invalid.

    """
    description = "Measure the speed of the stack."
    parser = CommandLineParser(prog="make bench", description=description, help_call="make bench BENCH=--help")
    parser.add_argument("--quick", action="store_true", help="a minute instead of nine: fewer and shorter runs")
    parser.add_argument(
        "--seconds",
        type=float,
        help="measured time of the graph, and as long of the pass-through graph; default: 60, with --quick 6",
    )
    parser.add_argument("--joints", type=int, default=6, help="joints of the main graph; default: 6")
    parser.add_argument("--rate", type=int, default=2000, help="rate of the main graph [Hz]; default: 2000")
    parser.add_argument(
        "--layout", choices=list(LAYOUTS), default="composed", help="layout of the main graph; default: composed"
    )
    parser.add_argument(
        "--only", type=_parse_sections, metavar="SECTION,...", help=f"only some sections of {', '.join(SECTIONS)}"
    )
    parser.add_argument("--profile", action="store_true", help="also measure each stage of a tick")
    parser.add_argument("--output", type=Path, default=Path("build/bench.json"), help="default: build/bench.json")
    options = parser.parse_args(list(arguments))
    for name, least, most in (("joints", 1, MAX_JOINTS), ("rate", 1, MAX_RATE_HZ), ("seconds", 1, 3600)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            raise ParameterError(f"--{name} {value:g}", where=parser.prog, expected=f"{least} to {most}")
    return options


def _parse_sections(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    unknown = [name for name in names if name not in SECTIONS]
    if unknown:
        raise argparse.ArgumentTypeError(f"unknown section '{unknown[0]}'; expected some of {', '.join(SECTIONS)}")
    return names


def plan_of(options: Namespace) -> BenchmarkPlan:
    """Return the plan for the options."""
    quick = options.quick
    return BenchmarkPlan(
        joints=options.joints,
        rate=options.rate,
        layout=options.layout,
        seconds=options.seconds or (6.0 if quick else 60.0),
        rounds=1 if quick else 6,
        point_s=min(options.seconds or 60.0, 2.0 if quick else 5.0),
        offline_s=20 if quick else SECONDS,
        growth_joints=(1, 2) if quick else (1, 2, 4, 8, 16),
        growth_rate=GROWTH_HZ,
        growth_rates=() if quick else (500, 1000, 2000, 4000),
    )


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if all sections could be measured."""
    _run_benchmark(parse_options(sys.argv[1:] if arguments is None else arguments))
    return 0


def _run_benchmark(options: Namespace) -> None:
    check_writable(options.output)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    results: dict[str, Any] = {"host": host_description()}
    console.print("\n".join(host_lines(results["host"])))
    try:
        with StopSignal() as stop:
            _measure_sections(options, results, stop, console)
    finally:
        if len(results) > 1:  # also after an error
            _write_results(options, results, console)


def _measure_sections(options: Namespace, results: dict[str, Any], stop: StopSignal, console: Console) -> None:
    """Measure the selected sections and add their figures to ``results``."""
    plan = plan_of(options)
    selected = options.only or (QUICK_SECTIONS if options.quick else DEFAULT_SECTIONS)
    if options.profile:
        selected = (*selected, "profile")
    output = options.output.resolve()
    folder = prepare_output_folder(output.parent / output.stem, ("arms", "runs"))
    arms_folder = folder / "arms"
    with isolated_network(), Graph() as graph:
        arms = BenchmarkArms(arms_folder, max([plan.joints, *(plan.growth_joints if "growth" in selected else ())]))
        register_nodes(arms_folder)
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(arms_folder), os.environ.get("PYTHONPATH")]))
        measurement = GraphMeasurement(folder / "runs", graph, lambda: stop.requested)
        sections = BenchmarkSections(plan, measurement, arms, console.print)
        for name in SECTIONS:
            if name in selected:
                results |= getattr(sections, name)()


def _write_results(options: Namespace, results: dict[str, Any], console: Console) -> None:
    """Print the tables, write the JSON file, draw the growth."""
    table_console = Console(width=WIDTH)
    for table in result_tables(results).values():
        table_console.print(table.to_rich())
    if "growth" in results:
        picture = options.output.with_name(f"{options.output.stem}_growth.png")
        picture.write_bytes(draw_growth(results["growth"], options.joints, GROWTH_HZ))
        console.print(f"figure drawn in {picture}")
    write_json(options.output, results)


if __name__ == "__main__":
    sys.exit(main())
