# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""calibrate: fit a calibration file from a recorded bag; list the procedures, compare files, check for drift."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.bags.recording import POSE
from posor.calibration.calibration_file import FILE_KIND, load_calibration, parse_calibration
from posor.calibration.save import refuse_existing
from posor.calibration.yaml_document import read_text
from posor.certificates.dcc_document import write_dcc
from posor.certificates.dcc_options import add_dcc_options, read_dcc_options
from posor.errors import OutputError, ParameterError
from posor.output_files import prepared_files
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from posor.reporting.progress import progress_display
from posor.tables.number_text import parse_number
from rich.console import Console

from posor_calibration.calibration_certificate import certificate_of_fit
from posor_calibration.calibration_comparison import compare_calibrations
from posor_calibration.calibration_fit import fit_recording, read_recording, to_track_sigmas
from posor_calibration.drift_check import check_drift
from posor_calibration.option_arguments import add_options, destination, given_options, read_options
from posor_calibration.outcome_report import judge_outcome, outcome_json, render_outcome_page
from posor_calibration.outcome_tables import WIDTH, print_comparison, print_drift_check, print_outcome, print_table
from posor_calibration.procedure import Table
from posor_calibration.procedure_registry import PROCEDURES
from posor_calibration.procedures.bundle import BundleOptions

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.calibration.fit_record import Instrument

    from posor_calibration.calibration_fit import FitResult
    from posor_calibration.outcome_report import ProcedureVerdict

MOST_SCALE, MOST_THERMOMETER_K = 0.01, 10.0  # standard uncertainties of shared terms: share of a length, and [K]
NOT_EXPLAINED = 3
"""Exit code of ``check`` for a calibration that does not explain the bag."""


def make_parser() -> CommandLineParser:
    """Return the parser of the command line."""
    parser = CommandLineParser(prog="posor calibrate", description="Fit a calibration file from recorded bags.")
    actions = parser.add_subparsers(dest="action", required=True, metavar="PROCEDURE|list|diff|check")
    actions.add_parser("list", help="list the procedures")
    diff = actions.add_parser("diff", help="compare two calibration files, in sigmas")
    diff.add_argument("first", type=Path, metavar="A.yaml")
    diff.add_argument("second", type=Path, metavar="B.yaml")
    diff.add_argument("--all", action="store_true", help="print every number that differs")
    check = actions.add_parser("check", help="check whether a calibration file still explains a bag")
    check.add_argument("calibration", type=Path, metavar="FILE.yaml")
    _add_recording_arguments(check)
    add_options(check, BundleOptions, exclude=("loss", "covariance", "seed"))
    for procedure in PROCEDURES.values():
        action = actions.add_parser(procedure.name, help=procedure.summary, description=procedure.summary)
        _add_recording_arguments(action)
        action.add_argument("--calibration", type=Path, required=True, metavar="IN.yaml", help="the present file")
        text = "the file to write, with OUT.html and OUT.json beside it; default: none"
        action.add_argument("--output", type=Path, metavar="OUT.yaml", help=text)
        action.add_argument("--force", action="store_true", help="replace these files; the old OUT.yaml is kept")
        text = "shared term and relative standard uncertainty of the length scale of the references; may be repeated"
        action.add_argument("--length-scale", action="append", default=[], metavar="NAME=S", help=text)
        text = "shared term and standard uncertainty [K] of the thermometer of the plate; may be repeated"
        action.add_argument("--thermometer", action="append", default=[], metavar="NAME=K", help=text)
        add_dcc_options(action)
        add_options(action, procedure.options)
    return parser


