# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outcomes of procedures in a calibration file: new values, the record of the fit, and invalid outcomes."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import Calibration, calibration_from, load_calibration, parse_calibration
from posor.calibration.designs import design
from posor.calibration.document_text import document_text
from posor.calibration.fit_record import Instrument
from posor.calibration.parameter_covariance import stated_covariance
from posor.calibration.parameter_entries import parameter_entries
from posor.errors import CalibrationError
from posor.estimation.forward import empty_scans
from posor.estimation.posor import Posor
from posor_calibration.calibration_update import FitContext, update_text
from posor_calibration.least_squares import fit_parameters
from posor_calibration.procedure import JointCovariance, Outcome, Part, Replacement
from posor_lab.harness.case_tables import refusal

CONTEXT = FitContext(
    procedure="bench",
    options={"loss": "huber"},
    instruments=[Instrument(topic="/laser", name="interferometer 7", sigmas=[1e-8])],
    date=dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC),
)
RECORDING = Recording(empty_scans(np.zeros(0, dtype=np.int64)), {}, "somewhere/monday", "ab" * 32)
SHIFT, TIP = "sensors[0].probes[0].zero_shift", "sensors[0].probes[0].tip"


def updated(calibration: Calibration, outcome: Outcome, recording: Recording, context: FitContext) -> Calibration:
    text = document_text(calibration.model_dump(mode="json", exclude_defaults=True), "before")
    return parse_calibration(update_text(text, "before", outcome, recording, context), "after")


def outcome() -> Outcome:
    found = fit_parameters(
        lambda p: np.array([p[0] - 0.5, p[0] - 0.7, p[1] - 1.0, p[1] + p[0] - 1.4]), np.zeros(2), "ab", "VV", np.ones(2)
    )
    covariance = np.array([[1e-6, 5e-10], [5e-10, 1e-12]])
    return Outcome(
        method="bench work",
        fits={"line": found},
        replacements=(
            Replacement(SHIFT, 0.123456789012345, 1e-3),
            Replacement(TIP, [-0.076, 1e-6, -4.9e-4], [1e-5, 2e-5, 0.0]),
        ),
        parts=(Part("sessions.today", {"note": "made", "zero_shifts": {"value": [0.0, 0.1, 0.2], "unit": "V"}}),),
        covariances=(JointCovariance((SHIFT, f"{TIP}[0]"), covariance),),
        warnings=("Mind the gap.",),
    )


def test_the_new_file_is_the_old_one_with_new_values_and_a_record(rig_calibrations: dict[str, Path]) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    old = parse_calibration(text, "old")
    new_text = update_text(text, "old", outcome(), RECORDING, CONTEXT)
    new = parse_calibration(new_text, "new")
    probe: Any = new.sensors[0].probes[0]  # type: ignore[attr-defined]
    assert (probe.zero_shift.value, probe.zero_shift.sigma, probe.zero_shift.unit) == (0.123456789012, 1e-3, "V")
    assert probe.tip.sigma == [1e-5, 2e-5, 0.0]
    assert new.sessions["today"].zero_shifts is not None
    assert new.version == 3
    [record] = new.fits
    assert (record.procedure, record.date, record.method) == ("bench", "2026-01-31T12:00:00Z", "bench work")
    assert (record.recording.name, record.recording.sha256) == ("monday", "ab" * 32)
    assert record.former == old.content_hash
    assert record.replaced == [SHIFT, TIP, "sessions.today"]
    assert record.instruments[0].name == "interferometer 7"
    assert record.residuals["line"].freedoms == 2
    np.testing.assert_allclose(record.covariances[0].matrix, outcome().covariances[0].matrix, rtol=1e-11)
    assert record.warnings == ["Mind the gap."]
    # Everything else is the old file, line by line.
    kept = [line for line in text.split("\n") if line in new_text.split("\n")]
    assert len(kept) > len(text.split("\n")) - 8
    again = parse_calibration(update_text(new_text, "new", outcome(), RECORDING, CONTEXT), "again")
    assert [fit_record.former for fit_record in again.fits] == [old.content_hash, new.content_hash]
    assert len({old.content_hash, new.content_hash, again.content_hash}) == 3


