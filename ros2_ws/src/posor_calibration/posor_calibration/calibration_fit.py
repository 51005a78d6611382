# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fit a calibration: from scans with reference measurements, or from a bag, by a procedure of the registry.

``calibrate`` and ``fit`` share this module: both read and check the recording, run the procedure and update the
calibration here.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from posor.bags.calibration_recording import Reference, load_recording, with_continuous_signs
from posor.bags.recording import POSE, Recording, Track
from posor.calibration.calibration_file import FILE_KIND, Calibration, parse_calibration
from posor.calibration.document_text import document_text
from posor.calibration.file_model import first_problem
from posor.calibration.fit_record import Instrument
from posor.calibration.save import save_calibration
from posor.calibration.yaml_document import read_text
from posor.errors import BagError, FitError, ParameterError, ShapeError, check_type, checked_path, similar_name
from posor.estimation.corrected_scans import corrected_scans
from posor.model.scan import Scans
from posor.numerics.array_types import array_of_caller, freeze_arrays
from pydantic import ValidationError

from posor_calibration.calibration_update import FitContext, update_text
from posor_calibration.procedure_registry import PROCEDURES
from posor_calibration.reference_checks import find_drifts, without_repeated_values

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import ArrayLike

    from posor_calibration.least_squares import Fit
    from posor_calibration.procedure import JointCovariance, Options, Outcome, Procedure

NONE = "none"
"""Text of the option value None."""


@dataclass(frozen=True, repr=False)
class FitResult:
    """Result of a procedure.

    Attributes:
        procedure: Its name.
        calibration: With the new values; the former one if the procedure changes nothing.
        former: The calibration before.
        outcome: New values, fits, tables and figures of the procedure.
        source: The recording.
        text: The new calibration file, comments of the former file kept; empty if nothing is changed.

    """

    procedure: str
    calibration: Calibration
    former: Calibration
    outcome: Outcome
    source: str
    text: str

    def __repr__(self) -> str:
        """Return the procedure and the first sentence of the report."""
        return f"<FitResult of {self.report.splitlines()[0].rstrip('.')}>"

    @property
    def fits(self) -> Mapping[str, Fit]:
        """The least-squares fits by the quantity that was fitted: names, values, sigmas, covariance, residuals."""
        return self.outcome.fits

    @property
    def covariances(self) -> tuple[JointCovariance, ...]:
        """Covariances of the fitted components of the file: their keys, and a matrix in their units."""
        return self.outcome.covariances

    @property
    def report(self) -> str:
        """The verdict, one sentence a line: usable or not, residuals, changes of the file, notes."""
        from posor_calibration.calibration_comparison import compare_calibrations  # noqa: PLC0415  imports plots
        from posor_calibration.outcome_report import judge_outcome  # noqa: PLC0415

        changes = compare_calibrations(self.former, self.calibration) if self.text else None
        verdict = judge_outcome(self.procedure, self.outcome, changes)
        return "\n".join([verdict.headline, *verdict.findings, *verdict.notes])

    def save(self, path: Path | str, *, force: bool = False) -> Path | None:
        """Write the new calibration file; ``force`` replaces an existing file and returns the path of its backup.

        Raises:
            ParameterError: The procedure changes nothing.
            CalibrationError: The file exists and ``force`` is false, or it cannot be written.

        """
        if not self.text:
            raise ParameterError(f"{self.procedure} changes no calibration file", where="FitResult.save")
        return save_calibration(Path(path), self.text, force=force)


