"""faults: injects every fault of the fault table into nodes and estimator, and a storm of all of them.

Prints fault, expected and seen behaviour, time to naming, and wrong poses published as valid; writes ``faults.json``.
The exit code is 0 only if every aim is reached; the aims are in ``docs/how_to/faults.md``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.ros_names import RAW_TOPIC, TRANSFORM_TOPIC
from posor_ros.node_program import non_ros_arguments, ros_context
from posor_ros.ros_domain import isolated_network
from rich.console import Console
from rich.table import Table

from posor_lab.faults.device_faults import DEVICE_FAULTS, DeviceRun
from posor_lab.faults.fault_table import ARMS
from posor_lab.faults.hidden_faults import CASES, HIDDEN_FAULTS, run_hidden
from posor_lab.faults.input_faults import MESSAGE_FAULTS, InputRun
from posor_lab.faults.node_storm import run_node_storm
from posor_lab.faults.process_faults import PROCESS_FAULTS, ProcessRun
from posor_lab.faults.reading_faults import SCENARIO_FAULTS, ReadingRun
from posor_lab.faults.soak import run_soak
from posor_lab.faults.source_slip import SLIP_ROW, run_slips
from posor_lab.faults.storm import run_storm, storm_calibrations
from posor_lab.output_files import check_writable, write_json
from posor_lab.reports.console_progress import InterruptedRunError, StageProgress
from posor_lab.reports.findings import FIGURE_HEADINGS, Finding, Findings, Verdict, print_findings, print_verdict
from posor_lab.reports.findings_program import exit_code_of_findings

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Mapping, Sequence

    from posor_lab.faults.fault_table import Arm, FaultRow, RowResult
    from posor_lab.faults.soak import Soak
    from posor_lab.faults.storm import StormCount

SEED = 1985
INJECTED = 1_000_000
"""Faulty scans of the storm through the estimator, of all stacks together."""
INJECTED_INTO_NODES = 100_000
"""The same of the storm through posor_nodes."""
SOUND_SHARE = 0.998
"""Least share of sound scans outside of a latched period that are OK."""
SOAK_S = 30.0
"""Duration of each run without faults; 600 s are the full test."""
QUICK_INJECTED = 15_000
QUICK_CASES = 50
QUICK_ROWS = (
    "test_rig: all readings frozen",
    "test_rig: supply 16 V",
    "test_rig: gap probe +1 V",
    "test_rig: no scans",
    "test_rig: x = 1e+300 m (transform)",
    "test_rig: stamps 1 h old (transform)",
    "test_rig: second publisher, 10 mm off (transform)",
    "six_axis: gap probe off by less than is detectable",
)
"""Rows of ``--quick``, by arm and name."""


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value is invalid.

    """
    parser = CommandLineParser(prog="faults", description="Inject faults and count wrong poses published as valid.")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of motion, noise and faults (default: {SEED})")
    parser.add_argument("--rows", default="", metavar="TEXT", help="only rows whose name contains TEXT; no storm")
    parser.add_argument("--quick", action="store_true", help="a few rows and a short storm, for less than 40 s")
    parser.add_argument(
        "--storm", type=int, default=INJECTED, metavar="N", help=f"faulty scans of the storm (default: {INJECTED})"
    )
    parser.add_argument(
        "--node-storm",
        type=int,
        default=INJECTED_INTO_NODES,
        metavar="N",
        help=f"faulty scans of the storm through nodes (default: {INJECTED_INTO_NODES})",
    )
    parser.add_argument(
        "--soak",
        type=float,
        default=SOAK_S,
        metavar="S",
        help=f"duration of each run without faults (default: {SOAK_S:g} s)",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("build/faults.json"), metavar="FILE", help="default: build/faults.json"
    )
    options = parser.parse_args(list(arguments))
    for name in ("seed", "storm", "node_storm", "soak"):
        if not getattr(options, name) >= 0:
            raise ParameterError(f"{name} {getattr(options, name)}", where="faults", expected="0 or more")
    if options.quick or options.rows:
        options.soak = 0.0
    if options.quick:
        options.storm, options.node_storm = min(options.storm, QUICK_INJECTED), 0
    if options.rows:
        options.storm = options.node_storm = 0
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if every aim is reached."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of_findings(lambda: _run(parse_options(non_ros_arguments(argv)), argv))


