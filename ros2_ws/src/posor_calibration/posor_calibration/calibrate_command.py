"""calibrate: fit a calibration file from a recorded bag; list the procedures, compare files, check for drift."""

from __future__ import annotations

import datetime as dt
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.bags.calibration_recording import Reference, load_recording
from posor.bags.recording import POSE
from posor.bags.result_folder import writing
from posor.calibration.calibration_file import FILE_KIND, load_calibration, parse_calibration
from posor.calibration.fit_record import Instrument
from posor.calibration.save import refuse_existing, save_calibration
from posor.calibration.yaml_document import read_text
from posor.errors import BagError, OutputError, ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from posor_calibration.calibration_comparison import compare_calibrations
from posor_calibration.calibration_update import FitContext, update_text
from posor_calibration.drift_check import check_drift
from posor_calibration.option_arguments import add_options, destination, given_options, read_options
from posor_calibration.outcome_report import judge_outcome, outcome_json, render_outcome_page
from posor_calibration.outcome_tables import (
    WIDTH,
    print_comparison,
    print_drift_check,
    print_outcome,
    print_table,
)
from posor_calibration.procedure import Table
from posor_calibration.procedure_registry import PROCEDURES
from posor_calibration.procedures.bundle import BundleOptions

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration

    from posor_calibration.procedure import Outcome, Procedure

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
        with _progress() as report:
            recording, _ = _read_recording(options, calibration, report)
            given = [topic for topic, _ in _split("--uncertainty", options.uncertainty)]
            recording = _with_recorded_uncertainty(recording, calibration, settings.reference, given)
            report("fitting")
            check = check_drift(recording, calibration, settings)
        print_drift_check(check, console, every=options.all)
        return 0 if check.explains else NOT_EXPLAINED
    with _progress() as report:
        result = calibrate(options, report)
    write_result(result, options, console)
    return 0


@dataclass(frozen=True)
class CalibrationResult:
    """Outcome of a procedure with its inputs."""

    procedure: Procedure[Any]
    options: Mapping[str, str]  # as given on the command line
    outcome: Outcome
    recording: Recording
    instruments: Sequence[Instrument]
    text: str  # the calibration file before


def calibrate(options: argparse.Namespace, report: Callable[[str], object]) -> CalibrationResult:
    """Run the procedure of a command line from ``make_parser``; ``report`` receives the current step.

    Raises:
        PosorError: An option, a file or the recording is invalid.

    """
    procedure = PROCEDURES[options.action]
    settings = read_options(procedure.options, options)
    if options.output is not None:
        refuse_existing(options.output, force=options.force)
        for page in _report_files(options.output):
            if page.exists() and not options.force:
                raise OutputError("exists already", where=str(page), expected="another --output, or --force")
    text = read_text(options.calibration, FILE_KIND)
    calibration = parse_calibration(text, str(options.calibration))
    recording, instruments = _read_recording(options, calibration, report)
    report(f"{procedure.name}: fitting")
    given = {
        name: " ".join(value) if isinstance(value, list) else value
        for name, value in given_options(procedure.options, options).items()
    }
    outcome = procedure.identify(recording, calibration, settings)
    return CalibrationResult(procedure, given, outcome, recording, instruments, text)


def write_result(result: CalibrationResult, options: argparse.Namespace, console: Console) -> None:
    """Print the verdict; write the new calibration file, and its report, if the command line names one.

    Raises:
        CalibrationError: The file cannot be written.
        OutputError: The report cannot be written.

    """
    outcome, name = result.outcome, result.procedure.name
    text, changes = result.text, None
    if outcome.replacements or outcome.parts:
        context = FitContext(name, result.options, result.instruments, dt.datetime.now(tz=dt.UTC))
        text = update_text(result.text, str(options.calibration), outcome, result.recording, context)
        former, new = (parse_calibration(each, str(options.calibration)) for each in (result.text, text))
        changes = compare_calibrations(former, new)
    verdict = judge_outcome(name, outcome, changes)
    ending = ["No --output: nothing is written."]
    if options.output is not None:
        ending = []
        if changes is not None:
            backup = save_calibration(options.output, text, force=options.force)
            kept = f"; the old file is now {backup}" if backup else ""
            ending = [f"written to {options.output}{kept}", f"content hash {new.content_hash}"]
        page, figures = _report_files(options.output)
        with writing(page):
            page.write_text(
                render_outcome_page(f"{name}, {result.recording.source}", verdict, outcome), encoding="utf-8"
            )
            figures.write_text(outcome_json(name, verdict, outcome), encoding="utf-8")
        ending.append(f"all tables: {page} and {figures.name}")
    if options.all:
        print_outcome(outcome, console)
    elsewhere = "with --all" if options.output is None else f"in {page.name}"
    for line in verdict.lines(ending, elsewhere):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _report_files(output: Path) -> tuple[Path, Path]:
    """Return the page and the JSON file beside a calibration file."""
    return output.with_suffix(".html"), output.with_suffix(".json")


