"""calibrate: from a recorded bag to a calibration file; also which procedures there are, diff and check."""

from __future__ import annotations

import datetime as dt
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from posor_estimator.bags import Reference, load_recording
from posor_estimator.calibrate.options import add_options, destination, given_options, options_of
from posor_estimator.calibrate.show import WIDTH, show_comparison, show_explained, show_outcome
from posor_estimator.core.calibrate.bundle import BundleOptions
from posor_estimator.core.calibrate.compare import compare
from posor_estimator.core.calibrate.explain import explained
from posor_estimator.core.calibrate.procedure import procedures
from posor_estimator.core.calibrate.result import Run, written
from posor_estimator.core.calibration.fit_record import Instrument
from posor_estimator.core.calibration.load import KIND, calibration_of, load_calibration, read_text
from posor_estimator.core.calibration.save import refuse_existing, save
from posor_estimator.errors import BagError, ParameterError, PosorError
from posor_estimator.reporting.command_line import Parser

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from posor_estimator.core.calibrate.procedure import Outcome, Procedure
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration

POSE_TRACK = 7
NOT_EXPLAINED = 3
"""Exit code of ``check`` for a calibration that does not explain the bag."""


def parser() -> Parser:
    """Return the parser of the command line."""
    whole = Parser(prog="calibrate", description="From recorded bags to a calibration file one can trust.")
    actions = whole.add_subparsers(dest="action", required=True, metavar="PROCEDURE|list|diff|check")
    actions.add_parser("list", help="say which procedures there are")
    diff = actions.add_parser("diff", help="how two calibration files differ, in sigmas")
    diff.add_argument("first", type=Path, metavar="A.yaml")
    diff.add_argument("second", type=Path, metavar="B.yaml")
    diff.add_argument("--all", action="store_true", help="show every number that differs")
    check = actions.add_parser("check", help="whether a calibration file still explains a bag; what has drifted")
    check.add_argument("calibration", type=Path, metavar="FILE.yaml")
    _add_recording(check)
    add_options(check, BundleOptions, but=("loss", "covariance", "seed"))
    for procedure in procedures().values():
        one = actions.add_parser(procedure.name, help=procedure.summary, description=procedure.summary)
        _add_recording(one)
        one.add_argument("--calibration", type=Path, required=True, metavar="IN.yaml", help="what to begin from")
        one.add_argument("--output", type=Path, metavar="OUT.yaml", help="the file with the result; default: none")
        one.add_argument("--force", action="store_true", help="replace OUT.yaml, the old one is kept beside it")
        add_options(one, procedure.options)
    return whole


def _add_recording(to: argparse.ArgumentParser) -> None:
    to.add_argument("bag", type=Path, metavar="BAG", help="folder of a rosbag2 bag, or its .mcap or .db3 file")
    to.add_argument("--topic", default="", help="of the raw scans (default: the only one)")
    text = "standard uncertainty of what a reference topic says, SI: one number for all, or one for each; a pose: m,rad"
    to.add_argument("--uncertainty", action="append", default=[], metavar="TOPIC=S[,S...]", help=text)
    text = "what a reference topic was measured with, for the file; may be repeated"
    to.add_argument("--instrument", action="append", default=[], metavar="TOPIC=NAME", help=text)
    to.add_argument("--all", action="store_true", help="show every line of long tables")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; the exit code is 0 where it did what it was asked for, 3 where a check says no."""
    try:
        options = parser().parse_args(arguments)
        return _run(options, Console(width=WIDTH))
    except PosorError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code


def _run(options: argparse.Namespace, console: Console) -> int:
    if options.action == "list":
        table = Table(title="Calibration procedures; options: calibrate PROCEDURE --help", title_justify="left")
        table.add_column("procedure", no_wrap=True)
        table.add_column("what it does")
        for procedure in procedures().values():
            table.add_row(procedure.name, procedure.summary)
        console.print(table)
        return 0
    if options.action == "diff":
        found = compare(load_calibration(options.first), load_calibration(options.second))
        show_comparison(found, console, every=options.all)
        return 0
    if options.action == "check":
        return _check(options, console)
    with _progress() as say:
        calibrated = calibrate(options, say)
    tell(calibrated, options, console)
    return 0


def _check(options: argparse.Namespace, console: Console) -> int:
    settings: Any = options_of(BundleOptions, options)
    calibration = load_calibration(options.calibration)
    with _progress() as say:
        recording, _ = _recording(options, say)
        _check_frame(recording, calibration)
        say("fitting")
        found = explained(recording, calibration, settings)
    show_explained(found, console, every=options.all)
    return 0 if found.explains else NOT_EXPLAINED


@dataclass(frozen=True)
class Calibrated:
    """What a procedure found, and from what.

    Attributes:
        procedure: The procedure.
        options: Its options, by name, as they were given.
        outcome: What it found.
        recording: From what.
        instruments: What the references were measured with.
        text: The calibration file that it began from.

    """

    procedure: Procedure[Any]
    options: Mapping[str, str]
    outcome: Outcome
    recording: Recording
    instruments: Sequence[Instrument]
    text: str


def calibrate(options: argparse.Namespace, say: Callable[[str], object]) -> Calibrated:
    """Run the procedure that a parsed command line asks for.

    Args:
        options: As ``parser`` reads them.
        say: Told what is being done.

    Raises:
        PosorError: The options, the files or the recording do not serve.

    """
    procedure = procedures()[options.action]
    settings = options_of(procedure.options, options)
    if options.output is not None:
        refuse_existing(options.output, force=options.force)
    text = read_text(options.calibration, KIND)
    calibration = calibration_of(text, str(options.calibration))
    recording, instruments = _recording(options, say)
    _check_frame(recording, calibration)
    say(f"{procedure.name}: fitting")
    given = given_options(procedure.options, options)
    said = {name: " ".join(value) if isinstance(value, list) else value for name, value in given.items()}
    outcome = procedure.run(recording, calibration, settings)
    return Calibrated(procedure, said, outcome, recording, instruments, text)


def tell(found: Calibrated, options: argparse.Namespace, console: Console) -> None:
    """Print what was found, and write the new calibration file if the command line names one.

    Raises:
        CalibrationError: The file cannot be written.

    """
    outcome = found.outcome
    show_outcome(outcome, console, every=options.all)
    if options.output is None:
        console.print("No --output: nothing is written.")
    elif not outcome.replacements and not outcome.parts:
        console.print(f"{found.procedure.name} replaces nothing in a calibration file: nothing is written.")
    else:
        run = Run(found.procedure.name, found.options, found.instruments, dt.datetime.now(tz=dt.UTC))
        result = written(found.text, str(options.calibration), outcome, found.recording, run)
        kept = save(options.output, result, force=options.force)
        console.print(f"written to {options.output}" + (f"; the old file is now {kept}" if kept else ""))
        console.print(f"content hash {calibration_of(result, str(options.output)).content_hash}")


@contextmanager
def _progress() -> Iterator[Callable[[str], object]]:
    """Show what is being done from the first time that it is said."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    progress = Progress(*columns, console=Console(stderr=True), transient=True)

    def say(what: str) -> None:
        progress.start()
        progress.add_task(what)

    try:
        yield say
    finally:
        if progress.live.is_started:
            progress.stop()