def fit(
    procedure: str,
    calibration: Calibration | Path | str,
    data: Scans | Recording | Path | str,
    *,
    references: Mapping[str, ArrayLike | Track] | None = None,
    uncertainties: Mapping[str, float | Sequence[float]] | None = None,
    instruments: Mapping[str, str] | None = None,
    topic: str = "",
    **options: Any,
) -> FitResult:
    """Fit a calibration to recorded scans and reference measurements.

    Args:
        procedure: Name of a procedure (``posor calibrate list``).
        calibration: The calibration to begin from, or its file.
        data: Scans, or a bag with scans and references: a folder with metadata.yaml, a .mcap or a .db3 file.
        references: With ``Scans``: reference values at the stamps of the scans by name, shape (n,) for one number,
            (n, 3) for points x, y, z [m], (n, 7) for poses x, y, z [m] and the unit quaternion x, y, z, w; or tracks
            with stamps of their own.
        uncertainties: Standard uncertainties of references by name or topic: one number for all columns or one each,
            SI; of poses (m, rad), or six numbers.
        instruments: Names of instruments for the fit record, by name or topic of the reference.
        topic: Of the scans in the bag; empty: the only one.
        **options: Of the procedure (``posor calibrate PROCEDURE --help``, ``-`` written as ``_``).

    Returns:
        The new calibration with report, fits and covariances; nothing is written.

    Raises:
        ParameterError: The procedure or an option is unknown, or an argument is invalid.
        ShapeError: A reference has the wrong shape.
        PosorError: The calibration, the bag or the data cannot be used.

    """
    if str(procedure) not in PROCEDURES:
        expected = similar_name(str(procedure), PROCEDURES, f"one of {', '.join(PROCEDURES)}")
        raise ParameterError(f"procedure {procedure!r} is unknown", where="fit", expected=expected)
    selected = PROCEDURES[procedure]
    settings = check_options(selected.options, options, lambda name: f"fit, option {name}")
    text, source = "", ""
    if isinstance(calibration, str | Path):
        file = checked_path(calibration, "fit, calibration", "the path of a calibration file")
        text, source = read_text(file, FILE_KIND), str(file)
        calibration = parse_calibration(text, source)
    check_type(calibration, Calibration, "fit, calibration")
    for name, given in (("references", references), ("uncertainties", uncertainties), ("instruments", instruments)):
        check_type({} if given is None else given, Mapping, f"fit, {name}")
    sigmas = {
        name: np.atleast_1d(array_of_caller(value, name, "fit, uncertainties")).tolist()
        for name, value in (uncertainties or {}).items()
    }
    names = dict(instruments or {})
    for name, instrument in names.items():
        check_type(instrument, str, f"fit, instruments, {name}")
    if isinstance(data, str | Path):
        if references is not None:
            raise ParameterError("references beside a bag", where="fit", expected="the references of the bag")
        wanted = getattr(settings, "reference", None)
        recording, found = read_recording(Path(data), calibration, sigmas, names, topic=topic, reference=wanted)
    else:
        recording = data if isinstance(data, Recording) else _recording_of(data, references or {})
        if len(recording.scans) == 0:
            raise ParameterError("no scans", where="fit, data", expected="at least one")
        recording, found = _with_uncertainties(recording, sigmas, names, list(recording.tracks), "fit, {}")
        recording = _corrected(recording, calibration)
    return fit_recording(selected, calibration, recording, found, settings, options, text=text, source=source)


def fit_recording(
    procedure: Procedure[Any],
    calibration: Calibration,
    recording: Recording,
    instruments: Sequence[Instrument],
    settings: Options,
    given: Mapping[str, Any],
    *,
    text: str = "",
    source: str = "",
    scales: Mapping[str, float] | None = None,
    thermometers: Mapping[str, float] | None = None,
    test_drift: bool = True,
) -> FitResult:
    """Run a procedure on a recording.

    Args:
        procedure: The procedure.
        calibration: To begin from.
        recording: The data.
        instruments: Of the references.
        settings: The procedure's options.
        given: The options that were given, for the fit record.
        text: The calibration file; empty: the calibration has no file.
        source: Name of the file for error messages.
        scales: Relative standard uncertainty of the references' length scale, by the name of its shared term.
        thermometers: Standard uncertainty of the plate's thermometer [K], by the name of its shared term.
        test_drift: Whether to test the drift of the references, which takes further fits.

    Raises:
        PosorError: The data or the new values are invalid.

    """
    _check_environment(recording, calibration)
    recording, repeated = without_repeated_values(recording)
    outcome = procedure.identify(recording, calibration, settings)
    untested = f"Drift of the reference is not tested by {procedure.name}: compare visits of one place."
    notes = (*repeated, *outcome.warnings, *([untested] if recording.tracks and not procedure.drift_of else []))
    drifts = find_drifts(procedure, recording, calibration, settings, outcome) if test_drift else ()
    outcome = replace(outcome, warnings=notes, drifts=drifts)
    for covariance in outcome.covariances:
        freeze_arrays(covariance)
    new = calibration
    if outcome.replacements or outcome.parts:
        texts = {name: _option_text(value) for name, value in given.items()}
        date = dt.datetime.now(tz=dt.UTC)
        context = FitContext(procedure.name, texts, instruments, date, scales or {}, thermometers or {})
        if not text:
            content = calibration.model_dump(mode="json", exclude_defaults=True)
            text, source = document_text(content, f"Fitted by {procedure.name}."), calibration.name
        text = update_text(text, source, outcome, recording, context)
        new = parse_calibration(text, source)
    else:
        text = ""
    return FitResult(procedure.name, new, calibration, outcome, recording.source, text)


