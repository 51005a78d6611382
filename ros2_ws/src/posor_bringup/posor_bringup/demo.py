"""demo: replays a motion test of 1985 through the nodes, shows it live, compares it with the thesis, writes a report.

Exit code 0 only if the comparison holds.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.errors import PosorError
from posor_estimator.ros.domain import own_network
from posor_estimator.ros.main import exit_code_of, own_arguments, ros
from rich.console import Console

from posor_bringup.collector import Collector
from posor_bringup.command_line import LOGS, Parser, prepare
from posor_bringup.comparison import compare
from posor_bringup.expectations import BAGS, CALIBRATIONS
from posor_bringup.figures import draw
from posor_bringup.findings_table import print_findings
from posor_bringup.installed import JOINT, bag_path, calibration_path, data_path, urdf_path
from posor_bringup.live_table import LiveTable
from posor_bringup.motion import MotionTest
from posor_bringup.page import HEADINGS, Report, page
from posor_bringup.provenance import MOTIONS, STATES, notes, provenance
from posor_bringup.replay import Replay, ReplayPlan
from posor_bringup.steps_file import write_steps
from posor_bringup.supervisor import Supervisor
from posor_bringup.thesis import EXPECTED_ERRORS_FILE, PRINTED_FILES, read_bands, read_printed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_bringup.findings import Findings

MADE_HERE = ("report.html", "report.png", "steps.csv", "bag")
"""What a report's folder holds beside the logs."""


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not (math.isfinite(rate) and rate >= 0.0):
        raise argparse.ArgumentTypeError(f"'{text}' is no speed, a number of at least 0")
    return rate


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value wrong.

    """
    parser = Parser(prog="demo", description="Replay a motion test of 1985 and compare it with the thesis.")
    parser.add_argument("--bag", choices=BAGS, default="ymo", help="motion test (default: ymo)")
    parser.add_argument(
        "--calibration", choices=CALIBRATIONS, default="printed", help="state to reproduce (default: printed)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("build/report"), metavar="FOLDER", help="default: build/report"
    )
    parser.add_argument(
        "--rate", type=_rate, default=1.0, metavar="FACTOR", help="speed, 1 is real time, 0 as fast as possible"
    )
    parser.add_argument("--no-live", action="store_true", help="plain lines instead of a live table")
    return parser.parse_args(list(arguments))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo as a program."""
    argv = sys.argv if arguments is None else arguments
    verdicts: list[Findings] = []
    code = exit_code_of(lambda: verdicts.append(_demo(argv)))
    return code or int(not verdicts[0].holds)


def _demo(argv: Sequence[str]) -> Findings:
    options = parse(own_arguments(argv))
    console = Console(highlight=False)
    folder = prepare(options.output / f"{options.bag}_{options.calibration}", MADE_HERE, "demo")
    plan = ReplayPlan(
        bag=bag_path(options.bag),
        calibration=calibration_path(options.calibration),
        session=options.bag,
        urdf=urdf_path(),
        output=folder,
        rate=options.rate,
    )
    title = (
        f"POSOR, test {options.bag.upper()} of 1985: {MOTIONS[options.bag]}\n"
        f"calibration '{options.calibration}': {STATES[options.calibration]}"
    )
    test, identity = _replay(plan, argv, LiveTable(title, console, live=not options.no_live))
    comparison = _report(options, title, plan, test, identity)
    print_findings(comparison, console, "comparison with the thesis", HEADINGS)
    console.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)
    if comparison.holds:
        console.print("The comparison holds.", style="green")
    else:
        console.print("The comparison does not hold.", style="bold red")
    return comparison


def _replay(plan: ReplayPlan, argv: Sequence[str], table: LiveTable) -> tuple[MotionTest, Mapping[str, str]]:
    """Run the graph; return the steps and what the POSOR node says of its calibration."""
    with own_network(), ros(argv) as stop, Supervisor(plan.output / LOGS) as supervisor:
        collector = Collector(JOINT)
        try:
            with table:
                replay = Replay(plan, supervisor, collector, on_steps=table.show, interrupted=lambda: stop.requested)
                replay.listen()
                replay.begin()
                replay.complete()
            replay.finish()
            return MotionTest(tuple(collector.steps())), replay.identity()
        finally:
            collector.close()


def _report(
    options: argparse.Namespace, title: str, plan: ReplayPlan, test: MotionTest, identity: Mapping[str, str]
) -> Findings:
    """Compare and write all files of the report."""
    name = PRINTED_FILES.get(options.bag)
    printed = read_printed(data_path(name)) if name else None
    comparison = compare(test, options.bag, options.calibration, printed)
    calibration = load_calibration(plan.calibration)
    picture = draw(
        test,
        title,
        printed if options.calibration == "printed" else None,
        read_bands(data_path(EXPECTED_ERRORS_FILE), options.bag),
    )
    report = Report(
        title=title,
        test=test,
        comparison=comparison,
        picture=picture,
        provenance=provenance(plan.bag, calibration, plan.calibration, identity),
        notes=notes(options.bag, test, calibration),
    )
    try:
        (plan.output / "report.png").write_bytes(picture)
        (plan.output / "report.html").write_text(page(report), encoding="utf-8")
        write_steps(plan.output / "steps.csv", test)
    except OSError as error:
        raise PosorError(f"cannot be written: {error.strerror}", where=str(plan.output)) from error
    return comparison


if __name__ == "__main__":
    sys.exit(main())
