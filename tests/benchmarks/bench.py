"""Speed of the whole stack: ``make bench``.

Latency, losses, processor time and memory of the graph, from the stamp of a scan to the endpoint's pose in another
process, beside the floor, the same graph with nothing computed; how that grows with joints and rate; and the speed of
the estimator and of reprocessing alone. Prints tables, writes a JSON file and a figure.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor_bringup.command_line import prepare
from posor_estimator.accuracy.report import writable, write_json
from posor_estimator.errors import ParameterError
from posor_estimator.reporting.command_line import Parser
from posor_estimator.ros.domain import own_network
from posor_estimator.ros.main import StopSignal, exit_code_of
from posor_estimator.testing.graph import Graph
from rich.console import Console

from tests.benchmarks import floor, growth
from tests.benchmarks.kernel import kernel_figures
from tests.benchmarks.layouts import LAYOUTS
from tests.benchmarks.machine import machine
from tests.benchmarks.measuring import Bench
from tests.benchmarks.offline import SECONDS, offline_figures
from tests.benchmarks.sections import Arms, Plan, Sections
from tests.benchmarks.tables import machine_lines, tables

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

SECTIONS = ("graph", "faults", "waiting", "layouts", "growth", "highest", "profile", "kernel", "offline")
USUAL = tuple(name for name in SECTIONS if name != "profile")
QUICK = ("graph", "growth", "kernel", "offline")
"""What --quick leaves of them."""
FASTEST_HZ = 10_000
MOST_JOINTS = 16
GROWTH_HZ = 500
GROWTH_JOINTS, GROWTH_RATES = (1, 2, 4, 8, 16), (500, 1000, 2000, 4000)
QUICK_OFFLINE_S = 20
QUICK_JOINTS, QUICK_RATES = (1, 2), ()
WIDTH = 118
ROOT = Path(__file__).resolve().parents[2]


def parse(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="make bench", description=str(__doc__).splitlines()[0], help_call="make bench BENCH=--help")
    parser.add_argument("--quick", action="store_true", help="a minute instead of nine: fewer and shorter runs")
    parser.add_argument(
        "--seconds", type=float, help="measured time of graph and of floor, each; default: 60, with --quick 6"
    )
    parser.add_argument("--joints", type=int, default=6, help="of the main graph; default: 6")
    parser.add_argument("--rate", type=int, default=2000, help="of the main graph [Hz]; default: 2000")
    parser.add_argument(
        "--layout", choices=list(LAYOUTS), default="composed", help="of the main graph; default: composed"
    )
    parser.add_argument(
        "--only", type=_sections, metavar="SECTION,...", help=f"some parts only, of {', '.join(SECTIONS)}"
    )
    parser.add_argument("--profile", action="store_true", help="also take the time of a tick apart, stage by stage")
    parser.add_argument("--output", type=Path, default=ROOT / "build/bench.json", help="default: build/bench.json")
    options = parser.parse_args(list(arguments))
    for name, least, most in (("joints", 1, MOST_JOINTS), ("rate", 1, FASTEST_HZ), ("seconds", 1, 3600)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            raise ParameterError(f"--{name} {value:g}", where=parser.prog, expected=f"{least} to {most}")
    return options


def _sections(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    unknown = [name for name in names if name not in SECTIONS]
    if unknown:
        raise argparse.ArgumentTypeError(f"'{unknown[0]}' is no section; expected some of {', '.join(SECTIONS)}")
    return names


def _parts(options: Namespace) -> tuple[str, ...]:
    parts = options.only or (QUICK if options.quick else USUAL)
    return (*parts, *(["profile"] if options.profile else []))


def plan_of(options: Namespace) -> Plan:
    """Return what to measure."""
    quick = options.quick
    return Plan(
        joints=options.joints,
        rate=options.rate,
        layout=options.layout,
        seconds=options.seconds or (6.0 if quick else 60.0),
        rounds=1 if quick else 6,
        point_s=min(options.seconds or 60.0, 2.0 if quick else 5.0),
        offline_s=QUICK_OFFLINE_S if quick else SECONDS,
        growth_joints=QUICK_JOINTS if quick else GROWTH_JOINTS,
        growth_rate=GROWTH_HZ,
        growth_rates=QUICK_RATES if quick else GROWTH_RATES,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if everything could be measured."""
    return exit_code_of(lambda: _bench(sys.argv[1:] if arguments is None else arguments))


def _bench(arguments: Sequence[str]) -> None:
    options = parse(arguments)
    writable(options.output)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    results: dict[str, Any] = {"machine": machine()}
    console.print("\n".join(machine_lines(results["machine"])))
    stop = StopSignal()
    try:
        _measure(options, results, stop, console)
    finally:
        stop.restore()
        if len(results) > 1:  # also if something went wrong: what was measured until then
            _tell(options, results, console)


def _measure(options: Namespace, results: dict[str, Any], stop: StopSignal, console: Console) -> None:
    """Do all parts and put what they give into ``results``."""
    plan, parts = plan_of(options), _parts(options)
    folder = prepare(options.output.parent / options.output.stem, ("made", "runs"), "make bench")
    made = folder / "made"
    with own_network(), Graph() as graph:
        arms = Arms(made, max([plan.joints, *(plan.growth_joints if "growth" in parts else ())]))
        floor.register(made)
        _let_find(ROOT, made)
        sections = Sections(plan, Bench(folder / "runs", graph, lambda: stop.requested), arms, console.print)
        for name in SECTIONS:
            if name in parts:
                results |= _measured(name, sections, arms, plan, made)


def _tell(options: Namespace, results: dict[str, Any], console: Console) -> None:
    """Print tables, write the file, draw the figure."""
    tell = Console(width=WIDTH)
    for table in tables(results).values():
        tell.print(table.rich())
    if "growth" in results:
        picture = options.output.with_name(f"{options.output.stem}_growth.png")
        picture.write_bytes(growth.figure(results["growth"], options.joints, GROWTH_HZ))
        console.print(f"figure drawn in {picture}")
    write_json(options.output, results)


def _measured(name: str, sections: Sections, arms: Arms, plan: Plan, folder: Path) -> dict[str, Any]:
    if name == "kernel":
        return kernel_figures(arms[plan.joints], arms.bag)
    if name == "offline":
        return offline_figures(arms[plan.joints], arms.bag, folder, plan.offline_s)
    return dict(getattr(sections, name)())


def _let_find(*folders: Path) -> None:
    """Have the programs that are started find Python modules in folders."""
    former = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, folders), *([former] if former else [])])


if __name__ == "__main__":
    sys.exit(main())
