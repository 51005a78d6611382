# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""instruments_trials: tries every kind of device against a server over real sockets; exit code 0 if all aims hold.

The aims are in ``docs/reference/instruments.md``.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError

from posor_lab.accuracy.consistency import REGION
from posor_lab.instruments.device_trials import TRIALS
from posor_lab.instruments.trial_run import run_trial
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.reports.trial_program import Option, TrialProgram

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping

    from posor_lab.instruments.trial_run import TrialFigures
    from posor_lab.reports.trial_program import Trial

REGION_TOLERANCE, LEAST_RATE, NAMED_WITHIN_S, BACK_WITHIN_S = 0.02, 0.95, 0.5, 2.0


def choose_trials(options: Namespace) -> None:
    """Set ``options.selected``. Raises ParameterError: no trial is selected."""
    options.selected = [trial for trial in TRIALS if options.trials in trial.name]
    if not options.selected:
        expected = f"part of one of {'; '.join(trial.name for trial in TRIALS)}"
        raise ParameterError(f"--trials {options.trials}", where="instruments_trials", expected=expected)


def run_trials(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Run the selected trials; return the findings and the content of the output file."""
    figures = []
    for each in trial.options.selected:
        trial.progress.line(f"{each.name}: about {each.seconds + 20:.0f} s")
        figures.append(run_trial(each, trial.subfolder(each.name), trial.interrupted))
    findings = Findings(tuple(finding for each in figures for finding in trial_findings(each)))
    return findings, {"holds": findings.holds, "trials": [asdict(each) for each in figures]}


def trial_findings(figures: TrialFigures) -> list[Finding]:
    """Return the verdicts on the figures of a trial."""
    name, matter, back_s = figures.name, figures.stamps_matter, figures.back_after_s
    inside = 100.0 * figures.inside_region
    low, high = 100.0 * (REGION - REGION_TOLERANCE), 100.0 * (REGION + REGION_TOLERANCE)
    least = LEAST_RATE * figures.rate
    judged = Finding.judged
    found = [
        judged(
            f"{name}: poses inside their 95 % region",
            f"{inside:.1f} %",
            f"{low:g} % or more" if matter else f"{low:g} to {high:g} %",
            holds=low <= inside and (matter or inside <= high),
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
        judged(
            f"{name}: stalled device named after",
            f"{figures.named_after_s:.2f} s",
            f"{NAMED_WITHIN_S:g} s",
            holds=figures.named_after_s <= NAMED_WITHIN_S,
        ),
        Finding.none_of(f"{name}: poses while it was stalled", figures.poses_in_stall),
    ]
    again, limit = f"{name}: poses again after", f"{BACK_WITHIN_S:g} s"
    if back_s is None:
        return [*found, Finding(again, "not waited for", limit=limit)]
    return [*found, judged(again, f"{back_s:.2f} s", limit, holds=back_s <= BACK_WITHIN_S)]


PROGRAM = TrialProgram(
    "instruments_trials",
    "Try every kind of device against a server.",
    (Option("--trials", "", "only trials whose name contains TEXT"),),
    run_trials,
    "instruments, simulated devices behind real sockets",
    "build/instruments.json",
    choose_trials,
)
main = PROGRAM.main
