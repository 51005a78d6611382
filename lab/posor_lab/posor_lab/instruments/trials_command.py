"""instruments_trials: tries every kind of device against a server over real sockets; exit code 0 if all aims hold.

The aims are in ``docs/reference/instruments.md``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor_ros.node_program import non_ros_arguments, ros_context
from posor_ros.ros_domain import isolated_network
from rich.console import Console

from posor_lab.accuracy.consistency import REGION
from posor_lab.instruments.device_trials import TRIALS
from posor_lab.instruments.trial_run import run_trial
from posor_lab.output_files import check_writable, write_json
from posor_lab.reports.findings import FIGURE_HEADINGS, Finding, Findings, Verdict, print_findings, print_verdict
from posor_lab.reports.findings_program import exit_code_of_findings

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from posor_lab.instruments.trial_run import TrialFigures

REGION_TOLERANCE, LEAST_RATE, NAMED_WITHIN_S, BACK_WITHIN_S = 0.02, 0.95, 0.5, 2.0


def parse_options(arguments: Sequence[str]) -> Namespace:
    """Return the options.

    Raises:
        ParameterError: An option is unknown or its value is invalid.

    """
    parser = CommandLineParser(prog="instruments_trials", description="Try every kind of device against a server.")
    parser.add_argument("--trials", default="", metavar="TEXT", help="only trials whose name contains TEXT")
    parser.add_argument(
        "--output", type=Path, default=Path("build/instruments.json"), metavar="FILE", help="default: %(default)s"
    )
    options = parser.parse_args(list(arguments))
    options.chosen = [trial for trial in TRIALS if options.trials in trial.name]
    if not options.chosen:
        expected = f"part of one of {'; '.join(trial.name for trial in TRIALS)}"
        raise ParameterError(f"--trials {options.trials}", where="instruments_trials", expected=expected)
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 if every aim is reached."""
    argv = sys.argv if arguments is None else arguments
    return exit_code_of_findings(lambda: _run(parse_options(non_ros_arguments(argv)), argv))


def _run(options: Namespace, argv: Sequence[str]) -> Findings:
    console = Console(highlight=False, soft_wrap=True)
    check_writable(options.output)
    figures = []
    for trial in options.chosen:
        console.print(f"{trial.name}: about {trial.seconds + 20:.0f} s")
        with tempfile.TemporaryDirectory(prefix="trial-") as folder, isolated_network(), ros_context(argv) as stop:
            figures.append(run_trial(trial, Path(folder), interrupted=lambda: stop.requested))
    findings = Findings(tuple(finding for each in figures for finding in trial_findings(each)))
    print_findings(findings, console, "instruments, simulated devices behind real sockets", FIGURE_HEADINGS)
    write_json(options.output, {"holds": findings.holds, "trials": [asdict(each) for each in figures]})
    print_verdict(findings, console)
    return findings


def trial_findings(figures: TrialFigures) -> list[Finding]:
    """Return the verdicts on the figures of a trial."""
    name, inside = figures.name, figures.inside_with_stamps if figures.stamps_matter else figures.inside_region
    least_inside = 100.0 * (REGION - REGION_TOLERANCE)
    most_inside = 100.0 if figures.stamps_matter else 100.0 * (REGION + REGION_TOLERANCE)
    least, back_s = LEAST_RATE * figures.rate, figures.back_after_s
    return [
        Finding(
            f"{name}: poses inside their 95 % region" + (", with the stamps" if figures.stamps_matter else ""),
            f"{100.0 * inside:.1f} %",
            limit=f"{least_inside:g} % or more" if figures.stamps_matter else f"{least_inside:g} to {most_inside:g} %",
            verdict=Verdict.of(holds=least_inside <= 100.0 * inside <= most_inside),
            remark=f"{figures.poses} poses; error {figures.rms_um:.2f} um rms, stated {figures.stated_um:.2f} um; "
            f"stamps {figures.stamps_late_us:.0f} us late, {figures.clock_us:.0f} us uncertain",
        ),
        Finding(
            f"{name}: poses per second",
            f"{figures.pose_rate:.1f}",
            limit=f"{least:g} or more",
            verdict=Verdict.of(holds=figures.pose_rate >= least) if figures.keeps_pace else Verdict.NOT_JUDGED,
            remark=f"{figures.latency_ms:.1f} ms from stamp to reception",
        ),
        Finding(
            f"{name}: stalled device named after",
            f"{figures.named_after_s:.2f} s",
            limit=f"{NAMED_WITHIN_S:g} s",
            verdict=Verdict.of(holds=figures.named_after_s <= NAMED_WITHIN_S),
        ),
        Finding(
            f"{name}: poses while it was stalled",
            f"{figures.poses_in_stall}",
            limit="0",
            verdict=Verdict.of(holds=figures.poses_in_stall == 0),
        ),
        Finding(
            f"{name}: poses again after",
            "not waited for" if back_s is None else f"{back_s:.2f} s",
            limit=f"{BACK_WITHIN_S:g} s",
            verdict=Verdict.NOT_JUDGED if back_s is None else Verdict.of(holds=back_s <= BACK_WITHIN_S),
        ),
    ]


if __name__ == "__main__":
    sys.exit(main())
