# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A reference that drifts, or repeats its last value, is found with its size where the recording shows it."""

from __future__ import annotations

from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from posor.bags.recording import Recording, Track
from posor.calibration.designs import STANDOFF
from posor.calibration.quantity import Quantity
from posor.errors import FitError, PosorError, TrackError
from posor.numerics.array_types import FloatArray
from posor.sensors.gap_probes import GapProbesCalibration, ReferenceVoltage
from posor_calibration.calibration_fit import FitResult, fit
from posor_calibration.procedure_registry import PROCEDURES
from posor_calibration.reference_checks import check_visits, find_drifts, find_repeated_values
from posor_lab.harness.simulated_recordings import diode_calibration, lifted_recording, tilted_recording
from scipy.spatial.transform import Rotation

SIGMA = 50e-9
UP = STANDOFF + np.linspace(-0.4e-3, 0.4e-3, 16)
TRAVELS = {"one way": UP, "return to the start": np.append(UP, UP[0]), "up and down": np.concatenate([UP, UP[::-1]])}
ORDER: dict[str, Any] = {"order": 4, "highest_order": 4}
UNTESTED = "Drift of the reference is not tested (/reference): return to the start, more often or for longer."


def recorded(travel: str) -> Recording:
    found = lifted_recording(diode_calibration(), TRAVELS[travel], np.random.default_rng(1), scans_each=20)
    [(topic, track)] = found.tracks.items()
    return replace(found, tracks={topic: replace(track, sigmas=np.array([SIGMA]))})


def with_values(recording: Recording, values: FloatArray) -> Recording:
    [(topic, track)] = recording.tracks.items()
    return replace(recording, tracks={topic: replace(track, values=values)})


def track_of(recording: Recording) -> Track:
    [track] = recording.tracks.values()
    return track


def drifting(travel: str, size: float) -> FitResult:
    recording = recorded(travel)
    values = track_of(recording).values
    share = np.linspace(0.0, 1.0, len(values))[:, None]
    return fit(
        "gap_linearisation",
        diode_calibration(),
        with_values(recording, values + size * share),
        highest_order=3,
        order=3,
    )


@pytest.mark.parametrize(("travel", "size"), [("one way", 5e-6), ("return to the start", 0.0)])
def test_a_travel_that_does_not_show_a_drift_says_so(travel: str, size: float) -> None:
    result = drifting(travel, size)
    assert UNTESTED in result.report.splitlines()
    assert not any(test.is_tested for test in result.outcome.drifts)


def test_a_step_after_which_the_fits_leave_out_other_dwells_says_that_drift_is_not_tested() -> None:
    recording = recorded("one way")
    values = track_of(recording).values.copy()
    values[int(0.9 * len(values)) :] += 1e-6
    options: dict[str, Any] = {"highest_order": 3, "order": 3}
    result = fit("gap_linearisation", diode_calibration(), with_values(recording, values), **options)
    assert UNTESTED in result.report.splitlines()


def test_a_drift_is_found_with_its_size_where_the_target_returns() -> None:
    [test] = drifting("up and down", 0.0).outcome.drifts
    assert test.is_tested
    assert abs(test.drift) < 4.0 * test.sigma
    result = drifting("up and down", 0.45e-6)
    [test] = result.outcome.drifts
    assert test.is_found
    assert abs(test.drift - 0.45e-6) < 4.0 * test.sigma
    assert "usable with care: a reference drifts" in result.report


@pytest.mark.parametrize(
    ("travel", "size", "sentence"),
    [
        ("return to the start", 5e-6, r"the reference has drifted by 4\.[789]e-06 .* dwells 1 and 17"),
        ("up and down", 5e-6, r"the reference has drifted by \S+ .* between two visits of one place"),
    ],
)
def test_a_drift_far_beyond_the_uncertainty_is_refused(travel: str, size: float, sentence: str) -> None:
    with pytest.raises(FitError, match=sentence):
        drifting(travel, size)


VISITS: dict[str, tuple[list[float], list[float], bool]] = {
    "a return": ([0.0, 1.0, 0.0], [0.0, 1.0, 1e-3], True),
    "a place that the target has hardly left": ([0.0, 0.05, 0.0, 1.0], [0.0, 0.05, 1e-3, 1.0], False),
    "a calibration before its fit": ([0.0, 1.0, 0.009], [0.0, 1.0, 0.0095], False),
}


@pytest.mark.parametrize(("measured", "reference", "refused"), VISITS.values(), ids=VISITS.keys())
def test_only_returns_show_a_drift_between_visits(
    measured: list[float], reference: list[float], *, refused: bool
) -> None:
    sigmas = np.full(len(measured), 1e-5)
    with pytest.raises(FitError) if refused else nullcontext():
        check_visits(np.array(measured), np.array(reference), sigmas, "bag")


def test_a_drift_of_angles_is_named_with_its_size() -> None:
    leans = np.concatenate([np.outer(np.linspace(-5e-3, 5e-3, 9), axis) for axis in np.eye(2)])
    recording = tilted_recording(diode_calibration(), leans, np.random.default_rng(1), sigma=1.5e-6)
    track, size = track_of(recording), 9e-6
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, size, len(track.values)), [1.0, 0.0, 0.0]))
    turned = (turns * Rotation.from_quat(track.values[:, 3:])).as_quat()
    moved = with_values(recording, np.column_stack([track.values[:, :3], turned]))
    about_x, _ = fit("probe_spacing", diode_calibration(), moved).outcome.drifts
    assert about_x.quantity == "rotation about x"
    assert about_x.is_found
    assert abs(about_x.drift - size) < 4.0 * about_x.sigma