def _add_recording_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of a rosbag2 bag, or its .mcap or .db3 file")
    parser.add_argument("--topic", default="", help="of the raw scans (default: the only one)")
    text = "standard uncertainty of a reference topic, SI: one number for all columns or one each; of a pose: m,rad"
    parser.add_argument("--uncertainty", action="append", default=[], metavar="TOPIC=S[,S...]", help=text)
    text = "instrument of a reference topic, for the file; may be repeated"
    parser.add_argument("--instrument", action="append", default=[], metavar="TOPIC=NAME", help=text)
    parser.add_argument("--all", action="store_true", help="print all tables with every line")


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return 0 on success, 3 if a check fails, else the error's exit code."""
    return _run_action(make_parser().parse_args(arguments), Console(width=WIDTH))


def _run_action(options: argparse.Namespace, console: Console) -> int:
    if options.action == "list":
        rows = tuple((procedure.name, procedure.summary) for procedure in PROCEDURES.values())
        title = "Calibration procedures; options: calibrate PROCEDURE --help"
        print_table(Table(title, ("procedure", "purpose"), ("", ""), rows), console)
        return 0
    if options.action == "diff":
        found = compare_calibrations(load_calibration(options.first), load_calibration(options.second))
        print_comparison(found, console, every=options.all)
        return 0
    if options.action == "check":
        settings: Any = read_options(BundleOptions, options)
        calibration = load_calibration(options.calibration)
        with progress_display() as progress:
            report = progress.begin
            recording, _ = _read_recording(
                options, calibration, getattr(options, destination("reference"), None), report
            )
            given = [topic for topic, _ in _split("--uncertainty", options.uncertainty)]
            recording = _with_recorded_uncertainty(recording, calibration, settings.reference, given)
            report("fitting")
            check = check_drift(recording, calibration, settings)
        print_drift_check(check, console, every=options.all)
        return 0 if check.explains else NOT_EXPLAINED
    stated = read_dcc_options(options, "calibrate")
    with progress_display() as progress:
        result = calibrate(options, progress.begin)
    verdict = write_result(result, options, console)
    if stated is not None:
        certificate = certificate_of_fit(result, verdict, options.bag, options.calibration)
        write_dcc(options.dcc, certificate, stated)
        console.print(f"certificate: {options.dcc}", soft_wrap=True, markup=False, highlight=False)
    return 0


def calibrate(options: argparse.Namespace, report: Callable[[str], object]) -> FitResult:
    """Run the procedure of a command line from ``make_parser``; ``report`` receives the current step.

    Raises:
        PosorError: An option, a file or the recording is invalid.

    """
    procedure = PROCEDURES[options.action]
    settings = read_options(procedure.options, options)
    if options.output is not None:
        refuse_existing(options.output, force=options.force)
        if options.output in _report_files(options.output):
            raise OutputError(
                "is the name of a report", where=str(options.output), expected="a name that ends in .yaml"
            )
        for page in _report_files(options.output):
            if page.exists() and not options.force:
                raise OutputError("exists already", where=str(page), expected="another --output, or --force")
    text, source = read_text(options.calibration, FILE_KIND), str(options.calibration)
    calibration = parse_calibration(text, source)
    recording, instruments = _read_recording(options, calibration, getattr(settings, "reference", None), report)
    report(f"{procedure.name}: fitting")
    given = given_options(procedure.options, options)
    terms = [
        {name: _parse_sigma(option, name, sigma, most) for name, sigma in _split(option, entries)}
        for option, entries, most in (
            ("--length-scale", options.length_scale, MOST_SCALE),
            ("--thermometer", options.thermometer, MOST_THERMOMETER_K),
        )
    ]
    return fit_recording(
        *(procedure, calibration, recording, instruments, settings, given),
        text=text,
        source=source,
        scales=terms[0],
        thermometers=terms[1],
    )


