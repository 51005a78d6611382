"""What a procedure found, as the text of a calibration file: the old file with the new values and their origin."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from posor_estimator.core.calibration.edit import edited, parsed
from posor_estimator.core.calibration.fit_record import (
    CovarianceRecord,
    FitRecord,
    Instrument,
    RecordedData,
    Residuals,
)
from posor_estimator.core.calibration.load import calibration_of
from posor_estimator.core.calibration.model import VERSION, calibration_from
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.calibration.sentences import first_complaint
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibrate.replacement import JointCovariance
    from posor_estimator.core.calibration.model import Calibration

_DIGITS = 12
"""Significant decimal digits that are written: no sensor has more, and twelve can be read."""


@dataclass(frozen=True)
class Run:
    """What a fit record says of a run besides its outcome."""

    procedure: str
    options: Mapping[str, str]
    instruments: Sequence[Instrument]
    date: dt.datetime


def written(text: str, source: str, outcome: Outcome, recording: Recording, run: Run) -> str:
    """Return the text of a calibration file with what a procedure found.

    Args:
        text: The file that the procedure began from; what is not replaced stays, comments too.
        source: What to call it in complaints.
        outcome: What the procedure found; it must replace something.
        recording: From what.
        run: How.

    Raises:
        CalibrationError: A key is not one of the file's, or the new values cannot be: the sentence says which.

    """
    changes = _changes(calibration_of(text, source), outcome, recording, run)
    result = edited(text, source, changes)
    calibration_of(result, f"{source} with the result of {run.procedure}")
    return result


def applied(calibration: Calibration, outcome: Outcome, recording: Recording, run: Run) -> Calibration:
    """Return a calibration with what a procedure found: what ``written`` makes of its file, without a file.

    Raises:
        CalibrationError: As ``written``.

    """
    content: Any = calibration.model_dump(mode="json", exclude_defaults=True)
    for key, new in _changes(calibration, outcome, recording, run).items():
        *path, last = parsed(key)
        part = content
        for step in path:
            part = part[step]
        part[last] = new
    try:
        return calibration_from(content)
    except ValidationError as error:
        complaint = first_complaint(error)
        raise CalibrationError(complaint.what, where=run.procedure, expected=complaint.expected) from None


def _changes(calibration: Calibration, outcome: Outcome, recording: Recording, run: Run) -> dict[str, Any]:
    """Return what becomes of the file: new content by key."""
    changes: dict[str, Any] = {"version": VERSION}
    for new in outcome.replacements:
        unit = quantity_at(calibration, new.key).unit
        changes[new.key] = _checked(new.key, {"value": _plain(new.value), "sigma": _plain(new.sigma), "unit": unit})
    for part in outcome.parts:
        changes[part.key] = _plain(part.content)
    record = _record(calibration, outcome, recording, run)
    fits = [*calibration.fits, record]
    changes["fits"] = [fit.model_dump(mode="json", exclude_defaults=True) for fit in fits]
    return changes


def quantity_at(calibration: Calibration, key: str) -> Quantity:
    """Return the quantity at a key path.

    Raises:
        CalibrationError: There is none.

    """
    part: Any = calibration
    for step in parsed(key):
        try:
            listed: Any = part  # mypy takes an index for a whole number only
            part = listed[step] if isinstance(part, dict | list | tuple) else getattr(part, str(step))
        except (AttributeError, LookupError, TypeError):
            raise CalibrationError("there is no such key", where=f"calibration '{calibration.name}', {key}") from None
    if not isinstance(part, Quantity):
        raise CalibrationError("is no quantity", where=f"calibration '{calibration.name}', {key}")
    return part


def _checked(key: str, quantity: dict[str, Any]) -> dict[str, Any]:
    try:
        Quantity.model_validate(quantity)
    except ValidationError as error:
        complaint = first_complaint(error)
        raise CalibrationError(complaint.what, where=key, expected=complaint.expected) from None
    return quantity


def _record(calibration: Calibration, outcome: Outcome, recording: Recording, run: Run) -> FitRecord:
    return FitRecord(
        procedure=run.procedure,
        method=outcome.method,
        date=run.date.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        recording=RecordedData(name=PurePath(recording.source).name, sha256=recording.sha256),
        former=calibration.content_hash,
        options=dict(run.options),
        instruments=list(run.instruments),
        replaced=[*(new.key for new in outcome.replacements), *(part.key for part in outcome.parts)],
        residuals={what: residuals_of(fit) for what, fit in outcome.fits.items()},
        covariances=[_covariance(joint) for joint in outcome.covariances],
        warnings=list(outcome.warnings),
    )


def residuals_of(fit: Fit) -> Residuals:
    """Return the figures of a fit as the file has them."""
    return Residuals(
        readings=len(fit.residuals),
        parameters=len(fit.names),
        freedoms=fit.freedoms,
        spread=_rounded(fit.spread),
        probability=_rounded(fit.probability),
        outliers=int(np.count_nonzero(fit.outliers())),
    )


def _covariance(joint: JointCovariance) -> CovarianceRecord:
    rows = [[_rounded(value) for value in row[: index + 1]] for index, row in enumerate(joint.matrix)]
    return CovarianceRecord(entries=list(joint.entries), rows=rows)


def _plain(content: Any) -> Any:
    """Return content as YAML has it: no arrays, no tuples, numbers with the digits that they are worth."""
    if isinstance(content, dict):
        return {str(key): _plain(value) for key, value in content.items()}
    if isinstance(content, np.ndarray | np.generic):
        return _plain(content.tolist())
    if isinstance(content, list | tuple):
        return [_plain(value) for value in content]
    return _rounded(content) if isinstance(content, float) else content


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