def _check_environment(recording: Recording, calibration: Calibration) -> None:
    """Raise FitError if scans have their supply or temperature in another unit."""
    scans, (supply, temperature) = recording.scans, calibration.plausible_environment()
    parts = (
        ("supply voltage", scans.supply_voltages, supply, "V"),
        ("temperature", scans.temperatures, temperature, "K"),
    )
    for name, values, plausible, unit in parts:
        for n in np.flatnonzero((values < plausible.least) | (values > plausible.most))[:1]:
            what = f"{name} {values[n]:g} {unit} of scan {scans.numbers[n]}"
            raise FitError(what, where=recording.source, expected=plausible.expected(float(values[n]), unit))


def check_options(model: type[Options], given: Mapping[str, Any], describe: Callable[[str], str]) -> Options:
    """Return the options of a procedure; ``describe``: where an option is, for errors.

    Raises:
        ParameterError: An option is unknown, missing or invalid.

    """
    for name in given:
        if name not in model.model_fields:
            expected = similar_name(name, model.model_fields, f"one of {', '.join(model.model_fields)}")
            raise ParameterError("is unknown", where=describe(name), expected=expected)
    values = {
        name: None if value == NONE and NoneType in get_args(model.model_fields[name].annotation) else value
        for name, value in given.items()
    }
    try:
        return model.model_validate(values)
    except ValidationError as error:
        complaint = first_problem(error)
        if missing := [str(each["loc"][0]) for each in error.errors() if each["type"] == "missing"]:
            what = "is missing" if len(missing) == 1 else "are missing"
            raise ParameterError(what, where=", ".join(map(describe, missing))) from None
        where = describe(str(complaint.location[0])) if complaint.location else ""
        raise ParameterError(complaint.what, where=where, expected=complaint.expected) from None


def _option_text(value: object) -> str:
    if isinstance(value, list | tuple):
        return " ".join(map(_option_text, value))
    return NONE if value is None else str(value)


def read_recording(
    bag: Path,
    calibration: Calibration,
    uncertainties: Mapping[str, list[float]],
    names: Mapping[str, str],
    *,
    topic: str = "",
    reference: object = None,
    where: str = "fit, {}",
) -> tuple[Recording, list[Instrument]]:
    """Read a bag; return it with the given uncertainties, and the instruments of its references.

    Args:
        bag: Folder or file.
        calibration: Of the POSOR.
        uncertainties: Standard uncertainties by topic.
        names: Instruments by topic.
        topic: Of the scans; empty: the only one.
        reference: The procedure's option ``reference``, where it is the name of a topic; a number is none.
        where: Place of ``uncertainties`` and ``instruments`` in errors.

    """
    topics = sorted({reference, *uncertainties, *names}) if isinstance(reference, str) and reference else []
    recorded = {instrument.topic for each in calibration.fits for instrument in each.instruments}
    known = {*uncertainties, *names, *recorded}
    found = load_recording(bag, topic=topic, references=[Reference(each) for each in topics], named=known)
    recording, instruments = _with_uncertainties(found, uncertainties, names, topics or list(found.tracks), where)
    if found.frame and found.frame != calibration.frames.parent:
        raise BagError(
            f"the scans are of the receiving plate '{found.frame}'",
            where=found.source,
            expected=f"'{calibration.frames.parent}', that of calibration '{calibration.name}': see the option --topic",
        )
    return _corrected(recording, calibration), instruments


