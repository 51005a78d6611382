# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Write the outcome of a procedure into a calibration: new values, and a fit record of their origin."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.calibration_file import VERSION, parse_calibration
from posor.calibration.edit import edit_document, parse_key_path
from posor.calibration.file_model import first_problem
from posor.calibration.fit_record import CovarianceRecord, FitRecord, Instrument, RecordedData, Residuals
from posor.calibration.parameter_covariance import is_part
from posor.calibration.parameter_entries import parameter_entries
from posor.calibration.quantity import Quantity
from posor.errors import CalibrationError
from pydantic import ValidationError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration

    from posor_calibration.procedure import Outcome

SIGNIFICANT_DIGITS = 12  # digits that are written: more than any sensor has, and still readable


@dataclass(frozen=True)
class FitContext:
    """Content of a fit record besides the outcome."""

    procedure: str
    options: Mapping[str, str]
    instruments: Sequence[Instrument]
    date: dt.datetime
    # Relative standard uncertainty of the length scale of the reference by name of the shared term
    scales: Mapping[str, float] = field(default_factory=dict)
    # Standard uncertainty of the thermometer of the plate by name of the shared term [K]
    thermometers: Mapping[str, float] = field(default_factory=dict)


def update_text(text: str, source: str, outcome: Outcome, recording: Recording, context: FitContext) -> str:
    """Return the text of a calibration file with the outcome of a procedure.

    Everything that is not replaced in ``text`` stays, comments too; ``source`` names the file in errors. Raises
    CalibrationError: the file has no such key, or the new values are invalid.
    """
    former, where = parse_calibration(text, source), f"{source} with the result of {context.procedure}"
    changes = _list_changes(former, outcome, recording, context)
    if former.shared:
        changes["shared"] = _kept_terms(former, outcome)
    result = edit_document(text, source, changes)
    if context.scales or context.thermometers:
        terms = _shared_terms(parse_calibration(result, where), outcome, recording, context)
        result = edit_document(result, where, {"shared": terms})
    parse_calibration(result, where)
    return result


def _list_changes(
    calibration: Calibration, outcome: Outcome, recording: Recording, context: FitContext
) -> dict[str, Any]:
    changes: dict[str, Any] = {"version": VERSION}
    for new in outcome.replacements:
        unit = find_quantity(calibration, new.key).unit
        quantity = {"value": _to_yaml(new.value), "sigma": _to_yaml(new.sigma), "unit": unit}
        try:
            Quantity.model_validate(quantity)
        except ValidationError as error:
            raise _refusal(error, new.key) from None
        changes[new.key] = quantity
    for part in outcome.parts:
        changes[part.key] = _to_yaml(part.content)
    fits = [*calibration.fits, _make_record(calibration, outcome, recording, context)]
    changes["fits"] = [fit.model_dump(mode="json", exclude_defaults=True) for fit in fits]
    return changes


def _replaced(outcome: Outcome) -> list[str]:
    return [*(new.key for new in outcome.replacements), *(part.key for part in outcome.parts)]


def _kept_terms(calibration: Calibration, outcome: Outcome) -> dict[str, Any]:
    """Return the shared terms that still hold: not those of replaced values."""
    replaced, terms = _replaced(outcome), dict[str, Any]()
    for name, term in calibration.shared.items():
        content = term.model_dump(mode="json", exclude_defaults=True)
        for kind in content.keys() & {"relative", "change"}:
            content[kind] = {k: e for k, e in content[kind].items() if not _is_replaced(k, replaced)}
        if content.get("relative") or content.get("change"):
            terms[name] = {kind: part for kind, part in content.items() if part}
    return terms