def write_result(result: FitResult, options: argparse.Namespace, console: Console) -> ProcedureVerdict:
    """Print and return the verdict; write the new calibration file, and its report, if the command line names one.

    Raises:
        CalibrationError: The file cannot be written.
        OutputError: The report cannot be written.

    """
    outcome, name = result.outcome, result.procedure
    changes = compare_calibrations(result.former, result.calibration) if result.text else None
    verdict = judge_outcome(name, outcome, changes)
    ending = ["No --output: nothing is written."]
    if options.output is not None:
        ending = []
        page, figures = _report_files(options.output)
        replaced = " and ".join(each.name for each in (page, figures) if each.exists())
        text = render_outcome_page(f"{name}, {result.source}", verdict, outcome)
        with prepared_files({page: text, figures: outcome_json(name, verdict, outcome)}):
            if result.text:
                backup = result.save(options.output, force=options.force)
                kept = f"; the old file is now {backup}" if backup else ""
                ending = [f"written to {options.output}{kept}", f"content hash {result.calibration.content_hash}"]
        ending.append(f"all tables: {page} and {figures.name}" + (f"; replaced: {replaced}" if replaced else ""))
    if options.all:
        print_outcome(outcome, console)
    elsewhere = "with --all" if options.output is None else f"in {page.name}"
    for line in verdict.lines(ending, elsewhere):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return verdict


def _report_files(output: Path) -> tuple[Path, Path]:
    """Return the page and the JSON file beside a calibration file."""
    return output.with_suffix(".html"), output.with_suffix(".json")


def _read_recording(
    options: argparse.Namespace, calibration: Calibration, reference: object, report: Callable[[str], object]
) -> tuple[Recording, list[Instrument]]:
    """Read the bag; return it with the given uncertainties, and the instruments of its references."""
    uncertainties = {topic: _parse_sigmas(topic, text) for topic, text in _split("--uncertainty", options.uncertainty)}
    names = dict(_split("--instrument", options.instrument))
    report(f"reading {options.bag}")
    return read_recording(
        options.bag, calibration, uncertainties, names, topic=options.topic, reference=reference, where="option --{}"
    )


def _with_recorded_uncertainty(
    recording: Recording, calibration: Calibration, reference: str, given: Sequence[str]
) -> Recording:
    """Return the recording with an uncertainty of the pose reference, of the calibration's record unless it is given.

    Raises:
        ParameterError: It is not given, and no fit of the calibration records it.

    """
    tracks = dict(recording.tracks)
    for topic, track in recording.tracks.items():
        if track.values.shape[1] != POSE or topic in given or reference not in ("", topic):
            continue
        instruments = [each for fit in calibration.fits for each in fit.instruments if each.topic == topic]
        recorded = [each.sigmas for each in instruments if len(each.sigmas) == POSE - 1 and any(each.sigmas)]
        if not recorded:
            what = f"the uncertainty of {topic} is unknown: no fit of '{calibration.name}' records it"
            raise ParameterError(what, where="calibrate check", expected=f"the option --uncertainty {topic}=M,RAD")
        tracks[topic] = replace(
            track, sigmas=np.array(to_track_sigmas(topic, recorded[-1], POSE, "option --uncertainty"))
        )
    return replace(recording, tracks=tracks)


def _split(option: str, given: Sequence[str]) -> list[tuple[str, str]]:
    """Return topic and value of each TOPIC=VALUE."""
    pairs = []
    for text in given:
        topic, equals, value = text.partition("=")
        if not (topic and equals and value.strip()):
            raise ParameterError(f"'{text}'", where=f"option {option}", expected="TOPIC=..., such as /cmm/pose=...")
        pairs.append((topic, value))
    return pairs


def _parse_sigma(option: str, name: str, text: str, most: float) -> float:
    try:
        sigma = parse_number(text)
    except ValueError:
        sigma = math.nan
    if not 0.0 < sigma <= most:
        expected = f"a standard uncertainty above 0 and up to {most:g}"
        raise ParameterError(f"'{text}'", where=f"option {option} {name}", expected=expected)
    return sigma


def _parse_sigmas(topic: str, text: str) -> list[float]:
    try:
        numbers = [parse_number(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(np.isfinite(numbers)) or min(numbers) < 0.0:
        expected = "standard uncertainties of zero or more, separated by commas"
        raise ParameterError(f"'{topic}={text}'", where="option --uncertainty", expected=expected)
    return numbers