def test_a_replaced_value_loses_its_shared_terms_and_gets_that_of_its_reference() -> None:
    """A value from a new reference no longer has the errors of the old one."""
    one, kept = {"value": 1.0, "unit": "1"}, "sensors[0].probes[1].tip"
    content = design("quad_bumpy_ring").model_dump(mode="json", exclude_defaults=True)
    content["shared"] = {
        "cmm": {"uncertainty": {"value": 1e-6, "unit": "1"}, "relative": {f"{TIP}[0]": one, kept: one}},
        "meter": {"uncertainty": {"value": 1e-3, "unit": "V"}, "change": {SHIFT: one}},
    }
    old = calibration_from(content)
    values = replace(outcome(), parts=())
    assert updated(old, values, RECORDING, CONTEXT).shared.keys() == {"cmm"}
    track = Track(np.array([0, 1]), np.zeros((2, 1)), np.zeros(1), "laser")
    measured = replace(RECORDING, tracks={"/laser": track})
    for scale in ({"laser": 2e-7}, {"cmm": 1e-6}):
        new = updated(old, values, measured, replace(CONTEXT, scales=scale))
        [name] = scale
        assert {key for term in new.shared.values() for key in term.relative} == {kept, TIP}
        assert TIP in new.shared[name].relative
        assert SHIFT not in new.shared[name].relative
    text = document_text(old.model_dump(mode="json", exclude_defaults=True), "old")
    new = parse_calibration(update_text(text, "old", values, measured, replace(CONTEXT, scales={"laser": 2e-7})), "")
    assert new.shared.keys() == {"cmm", "laser"}
    error = refusal(CalibrationError, update_text, text, "", values, measured, replace(CONTEXT, scales={"cmm": 2e-6}))
    assert (error.what, error.expected) == ("shared term 'cmm' has the standard uncertainty 1e-06", "2e-06, as given")
    error = refusal(
        CalibrationError, update_text, text, "", values, RECORDING, replace(CONTEXT, scales={"laser": 2e-7})
    )
    assert error.what == "no length by a reference is new"


def test_a_new_map_has_the_scale_of_its_reference() -> None:
    calibration, key = design("triad_diodes"), "sensors[1].maps.factory"
    content = calibration.model_dump(mode="json", exclude_defaults=True)["sensors"][1]["maps"]["factory"]
    mapped = Outcome("bench", {}, parts=(Part(key, content),))
    track = Track(np.array([0, 1]), np.zeros((2, 1)), np.zeros(1), "stage")
    measured = replace(RECORDING, tracks={"/stage": track})
    new = updated(calibration, mapped, measured, replace(CONTEXT, scales={"stage": 1e-3}))
    assert new.shared["stage"].relative.keys() == {f"{key}[{n}].{axis}" for n in range(2) for axis in "xy"}
    assert np.any(Posor(new).shared_effects)


def test_a_thermometer_that_served_several_joints_is_a_shared_term_of_the_gaps() -> None:
    calibration, key = design("quad_bumpy_ring"), "sensors[0].probes[1].volts_to_gap"
    probe: Any = calibration.sensors[0].probes[1]  # type: ignore[attr-defined]
    coefficients = probe.volts_to_gap.array.tolist()
    values = replace(outcome(), parts=(), replacements=(Replacement(key, coefficients, 0.0), *outcome().replacements))
    new = updated(calibration, values, RECORDING, replace(CONTEXT, thermometers={"pt100": 0.05}))
    [(name, term)] = new.shared.items()
    assert (name, term.uncertainty.number, term.uncertainty.unit, set(term.change)) == ("pt100", 0.05, "K", {key})
    assert term.change[key].array.tolist() == [probe.temperature.sensitivity.number, *[0.0] * (len(coefficients) - 1)]
    effects = Posor(new).shared_effects
    assert effects.shape[1] == 1
    assert np.count_nonzero(effects) == 1
    values = replace(outcome(), parts=())
    error = refusal(
        CalibrationError, updated, calibration, values, RECORDING, replace(CONTEXT, thermometers={"pt100": 0.05})
    )
    assert error.what == "no linearisation of a probe with 'temperature' is new"  # nothing depends on the thermometer


@pytest.mark.parametrize(
    ("replacement", "words"),
    [
        (Replacement("sensors[0].probes[9].tip", [0.0] * 3, 0.0), "sensors[0].probes[9].tip: there is no such key."),
        (Replacement("sensors[0].probes[0]", 0.0, 0.0), "sensors[0].probes[0]: is not a quantity."),
        (
            Replacement("sensors[0].probes[0].axis", [0.0, 0.0, 2.0], 0.0),
            "axis [0.0, 0.0, 2.0] has length 2; expected a unit vector.",
        ),
        (Replacement(TIP, [0.0, 0.0], 0.0), "value has 2 numbers; expected 3 numbers."),
        (Replacement(SHIFT, float("nan"), 0.0), "nan is not finite; expected finite numbers."),
    ],
)
def test_an_invalid_outcome_is_refused(replacement: Replacement, words: str, rig_calibrations: dict[str, Path]) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        update_text(text, "rig.yaml", Outcome("bench", {}, (replacement,)), RECORDING, CONTEXT)
    assert str(caught.value).endswith(words)