def _corrected(recording: Recording, calibration: Calibration) -> Recording:
    """Return a recording whose scans are free of ambient light and of the converter's gain; again, it is the same."""
    scans = corrected_scans(recording.scans, calibration)
    return replace(recording, scans=scans, statuses=scans.statuses)


def _with_uncertainties(
    recording: Recording,
    uncertainties: Mapping[str, list[float]],
    names: Mapping[str, str],
    topics: Collection[str],
    where: str,
) -> tuple[Recording, list[Instrument]]:
    for argument, given in (("uncertainty", uncertainties), ("instrument", names)):
        for topic in given:
            if topic not in recording.tracks:
                expected = ", ".join(recording.tracks) or "no option, the bag has no reference"
                raise ParameterError(f"there is no reference {topic}", where=where.format(argument), expected=expected)
    tracks = dict(recording.tracks)
    for topic, sigmas in uncertainties.items():
        if not sigmas or np.ndim(sigmas) != 1 or not np.all(np.isfinite(sigmas)) or min(sigmas) < 0.0:
            expected = "standard uncertainties of zero or more"
            raise ParameterError(f"{sigmas} for {topic}", where=where.format("uncertainty"), expected=expected)
        columns = tracks[topic].values.shape[1]
        found = to_track_sigmas(topic, sigmas, columns, where.format("uncertainty"))
        tracks[topic] = replace(tracks[topic], sigmas=np.array(found))
    instruments = [
        Instrument(
            topic=topic, name=names.get(topic, "not stated"), sigmas=_to_record_sigmas(tracks[topic].sigmas.tolist())
        )
        for topic in topics
    ]
    return replace(recording, tracks=tracks), instruments


def _recording_of(scans: Scans, references: Mapping[str, ArrayLike | Track]) -> Recording:
    """Return a recording of scans and of references at their stamps."""
    check_type(scans, Scans, "fit, data")
    tracks = {}
    for name, given in references.items():
        track = given
        if not isinstance(track, Track):
            values = array_of_caller(given, name, "fit, references")
            if values.ndim not in (1, 2) or len(values) != len(scans):
                raise ShapeError(name, received=values.shape, expected=f"({len(scans)}, k)", where="fit, references")
            values = values.reshape(len(scans), -1)
            track = Track(scans.stamps_ns, values, np.zeros(values.shape[1]), f"fit, reference {name}")
        if track.values.shape[1] == POSE:
            track = replace(track, values=with_continuous_signs(track.values, track.source))
        tracks[name] = track
    return Recording(scans, tracks, "scans in memory", statuses=scans.statuses)


def to_track_sigmas(topic: str, sigmas: Sequence[float], columns: int, where: str) -> list[float]:
    """Return the standard uncertainty of each column of a track.

    A pose has two, along [m] and about [rad], or six. Its track holds a quaternion, whose components change by half of
    a small rotation.
    """
    if columns == POSE and len(sigmas) in (2, 6):
        along, about = np.repeat(sigmas, 3).reshape(2, 3) if len(sigmas) == 2 else np.reshape(sigmas, (2, 3))  # noqa: PLR2004
        return [*along.tolist(), *(0.5 * about).tolist(), 0.5 * float(np.mean(about))]
    if columns != POSE and len(sigmas) in (1, columns):
        return list(sigmas) * (columns // len(sigmas))
    expected = "2 numbers, m,rad, or 6" if columns == POSE else f"1 or {columns} numbers"
    raise ParameterError(f"{len(sigmas)} numbers for {topic}", where=where, expected=expected)


def _to_record_sigmas(sigmas: list[float]) -> list[float]:
    """Return the uncertainties of a track for a fit record: those of a pose about its axes [rad]."""
    return sigmas if len(sigmas) != POSE else [*sigmas[:3], *(2.0 * sigma for sigma in sigmas[3:6])]