def _shared_terms(
    calibration: Calibration, outcome: Outcome, recording: Recording, context: FitContext
) -> dict[str, Any]:
    """Return the shared terms of a calibration with the new values: those that it has, and the given ones.

    Raises CalibrationError: a term changes no new value, or the file states another uncertainty of it.
    """
    terms = {name: term.model_dump(mode="json", exclude_defaults=True) for name, term in calibration.shared.items()}
    replaced = _replaced(outcome)
    entries = [entry for name in ("", *calibration.sessions) for entry in parameter_entries(calibration, name)]
    new = {entry.key: entry.quantity.unit for entry in entries if entry and _is_replaced(entry.key, replaced)}
    lengths = {key: {"value": 1.0, "unit": "1"} for key, unit in new.items() if unit == "m" or unit.startswith("m/")}
    no_length = "no length by a reference", "a procedure that replaces lengths by those of a reference"
    no_gap = "no linearisation of a probe with 'temperature'", "gap_linearisation of probes with 'temperature'"
    kinds = (
        ("relative", "1", lengths if recording.tracks else {}, context.scales, no_length),
        ("change", "K", _gaps_per_kelvin(calibration, new), context.thermometers, no_gap),
    )
    for kind, unit, effects, sigmas, (missing, expected) in kinds:
        for name, sigma in sigmas.items():
            if not effects:
                where = f"shared term '{name}' of {context.procedure}"
                raise CalibrationError(f"{missing} is new", where=where, expected=expected)
            own = {"uncertainty": {"value": sigma, "unit": unit}}
            known = terms.setdefault(name, own)
            if known["uncertainty"] != own["uncertainty"]:
                what = f"shared term '{name}' has the standard uncertainty {known['uncertainty']['value']:g}"
                raise CalibrationError(what, where=f"calibration '{calibration.name}'", expected=f"{sigma:g}, as given")
            known[kind] = {**known.get(kind, {}), **effects}
    return terms


def _is_replaced(key: str, replaced: Sequence[str]) -> bool:
    return any(is_part(key, each) for each in replaced)


def _gaps_per_kelvin(calibration: Calibration, replaced: Collection[str]) -> dict[str, Any]:
    """Return the change of replaced linearisations by an error of 1 K of the thermometer of the plate."""
    changes = {}
    for s, sensor in enumerate(calibration.sensors):
        for p, probe in enumerate(getattr(sensor, "probes", ())):
            key, quantity = f"sensors[{s}].probes[{p}].volts_to_gap", probe.volts_to_gap
            if key in replaced and probe.temperature is not None:
                value = [probe.temperature.sensitivity.number, *[0.0] * (quantity.array.size - 1)]
                changes[key] = {"value": value, "unit": f"{quantity.unit}/K"}
    return changes


def find_quantity(calibration: Calibration, key: str) -> Quantity:
    """Return the quantity at a key path; raise CalibrationError if there is none."""
    part: Any = calibration
    where = f"calibration '{calibration.name}', {key}"
    for step in parse_key_path(key):
        try:
            container: Any = part  # mypy accepts integer indices only
            part = container[step] if isinstance(part, dict | list | tuple) else getattr(part, str(step))
        except (AttributeError, LookupError, TypeError):
            raise CalibrationError("there is no such key", where=where) from None
    if not isinstance(part, Quantity):
        raise CalibrationError("is not a quantity", where=where)
    return part


def _refusal(error: ValidationError, where: str) -> CalibrationError:
    complaint = first_problem(error)
    return CalibrationError(complaint.what, where=where, expected=complaint.expected)


def _make_record(calibration: Calibration, outcome: Outcome, recording: Recording, context: FitContext) -> FitRecord:
    return FitRecord(
        procedure=context.procedure,
        method=outcome.method,
        date=context.date.astimezone(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        recording=RecordedData(name=PurePath(recording.source).name, sha256=recording.sha256),
        former=calibration.content_hash,
        options=dict(context.options),
        instruments=list(context.instruments),
        replaced=_replaced(outcome),
        residuals={
            what: Residuals(
                readings=len(fit.residuals),
                parameters=len(fit.names),
                freedoms=fit.freedoms,
                spread=_round(fit.spread),
                probability=_round(fit.probability),
                outliers=int(np.count_nonzero(fit.outliers())),
            )
            for what, fit in outcome.fits.items()
        },
        covariances=[
            CovarianceRecord(
                entries=list(joint.entries),
                rows=[[_round(value) for value in row[: index + 1]] for index, row in enumerate(joint.matrix)],
            )
            for joint in outcome.covariances
        ],
        warnings=list(outcome.warnings),
    )


def _to_yaml(content: Any) -> Any:
    """Return content as plain mappings, lists and rounded numbers."""
    if isinstance(content, dict):
        return {str(key): _to_yaml(value) for key, value in content.items()}
    if isinstance(content, np.ndarray | np.generic):
        return _to_yaml(content.tolist())
    if isinstance(content, list | tuple):
        return [_to_yaml(value) for value in content]
    return _round(content) if isinstance(content, float) else content


def _round(value: float) -> float:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