@contextmanager
def _progress() -> Iterator[Callable[[str], object]]:
    """Show the current step from the first report on."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    progress = Progress(*columns, console=Console(stderr=True), transient=True)

    def report(step: str) -> None:
        progress.start()
        progress.add_task(step)

    try:
        yield report
    finally:
        if progress.live.is_started:
            progress.stop()


def _read_recording(
    options: argparse.Namespace, calibration: Calibration, report: Callable[[str], object]
) -> tuple[Recording, list[Instrument]]:
    """Read the bag; return it with the given uncertainties, and the instruments of its references."""
    uncertainties = {topic: _parse_sigmas(topic, text) for topic, text in _split("--uncertainty", options.uncertainty)}
    names = dict(_split("--instrument", options.instrument))
    wanted = getattr(options, destination("reference"), None)
    topics = sorted({wanted, *uncertainties, *names}) if wanted else []
    report(f"reading {options.bag}")
    references = [Reference(topic) for topic in topics]
    recorded = {instrument.topic for fit in calibration.fits for instrument in fit.instruments}
    known = {*uncertainties, *names, *recorded}
    found = load_recording(options.bag, topic=options.topic, references=references, named=known)
    for option, given in (("--uncertainty", uncertainties), ("--instrument", names)):
        for topic in given:
            if topic not in found.tracks:
                expected = ", ".join(found.tracks) or "no option, the bag has no reference"
                raise ParameterError(f"there is no reference {topic}", where=f"option {option}", expected=expected)
    tracks = dict(found.tracks)
    for topic, sigmas in uncertainties.items():
        columns = tracks[topic].values.shape[1]
        tracks[topic] = replace(tracks[topic], sigmas=np.array(_to_track_sigmas(topic, sigmas, columns)))
    instruments = [
        Instrument(
            topic=topic, name=names.get(topic, "not stated"), sigmas=_to_record_sigmas(tracks[topic].sigmas.tolist())
        )
        for topic in (topics or tracks)
    ]
    if found.frame and found.frame != calibration.frames.parent:
        raise BagError(
            f"the scans are of the receiving plate '{found.frame}'",
            where=found.source,
            expected=f"'{calibration.frames.parent}', that of calibration '{calibration.name}': see the option --topic",
        )
    return replace(found, tracks=tracks), instruments


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
        tracks[topic] = replace(track, sigmas=np.array(_to_track_sigmas(topic, recorded[-1], POSE)))
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


def _parse_sigmas(topic: str, text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(np.isfinite(numbers)) or min(numbers) < 0.0:
        expected = "standard uncertainties of zero or more, separated by commas"
        raise ParameterError(f"'{topic}={text}'", where="option --uncertainty", expected=expected)
    return numbers


def _to_track_sigmas(topic: str, sigmas: list[float], columns: int) -> list[float]:
    """Return the standard uncertainty of each column of a track.

    A pose has two, along [m] and about [rad], or six. Its track holds a quaternion, whose components change by half of
    a small rotation.
    """
    if columns == POSE and len(sigmas) in (2, 6):
        along, about = np.repeat(sigmas, 3).reshape(2, 3) if len(sigmas) == 2 else np.reshape(sigmas, (2, 3))  # noqa: PLR2004
        return [*along.tolist(), *(0.5 * about).tolist(), 0.5 * float(np.mean(about))]
    if columns != POSE and len(sigmas) in (1, columns):
        return sigmas * (columns // len(sigmas))
    expected = "2 numbers, m,rad, or 6" if columns == POSE else f"1 or {columns} numbers"
    raise ParameterError(f"{len(sigmas)} numbers for {topic}", where="option --uncertainty", expected=expected)


def _to_record_sigmas(sigmas: list[float]) -> list[float]:
    """Return the uncertainties of a track for a fit record: those of a pose about its axes [rad]."""
    return sigmas if len(sigmas) != POSE else [*sigmas[:3], *(2.0 * sigma for sigma in sigmas[3:6])]


if __name__ == "__main__":
    sys.exit(main())