def held(values: FloatArray, begin: int, count: int) -> FloatArray:
    values = values.copy()
    values[begin : begin + count] = values[begin]
    return values


def test_values_repeated_in_motion_are_left_out_up_to_a_tenth() -> None:
    recording = recorded("one way")
    values = track_of(recording).values
    calibration = diode_calibration()
    result = fit("gap_linearisation", calibration, with_values(recording, held(values, 100, 38)), **ORDER)
    assert any("repeats a value at" in note for note in result.outcome.warnings)
    with pytest.raises(TrackError, match=r"repeats a value at \d+ of 400 values while the readings move, first after"):
        fit("gap_linearisation", calibration, with_values(recording, held(values, 100, 80)), **ORDER)
    with pytest.raises(TrackError, match="repeats a value"):  # the instrument stops before the end
        fit("gap_linearisation", calibration, with_values(recording, held(values, 300, 100)), **ORDER)


def test_sample_and_hold_is_found_and_coarse_resolution_is_not() -> None:
    lifts = STANDOFF + 0.4e-3 * np.sin(np.linspace(0.0, 6.0, 300))
    moving = lifted_recording(diode_calibration(), lifts, np.random.default_rng(2), scans_each=1)
    track = track_of(moving)
    sampled = np.repeat(track.values[::20], 20, axis=0)[: len(track.values)]
    assert np.mean(find_repeated_values(moving, replace(track, values=sampled))) > 0.5
    for resolution in (1e-6, 20e-6):  # equal values for a fraction of a scan, and for many scans
        coarse = replace(track, values=resolution * np.round(track.values / resolution))
        assert not find_repeated_values(moving, coarse).any()


def test_equal_values_at_rest_are_not_repeated() -> None:
    recording = recorded("up and down")
    track = track_of(recording)
    assert np.mean(np.diff(track.values, axis=0) == 0.0) > 0.5
    assert not find_repeated_values(recording, track).any()


@pytest.mark.parametrize(
    "count", [len(TRAVELS), pytest.param(1000, marks=[pytest.mark.long, pytest.mark.timeout(3600)])]
)
def test_sound_recordings_raise_no_alarm(count: int) -> None:
    procedure, calibration, alarms = PROCEDURES["gap_linearisation"], diode_calibration(), Counter[str]()
    options = procedure.options(**ORDER)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        sigma, resolution, turns = 10.0 ** rng.uniform(-8.0, -6.3), 10.0 ** rng.uniform(-7.0, -4.7), rng.uniform(1, 9)
        moving = STANDOFF + 0.4e-3 * np.sin(np.linspace(0.0, turns, 300))
        swing = lifted_recording(calibration, moving, rng, scans_each=1)
        coarse = resolution * np.round(track_of(swing).values / resolution)
        alarms["repeated in motion"] += bool(find_repeated_values(swing, replace(track_of(swing), values=coarse)).any())
        lifts = [*TRAVELS.values()][seed % len(TRAVELS)]
        dwells = lifted_recording(calibration, lifts, rng, scans_each=int(rng.integers(12, 40)), sigma=sigma)
        alarms["repeated at rest"] += bool(find_repeated_values(dwells, track_of(dwells)).any())
        try:
            outcome = procedure.identify(dwells, calibration, options)
            found = find_drifts(procedure, dwells, calibration, options, outcome)
        except PosorError:
            alarms["refused"] += 1
        else:
            alarms["drift"] += any(test.is_found for test in found)
    assert not +alarms


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("temperatures", 20.0, r"temperature 20 K of scan 0; expected 100 to 600 K \(in degrees Celsius\?\)"),
        ("supply_voltages", 15000.0, r"supply voltage 15000 V of scan 0; expected .* V \(in mV\?\)"),
    ],
)
def test_scans_in_another_unit_calibrate_nothing(field: str, value: float, sentence: str) -> None:
    recording = recorded("one way")
    scans = recording.scans.with_fields({field: np.full(len(recording.scans), value)})
    with pytest.raises(FitError, match=sentence):
        fit("gap_linearisation", diode_calibration(), replace(recording, scans=scans), **ORDER)


def test_scans_in_memory_are_free_of_the_gain_of_the_converter() -> None:
    """As those of a bag are: the converter reads half a percent too much, and its known voltage too."""
    calibration, known = diode_calibration(), 5.0
    sensors = [
        each.model_copy(
            update={
                "reference": ReferenceVoltage(
                    voltage=Quantity(value=known, unit="V"),
                    noise=Quantity(value=1e-5, unit="V"),
                    spread=Quantity(value=1e-3, unit="1"),
                    limit=Quantity(value=0.02, unit="1"),
                )
            }
        )
        if isinstance(each, GapProbesCalibration)
        else each
        for each in calibration.sensors
    ]
    calibration = calibration.model_copy(update={"sensors": sensors})
    right = recorded("up and down")
    scans = right.scans.with_fields({"reference_voltages": np.full(len(right.scans), known)})
    gained = scans.with_fields({name: 1.005 * getattr(scans, name) for name in ("gap_voltages", "reference_voltages")})
    found = [
        fit("gap_linearisation", calibration, replace(right, scans=each), **ORDER).outcome.replacements[0].value
        for each in (scans, gained)
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
