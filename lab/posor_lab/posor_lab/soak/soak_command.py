"""soak: runs a simulated arm in one process for a long time; the exit code is 0 only if nothing is lost or grows.

The aims are in ``docs/how_to/fuzz_and_soak.md``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor_ros.node_program import non_ros_arguments, ros_context
from posor_ros.ros_domain import isolated_network
from rich.console import Console

from posor_lab.faults.fault_arm import RATES
from posor_lab.output_files import check_writable, write_json
from posor_lab.reports.findings import FIGURE_HEADINGS, Finding, Findings, Verdict, print_findings, print_verdict
from posor_lab.reports.findings_program import exit_code_of_findings
from posor_lab.soak.soak_run import run_soak

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor_lab.soak.process_sample import ProcessSample
    from posor_lab.soak.soak_run import SoakFigures

SECONDS, WARM_UP_S = 3600.0, 300.0
LINE_S = 300.0
"""Time between two lines about the process."""
MOST_GROWTH_MB = 1.0
MIN_SECONDS = 5.0
"""Of which the last one is not judged."""


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value is invalid.

    """
    parser = CommandLineParser(prog="soak", description="Run a simulated arm in one process for a long time.")
    parser.add_argument("--arm", choices=RATES, default="five_axis", help="default: five_axis")
    for name, default, text in (
        ("--seconds", SECONDS, "duration after the warm-up"),
        ("--warm-up", WARM_UP_S, "time from the first poses to the first sample of memory"),
    ):
        parser.add_argument(name, type=float, default=default, metavar="S", help=f"{text} (default: {default:g} s)")
    parser.add_argument(
        "--output", type=Path, default=Path("build/soak.json"), metavar="FILE", help="default: build/soak.json"
    )
    options = parser.parse_args(list(arguments))
    if not options.seconds >= MIN_SECONDS:
        raise ParameterError(f"--seconds {options.seconds:g}", where="soak", expected=f"{MIN_SECONDS:g} or more")
    if not options.warm_up >= 0.0:
        raise ParameterError(f"--warm-up {options.warm_up:g}", where="soak", expected="0 or more")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if every aim is reached."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of_findings(lambda: _run(parse_options(non_ros_arguments(argv)), argv))


def _run(options: Namespace, argv: Sequence[str]) -> Findings:
    console = Console(highlight=False, soft_wrap=True)
    check_writable(options.output)
    next_line_s = 0.0

    def on_sample(sample: ProcessSample) -> None:
        nonlocal next_line_s
        if sample.seconds >= next_line_s:
            next_line_s += LINE_S
            text = f"{sample.descriptors} descriptors, {sample.threads} threads"
            console.print(f"{sample.seconds:.0f} s: {sample.memory_mb:.2f} MB, {text}")

    with tempfile.TemporaryDirectory(prefix="soak-") as folder, isolated_network(), ros_context(argv) as stop:
        figures = run_soak(
            options.arm, options.seconds, options.warm_up, Path(folder), on_sample, interrupted=lambda: stop.requested
        )
    findings = soak_findings(figures)
    print_findings(findings, console, f"{options.arm} in one process", FIGURE_HEADINGS)
    write_json(options.output, soak_json(options.arm, figures, findings))
    print_verdict(findings, console)
    return findings


def soak_findings(figures: SoakFigures) -> Findings:
    """Return the verdicts on the figures."""
    found = [
        Finding("duration, simulated", f"{figures.seconds:.0f} s"),
        Finding("ticks", f"{figures.ticks}", remark=f"{figures.ticks_missed} missed by the driver that missed most"),
        Finding("raw scans sent, all joints", f"{figures.sent}", remark="in the whole run"),
        Finding("transforms, all joints", f"{figures.transforms}", remark="in the whole run"),
        Finding("endpoint states", f"{figures.states}"),
        Finding("endpoint poses", f"{figures.poses}"),
    ]
    found += [Finding(f"no pose, {reason}", f"{count}") for reason, count in figures.without_pose.items()]
    for quantity, lost in (
        ("raw scans without a transform", figures.lost_scans),
        ("ticks without a state that no driver missed", figures.lost_states),
        ("transforms missing whose scan was sent", figures.lost_transforms),
        ("states without their pose, poses without their state", figures.lost_poses),
    ):
        found.append(Finding(quantity, f"{lost}", limit="0", verdict=Verdict.of(holds=lost == 0)))
    first, last = figures.first, figures.last
    found.append(
        Finding(
            "growth of the memory",
            f"{figures.growth_mb:.3f} MB",
            limit=f"below {MOST_GROWTH_MB:g} MB",
            verdict=Verdict.of(holds=figures.growth_mb < MOST_GROWTH_MB),
            remark=f"{first.memory_mb:.2f} MB at the begin, {last.memory_mb:.2f} MB at the end",
        )
    )
    for quantity, begin, end in (
        ("descriptors", first.descriptors, last.descriptors),
        ("threads", first.threads, last.threads),
    ):
        verdict = Verdict.of(holds=begin == end)
        found.append(Finding(f"{quantity} at the end", f"{end}", limit=f"{begin} at the begin", verdict=verdict))
    return Findings(tuple(found))


def soak_json(arm: str, figures: SoakFigures, findings: Findings) -> dict[str, Any]:
    """Return the content of the output file."""
    return {
        "arm": arm,
        "holds": findings.holds,
        "lost": figures.lost,
        "growth_mb": figures.growth_mb,
        **asdict(figures),
    }


if __name__ == "__main__":
    sys.exit(main())