def record() -> dict[str, Any]:
    return {
        "procedure": "bench",
        "method": "by hand",
        "date": "2026-01-31T12:00:00Z",
        "recording": {"name": "monday", "sha256": "ab" * 32},
        "replaced": [SHIFT],
        "covariances": [{"entries": ["a", "b"], "rows": [[1.0], [0.5, 2.0]]}],
    }


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda r: r["recording"].update(sha256="12"), "sha256 '12'; expected 64 hexadecimal digits, or empty text."),
        (lambda r: r.update(date="yesterday"), "date 'yesterday'; expected such as '2026-01-31T12:00:00Z'."),
        (lambda r: r.update(replaced=[]), "has 0 entries; expected at least 1."),
        (lambda r: r["covariances"][0].update(rows=[[1.0]]), "1 rows; expected 2, one for each entry."),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [2.0]]),
            "row has 1 numbers; expected 2, the lower triangle.",
        ),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [2.0, 1.0]]),
            "it is not a covariance; expected a positive semi-definite matrix.",
        ),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [0.0, -1.0]]),
            "a variance is not positive; expected more than zero on the diagonal.",
        ),
        (lambda r: r.update(former="x"), "former 'x'; expected the content hash of the former calibration."),
    ],
)
def test_a_wrong_fit_record_is_refused(
    spoil: Any, sentence: str, tmp_path: Path, rig_calibrations: dict[str, Path]
) -> None:
    content = yaml.safe_load(rig_calibrations["printed"].read_text(encoding="utf-8"))
    fine = record()
    content |= {"version": 2, "fits": [fine]}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    assert load_calibration(path).fits[0].covariances[0].matrix.tolist() == [[1.0, 0.5], [0.5, 2.0]]
    spoil(fine)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path)
    assert str(caught.value).endswith(sentence)
    assert "key fits[0]" in str(caught.value)


def test_a_file_of_version_1_keeps_its_hash_and_has_no_fits(tmp_path: Path, rig_calibrations: dict[str, Path]) -> None:
    content = yaml.safe_load(rig_calibrations["printed"].read_text(encoding="utf-8"))
    path = tmp_path / "rig.yaml"
    hashes = []
    several: list[dict[str, Any]] = [{}, {"fits": []}, {"version": 2}]
    for changes in several:
        path.write_text(yaml.safe_dump({**content, **changes}, sort_keys=False), encoding="utf-8")
        hashes.append(load_calibration(path).content_hash)
    assert hashes[0] == load_calibration(rig_calibrations["printed"]).content_hash == hashes[1] != hashes[2]
    path.write_text(yaml.safe_dump({**content, "fits": [record()]}, sort_keys=False), encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"key fits: fits in a file of version 1; expected version 2\.$"):
        load_calibration(path)


SECOND_SHIFT, TILT = "sensors[0].probes[1].zero_shift", "sensors[0].target_plane.tilt"


def correlated_outcome(key: str, sigma: float, entries: tuple[str, ...], correlation: float, other: float) -> Outcome:
    matrix = np.array([[sigma**2, correlation * sigma * other], [correlation * sigma * other, other**2]])
    return Outcome("by hand", {}, (Replacement(key, 0.01, sigma),), covariances=(JointCovariance(entries, matrix),))


def correlation(calibration: Calibration, one: str, other: str) -> float:
    names = [entry.name if entry else "" for entry in parameter_entries(calibration)]
    stated = stated_covariance(calibration)
    i, j = names.index(one), names.index(other)
    return float(stated[i, j] / np.sqrt(stated[i, i] * stated[j, j]))


def test_later_records_replace_earlier_ones() -> None:
    one = updated(
        design("triad_diodes"), correlated_outcome(SHIFT, 2e-4, (SHIFT, f"{TILT}[0]"), 0.8, 20e-6), RECORDING, CONTEXT
    )
    assert correlation(one, SHIFT, f"{TILT}[0]") == pytest.approx(0.8)
    two = updated(one, correlated_outcome(SECOND_SHIFT, 1e-4, (SECOND_SHIFT, SHIFT), -0.5, 2e-4), RECORDING, CONTEXT)
    assert correlation(two, SHIFT, f"{TILT}[0]") == pytest.approx(0.8)
    assert correlation(two, SECOND_SHIFT, SHIFT) == pytest.approx(-0.5)
    assert correlation(two, SECOND_SHIFT, f"{TILT}[0]") == pytest.approx(0.0)
    new = Outcome("by hand", {}, (Replacement(SHIFT, 0.0, 1e-4),))
    three = updated(two, new, RECORDING, CONTEXT)
    assert correlation(three, SECOND_SHIFT, SHIFT) == pytest.approx(0.0)
    sigmas = np.sqrt(np.diag(stated_covariance(three)))
    np.testing.assert_allclose(sigmas, Posor(three).stack.parameter_sigmas, rtol=1e-12)
