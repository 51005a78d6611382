# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""calibrate_demo: simulated calibration campaigns from bags to a calibrated POSOR, compared with the truth.

``./run posor_lab calibrate_demo`` draws a POSOR, records every step of its calibration as a rosbag2 bag,
calibrates it by the code of the command line, checks it at validation poses, and checks the stated uncertainties over
further campaigns. Exit code 0 only if everything holds.
"""

from __future__ import annotations

import json
import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from posor.errors import ParameterError
from posor.lazy_program import interrupts_handled
from posor.output_files import write_files
from posor.reporting.report_table import report_console
from posor_bringup.bringup_options import prepare_output_folder

from posor_lab.campaign.campaign_page import campaign_page
from posor_lab.campaign.campaign_report import CampaignReport, all_findings, campaigns_as_json
from posor_lab.campaign.campaign_run import calibrate_from_bags, record_bags
from posor_lab.campaign.campaign_series import coverage_of_series, run_campaigns
from posor_lab.campaign.campaign_steps import campaign_steps
from posor_lab.campaign.ground_truth import POSORS, GroundTruth, PosorName
from posor_lab.reports.console_progress import InterruptedRunError, StageProgress
from posor_lab.reports.findings import COMPARISON_HEADINGS, exit_code_of_findings, print_findings, print_verdict
from posor_lab.reports.trial_program import Option, parse_options

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Iterator, Sequence
    from types import FrameType

    from posor_lab.reports.findings import Findings

SEED = 1985
CAMPAIGNS = 6
MINIMUM_CAMPAIGNS = 4  # fewest campaigns with a meaningful scatter
OUTPUTS = ("report.html", *POSORS)


OPTIONS = (
    Option("--posor", "both", "POSORs to calibrate", choices=(*get_args(PosorName), "both")),
    Option("--campaigns", CAMPAIGNS, "further campaigns of each POSOR, in memory, for the coverage; 0: none"),
    Option("--seed", SEED, "of the POSORs that are drawn", least=0),
    Option("--output", Path("build/calibration"), "folder of report, bags and files; the figures go to FOLDER.json"),
)


def _parse_options(arguments: Sequence[str]) -> Namespace:
    options = parse_options(
        "calibrate_demo", "Simulated calibration campaigns, compared with the truth.", OPTIONS, arguments
    )
    if options.campaigns < 0 or 0 < options.campaigns < MINIMUM_CAMPAIGNS:
        expected = f"0, or at least {MINIMUM_CAMPAIGNS}"
        raise ParameterError(f"--campaigns {options.campaigns}", where="calibrate_demo", expected=expected)
    return options


def _run_posors(options: Namespace, progress: StageProgress) -> list[CampaignReport]:
    """Run the campaigns of the selected POSORs."""
    reports = []
    folder = prepare_output_folder(options.output, OUTPUTS)
    for name in POSORS if options.posor == "both" else (options.posor,):
        count = len(campaign_steps(name))
        truth = GroundTruth.draw(name, options.seed)
        (folder / name).mkdir()
        with progress.stage(f"{name}: recording bags", count) as on_bag:
            bags = record_bags(truth, folder / name / "bags", on_bag)
        with progress.stage(f"{name}: calibrating", count) as on_step:
            steps = calibrate_from_bags(truth, bags, folder / name, on_step)
        coverage = None
        if options.campaigns:
            seeds = range(options.seed + 1, options.seed + 1 + options.campaigns)
            with progress.stage(f"{name}: more campaigns", options.campaigns) as on_done:
                coverage = coverage_of_series(name, run_campaigns(name, seeds, on_done=on_done))
        reports.append(CampaignReport.evaluate(truth, steps, coverage))
    return reports


def _write_report(options: Namespace, reports: Sequence[CampaignReport]) -> None:
    command = f"--posor {options.posor} --campaigns {options.campaigns} --seed {options.seed}"
    provenance = {"command": f"./run posor_lab calibrate_demo {command}"}
    for report in reports:
        result = f"{report.steps[-1].step.name}.yaml, content hash {report.calibration.content_hash}"
        provenance[f"{report.truth.name}, result"] = result
    figures, json_file = campaigns_as_json(reports), options.output.with_name(f"{options.output.name}.json")
    page = campaign_page(reports, provenance)
    write_files({options.output / "report.html": page, json_file: json.dumps(figures, indent=2) + "\n"})


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""

    def program() -> Findings:
        with _note_signals() as check:
            return _run(_parse_options(sys.argv[1:] if arguments is None else arguments), check)

    return exit_code_of_findings(program)


@contextmanager
def _note_signals() -> Iterator[Callable[[], None]]:
    """Note SIGINT and SIGTERM; the yielded function, called after each part of a stage, raises KeyboardInterrupt then.

    An exception raised by the handler itself could be lost in a library, or printed by one. A second signal raises it
    nevertheless: nobody has to wait for a long part. The workers end with the program.

    Raises InterruptedRunError: there was a signal.
    """
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if noted:
            signal.default_int_handler(number, frame)
        noted.append(number)

    def check() -> None:
        if noted:
            raise KeyboardInterrupt

    try:
        with interrupts_handled(note):
            yield check
            check()
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted", where="calibrate_demo") from None


def _run(options: Namespace, check: Callable[[], None]) -> Findings:
    console = report_console(150)
    with StageProgress(console, check) as progress:
        reports = _run_posors(options, progress)
    _write_report(options, reports)
    findings = all_findings(reports)
    print_findings(findings, console, "Findings of the calibration campaigns", COMPARISON_HEADINGS)
    console.print(f"report: {options.output / 'report.html'}", soft_wrap=True, markup=False)
    print_verdict(findings, console)
    return findings