def _run(options: Namespace, argv: Sequence[str]) -> Findings:
    console = Console(highlight=False)
    check_writable(options.output)
    with (
        tempfile.TemporaryDirectory(prefix="faults-") as folder,
        isolated_network(),
        ros_context(argv) as stop,
    ):

        def check() -> None:
            if stop.requested:
                raise InterruptedRunError("interrupted", where="faults")

        with StageProgress(console, check) as progress:
            results = run_rows(options, Path(folder), progress, lambda: stop.requested)
            soaks = run_soaks(options, Path(folder), progress, lambda: stop.requested)
            storms = run_storms(options, Path(folder), progress)
    findings = fault_findings(results, soaks, storms)
    if console.is_terminal:
        print_rows(results, console)
    print_findings(findings, console, "fault table", FIGURE_HEADINGS)
    write_json(
        options.output,
        {
            "faults": [each.as_json() for each in results],
            "without_faults": [{**asdict(each), "holds": each.holds} for each in soaks],
            "storm": storm_json(storms),
        },
    )
    print_verdict(findings, console)
    return findings


def run_rows(
    options: Namespace, folder: Path, progress: StageProgress, interrupted: Callable[[], bool]
) -> list[RowResult]:
    """Run the selected rows and return their results.

    Raises:
        ParameterError: No row is selected.
        ProcessError: A node failed.
        InterruptedRunError: The user interrupted the run.

    """

    def is_selected(row: FaultRow) -> bool:
        name = f"{row.arm}: {row.name}"
        return options.rows in name and (not options.quick or name in QUICK_ROWS)

    seed = options.seed

    def live(run_class: Any, *arguments: Any) -> Callable[[Path], list[RowResult]]:
        return lambda part: run_class(*arguments, part, seed, interrupted).run()

    runs: list[tuple[str, int, Callable[[Path], list[RowResult]]]] = []
    for arm in ARMS:
        readings = [each for each in SCENARIO_FAULTS if each.row.arm == arm and is_selected(each.row)]
        runs.append((f"readings of {arm}", len(readings), live(ReadingRun, arm, readings)))
    for topic in (RAW_TOPIC, TRANSFORM_TOPIC):
        messages = [each for each in MESSAGE_FAULTS if each.topic == topic and is_selected(each.row)]
        runs.append((f"messages on {topic}", len(messages), live(InputRun, topic, messages)))
    for layout in ("separate", "composed"):
        processes = [each for each in PROCESS_FAULTS if each.layout == layout and is_selected(each.row)]
        runs.append((f"processes, layout {layout}", len(processes), live(ProcessRun, processes)))
    devices = [each for each in DEVICE_FAULTS if is_selected(each.row)]
    runs.append(("devices", len(devices), live(DeviceRun, devices)))
    cases = QUICK_CASES if options.quick else CASES
    hidden = [each for each in HIDDEN_FAULTS if is_selected(each.row)]
    runs.append(("hidden faults", len(hidden), lambda _: [run_hidden(each, seed, cases) for each in hidden]))
    runs.append(("slips of light sources", int(is_selected(SLIP_ROW)), lambda _: [run_slips(seed)]))
    if not any(count for _, count, _ in runs):
        raise ParameterError(f"--rows '{options.rows}'", where="faults", expected="part of the name of a row")
    results = []
    for title, count, run in runs:
        if count:
            part = folder / title.replace(", ", "_").replace(" ", "_")
            part.mkdir()
            with progress.stage(title, count) as on_done:
                found = run(part)
                on_done(count)
            for each in found:
                progress.line(describe_row(each))
            results += found
    return results


def run_soaks(options: Namespace, folder: Path, progress: StageProgress, interrupted: Callable[[], bool]) -> list[Soak]:
    """Return the figures of the runs without faults.

    Raises:
        ProcessError: A node failed.
        InterruptedRunError: The user interrupted the run.

    """
    soaks = []
    arms: tuple[Arm, ...] = ("five_axis", "six_axis") if options.soak else ()
    for arm in arms:
        part = folder / f"soak_{arm}"
        part.mkdir()
        with progress.stage(f"{arm} without faults", 1) as on_done:
            soaks.append(run_soak(arm, options.soak, part, options.seed, interrupted))
            on_done()
    return soaks