def _recording(options: argparse.Namespace, say: Callable[[str], object]) -> tuple[Recording, list[Instrument]]:
    """Read the bag; return it with the uncertainties that were given, and what its references were measured with."""
    uncertainties = {topic: _numbers(topic, text) for topic, text in _by_topic("--uncertainty", options.uncertainty)}
    names = dict(_by_topic("--instrument", options.instrument))
    wanted = getattr(options, destination("reference"), None)
    topics = sorted({wanted, *uncertainties, *names}) if wanted else []
    say(f"reading {options.bag}")
    found = load_recording(options.bag, topic=options.topic, references=[Reference(topic) for topic in topics])
    for option, given in (("--uncertainty", uncertainties), ("--instrument", names)):
        for topic in given:
            if topic not in found.tracks:
                expected = ", ".join(found.tracks) or "no option, the bag has no reference"
                raise ParameterError(f"there is no reference {topic}", where=f"option {option}", expected=expected)
    tracks = dict(found.tracks)
    for topic, sigmas in uncertainties.items():
        track = tracks[topic]
        tracks[topic] = replace(track, sigmas=np.array(_of_track(topic, sigmas, track.values.shape[1])))
    instruments = [
        Instrument(topic=topic, name=names.get(topic, "not said"), sigmas=_in_file(tracks[topic].sigmas.tolist()))
        for topic in (topics or tracks)
    ]
    return replace(found, tracks=tracks), instruments


def _check_frame(recording: Recording, calibration: Calibration) -> None:
    """Refuse scans of another joint than the calibration is of.

    Raises:
        BagError: They are of another receiving plate.

    """
    if recording.frame and recording.frame != calibration.frames.parent:
        raise BagError(
            f"the scans are of the receiving plate '{recording.frame}'",
            where=recording.source,
            expected=f"'{calibration.frames.parent}', that of calibration '{calibration.name}': see the option --topic",
        )


def _by_topic(option: str, given: Sequence[str]) -> list[tuple[str, str]]:
    pairs = []
    for text in given:
        topic, equals, value = text.partition("=")
        if not (topic and equals and value.strip()):
            raise ParameterError(f"'{text}'", where=f"option {option}", expected="TOPIC=..., such as /cmm/pose=...")
        pairs.append((topic, value))
    return pairs


def _numbers(topic: str, text: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(np.isfinite(numbers)) or min(numbers) < 0.0:
        expected = "standard uncertainties of zero or more, parted by commas"
        raise ParameterError(f"'{topic}={text}'", where="option --uncertainty", expected=expected)
    return numbers


def _of_track(topic: str, sigmas: list[float], columns: int) -> list[float]:
    """Return the standard uncertainty of each number of a track.

    A pose has two, along [m] and about [rad], or six; its track holds a quaternion, whose components change by half of
    a small turn.
    """
    if columns == POSE_TRACK and len(sigmas) in (2, 6):
        along, about = (sigmas[:1] * 3, sigmas[1:] * 3) if len(sigmas) == 2 else (sigmas[:3], sigmas[3:])  # noqa: PLR2004
        return [*along, *(0.5 * sigma for sigma in about), 0.5 * float(np.mean(about))]
    if columns != POSE_TRACK and len(sigmas) in (1, columns):
        return sigmas * (columns // len(sigmas))
    expected = "2 numbers, m,rad, or 6" if columns == POSE_TRACK else f"1 or {columns} numbers"
    raise ParameterError(f"{len(sigmas)} numbers for {topic}", where="option --uncertainty", expected=expected)


def _in_file(sigmas: list[float]) -> list[float]:
    """Return the uncertainties of a track as a fit record has them: a pose's about its axes [rad]."""
    if len(sigmas) != POSE_TRACK:
        return sigmas
    return [*sigmas[:3], *(2.0 * sigma for sigma in sigmas[3:6])]


if __name__ == "__main__":
    sys.exit(main())
