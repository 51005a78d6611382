"""soak: runs a simulated arm in one process for a long time; the exit code is 0 only if nothing is lost or grows.

The aims are in ``docs/how_to/fuzz_and_soak.md``.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from posor_lab.faults.fault_arm import RATES
from posor_lab.reports.findings import Finding, Findings
from posor_lab.reports.trial_program import Option, TrialProgram
from posor_lab.soak.soak_run import run_soak

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_lab.reports.trial_program import Trial
    from posor_lab.soak.process_sample import ProcessSample
    from posor_lab.soak.soak_run import SoakFigures

LINE_S = 300.0
"""Time between two lines about the process."""
MOST_GROWTH_MB = 1.0
MIN_SECONDS = 5.0
"""The last second of a run is not judged."""
OPTIONS = (
    Option("--arm", "five_axis", "simulated arm", choices=tuple(RATES)),
    Option("--seconds", 3600.0, "duration after the warm-up [s]", least=MIN_SECONDS),
    Option("--warm-up", 300.0, "time from the first poses to the first sample of memory [s]", least=0.0),
)


def run_program(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Run the arm; return the findings and the content of the output file."""
    options, next_line_s = trial.options, 0.0

    def on_sample(sample: ProcessSample) -> None:
        nonlocal next_line_s
        if sample.seconds >= next_line_s:
            next_line_s += LINE_S
            text = f"{sample.descriptors} descriptors, {sample.threads} threads"
            trial.progress.line(f"{sample.seconds:.0f} s: {sample.memory_mb:.2f} MB, {text}")

    figures = run_soak(options.arm, options.seconds, options.warm_up, trial.folder, on_sample, trial.interrupted)
    findings = soak_findings(figures)
    summary = {"arm": options.arm, "holds": findings.holds, "lost": figures.lost, "growth_mb": figures.growth_mb}
    return findings, {**summary, **asdict(figures)}


def soak_findings(figures: SoakFigures) -> Findings:
    """Return the verdicts on the figures."""
    first, last = figures.samples[0], figures.samples[-1]
    found = [
        Finding("duration, simulated", f"{figures.seconds:.0f} s"),
        Finding("ticks", f"{figures.ticks}", remark=f"{figures.ticks_missed} missed by the driver that missed most"),
        Finding("raw scans sent, all joints", f"{figures.sent}", remark="in the whole run"),
        Finding("transforms, all joints", f"{figures.transforms}", remark="in the whole run"),
        Finding("endpoint states", f"{figures.states}"),
        Finding("endpoint poses", f"{figures.poses}"),
        *(Finding(f"no pose, {reason}", f"{count}") for reason, count in figures.without_pose.items()),
        Finding.none_of("raw scans without a transform", figures.lost_scans),
        Finding.none_of("ticks without a state that no driver missed", figures.lost_states),
        Finding.none_of("transforms missing whose scan was sent", figures.lost_transforms),
        Finding.none_of("states without their pose, poses without their state", figures.lost_poses),
        Finding.judged(
            "growth of the memory",
            f"{figures.growth_mb:.3f} MB",
            f"below {MOST_GROWTH_MB:g} MB",
            holds=figures.growth_mb < MOST_GROWTH_MB,
            remark=f"{first.memory_mb:.2f} MB at the begin, {last.memory_mb:.2f} MB at the end",
        ),
    ]
    for name in ("descriptors", "threads"):
        begin, end = getattr(first, name), getattr(last, name)
        found.append(Finding.judged(f"{name} at the end", f"{end}", f"{begin} at the begin", holds=begin == end))
    return Findings(tuple(found))


DESCRIPTION = "Run a simulated arm in one process for a long time."
PROGRAM = TrialProgram("soak", DESCRIPTION, OPTIONS, run_program, "arm in one process", "build/soak.json")
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