def run_storms(options: Namespace, folder: Path, progress: StageProgress) -> dict[str, StormCount]:
    """Return the figures of the storm of each stack, through the estimator and through nodes.

    Raises:
        ProcessError: A node failed.
        InterruptedRunError: The user interrupted the run.

    """
    calibrations, storms = storm_calibrations(), {}
    for name, calibration in calibrations.items():
        if injected := options.storm // len(calibrations):
            with progress.stage(f"storm of {name}", injected) as on_done:
                storms[name] = run_storm(calibration, injected, options.seed, on_done)
        if injected := options.node_storm // len(calibrations):
            with progress.stage(f"storm of {name} through nodes", injected) as on_done:
                storms[f"{name} through nodes"] = run_node_storm(calibration, injected, options.seed, folder, on_done)
    return storms


def fault_findings(results: Sequence[RowResult], soaks: Sequence[Soak], storms: Mapping[str, StormCount]) -> Findings:
    """Return the verdicts on rows, runs without faults, and storms."""
    found = []
    for each in results:
        if each.failures:
            name = f"{each.row.arm}: {each.row.name}"
            found.append(Finding(name, "; ".join(each.failures), verdict=Verdict.FAILS))
    held = sum(not each.failures for each in results)
    verdict = Verdict.of(holds=held == len(results))
    found.append(Finding("rows that hold", f"{held}", limit=f"{len(results)}", verdict=verdict))
    for soak in soaks:
        title = f"{soak.arm} without faults"
        remark = "; ".join(soak.errors)
        verdict = Verdict.of(holds=not soak.errors)
        found.append(
            Finding(f"{title}: errors in the diagnostics", f"{len(soak.errors)}", "", "0", "", verdict, remark)
        )
        band, verdict = f"{soak.band[0]} to {soak.band[1]}", Verdict.of(holds=soak.is_in_band)
        remark = f"of {soak.scans} scans; 95 % band of the expected rate"
        found.append(Finding(f"{title}: false alarms", f"{soak.alarms}", "", band, "", verdict, remark))
    for name, storm in storms.items():
        worst = ", ".join(f"{fault} {count}" for fault, count in storm.wrong_by_fault.items())
        wrong = f"storm of {name}: wrong poses published as valid"
        remark = f"{storm.injected} faulty of {storm.scans} scans; {worst or 'none wrong'}"
        found.append(Finding(wrong, f"{storm.wrong_ok}", remark=remark))
        verdict = Verdict.of(holds=storm.uncovered == 0)
        beyond = f"{wrong}, not covered by the protection level"
        found.append(Finding(beyond, f"{storm.uncovered}", limit="0", verdict=verdict))
        if "nodes" in name:
            equal = f"storm of {name}: transforms unlike the estimator's"
            holds = storm.different == 0
            found.append(Finding(equal, f"{storm.different}", limit="0", verdict=Verdict.of(holds=holds)))
        found.append(
            Finding(
                f"storm of {name}: sound scans that are OK",
                f"{100.0 * storm.sound_ok_share:.3f} %",
                limit=f"at least {100.0 * SOUND_SHARE:g} %",
                verdict=Verdict.of(holds=storm.sound_ok_share >= SOUND_SHARE),
                remark=f"of {storm.sound}; {storm.latched} more in latched periods",
            )
        )
    return Findings(tuple(found))


def storm_json(storms: Mapping[str, StormCount]) -> dict[str, Any]:
    """Return the storms as in ``faults.json``: the sums, and the figures of each stack."""
    stacks = {name: {**asdict(storm), "sound_ok_share": storm.sound_ok_share} for name, storm in storms.items()}
    sums = {
        name: sum(getattr(storm, name) for storm in storms.values())
        for name in ("scans", "injected", "wrong_ok", "uncovered", "sound", "sound_ok")
    }
    return {**sums, "stacks": stacks}


def describe_row(result: RowResult) -> str:
    """Return a row as one line."""
    verdict = Verdict.of(holds=not result.failures).value
    naming = "" if result.naming_s is None else f"; named after {result.naming_s:.3f} s"
    name = f"{result.row.arm}: {result.row.name}"
    return f"{verdict:<6} {name}: {result.seen}{naming}; {result.wrong_ok} wrong and OK"


def print_rows(results: Sequence[RowResult], console: Console) -> None:
    """Print the fault table."""
    table = Table(title="fault table", header_style="bold")
    for heading in ("fault", "expected", "seen", "naming [s]", "wrong and OK"):
        table.add_column(heading, overflow="fold")
    for each in results:
        naming = "" if each.naming_s is None else f"{each.naming_s:.3f}"
        style = "red" if each.failures else ""
        cells = (f"{each.row.arm}: {each.row.name}", each.row.expected, each.seen, naming, f"{each.wrong_ok}")
        table.add_row(*cells, style=style)
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
