# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Orientation of the target plane: simulated turns with a known tilt, and the vertical test of 1985."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.bags.recording import Recording
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import DesignName, design
from posor.errors import FitError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.array_types import FloatArray
from posor_calibration.procedure import Outcome
from posor_calibration.procedures.target_plane import PROCEDURE

from .recordings_1985 import LEVER, recorded
from .simulated_case import SimulatedCase, check_coverage

WOBBLE = 5e-6


def turned(random: np.random.Generator, name: DesignName, thetas: FloatArray) -> SimulatedCase:
    """Return scans of a target that turns about an unsteady axis, and the true tilts."""
    posor = Posor(design(name))
    names, values = list(posor.stack.parameter_names), posor.stack.parameter_values
    where = [names.index(f"GapProbes.plane_tilt[{i}]") for i in range(2)]
    values[where] += 1e-3 * random.normal(size=2)
    leans = np.array([1e-3, -2e-3]) + WOBBLE * random.normal(size=(len(thetas), 2))
    rotations = np.array([rotation_from_native(a, b, t) for (a, b), t in zip(leans, thetas, strict=True)])
    translations = np.tile([2e-4, -1e-4, 0.7e-3], (len(thetas), 1))
    stamps = (1 + np.arange(len(thetas), dtype=np.int64)) * 10_000_000
    scans = scans_at(posor.stack.with_parameter_values(values), rotations, translations, stamps, noise=random)
    return SimulatedCase(PROCEDURE, design(name), Recording(scans, {}, "simulated"), values[where])


def normalised_errors(case: SimulatedCase, outcome: Outcome) -> FloatArray:
    fit = outcome.fits["target_plane"]
    return np.asarray((fit.values[:2] - case.truth) / fit.sigmas[:2])


@pytest.mark.long
def test_intervals_cover(rng: np.random.Generator) -> None:
    cases = [turned(rng, "triad_light_ring", np.linspace(-np.pi, np.pi, 25)) for _ in range(25)]
    check_coverage([normalised_errors(case, case.identify()) for case in cases], 0.05, 0.2)


@pytest.mark.parametrize("loss", ["soft_l1", "huber"])
def test_five_percent_of_outliers_are_named_and_survived(rng: np.random.Generator, loss: Any) -> None:
    case = turned(rng, "triad_light_ring", np.linspace(-np.pi, np.pi, 80))
    where = np.s_[[5, 23, 41, 70], [0, 1, 2, 1]]
    bad = case.with_readings("gap_voltages", lambda volts: volts + 1.0, where)
    bad.check_refusal(FitError, "times as large as the stated uncertainties explain, the worst is")
    outcome = bad.identify(loss=loss)
    assert np.abs(normalised_errors(case, outcome)).max() < 4.0
    assert np.max(outcome.fits["target_plane"].sigmas[:2]) < 5e-6
    warning = next(sentence for sentence in outcome.warnings if "readings are outliers" in sentence)
    assert "beta of scan 5, alpha of scan 23, beta of scan 23" in warning


def test_full_turns_determine_more_than_small_ones(rng: np.random.Generator) -> None:
    full = turned(rng, "triad_light_ring", np.linspace(-np.pi, np.pi, 40)).identify().fits["target_plane"]
    assert np.max(full.sigmas[:2]) < 5e-6
    case = turned(rng, "triad_diodes", np.linspace(-0.08, 0.08, 40))
    outcome = case.identify(expected_tilt=2e-5)
    assert np.min(outcome.fits["target_plane"].sigmas[:2]) > 1e-5
    assert np.abs(normalised_errors(case, outcome)).max() < 4.0
    assert any(sentence.startswith("The data hardly determine tilt") for sentence in outcome.warnings)


def test_without_a_turn_there_is_no_tilt(rng: np.random.Generator) -> None:
    case = turned(rng, "triad_diodes", np.zeros(40))
    assert any("hardly determine tilt" in sentence for sentence in case.identify().warnings)


def test_scans_before_the_home_mark_and_after_a_lost_count_are_left_out(rng: np.random.Generator) -> None:
    thetas = np.linspace(-1.0, 2.0 * np.pi - 1.0, 200)
    home = (np.abs(thetas) < 0.5 * (thetas[1] - thetas[0])).astype(np.int64)
    [marked] = np.flatnonzero(home)
    case = turned(rng, "triad_bumpy_ring", thetas)
    case = case.with_scans(case.recording.scans.with_fields({"at_home": home}))
    contradictory = case.with_readings("ring_voltages", lambda volts: -volts, np.s_[[167], :])
    for each, left_out in ((case, marked), (contradictory, marked + 33)):
        outcome = each.identify()
        assert np.abs(normalised_errors(each, outcome)).max() < 4.0
        assert sum(f"{left_out} of 200 scans are not used" in sentence for sentence in outcome.warnings) == 1
    unsolved = case.with_readings("ring_voltages", np.nan, np.s_[[marked - 9], :])
    marks = home.copy()
    marks[marked - 9] = 1  # counts nothing: there is no pose
    outcome = unsolved.with_scans(unsolved.recording.scans.with_fields({"at_home": marks})).identify()
    assert np.abs(normalised_errors(case, outcome)).max() < 4.0


def test_a_ring_without_home_mark_and_one_with_a_spurious_mark_are_refused(rng: np.random.Generator) -> None:
    thetas = np.linspace(-1.0, 2.0 * np.pi - 1.0, 300)
    home = (np.abs(thetas) < 0.5 * (thetas[1] - thetas[0])).astype(np.int64)
    case = turned(rng, "triad_bumpy_ring", thetas)
    case.check_refusal(FitError, "no scan with a pose saw the home mark")
    home[20] = 1
    spurious = case.with_scans(case.recording.scans.with_fields({"at_home": home}))
    spurious.check_refusal(FitError, f"the count of bumps is in doubt at scan {np.flatnonzero(home)[1]}")


def test_the_vertical_test_of_1985_separates_the_two_flatness_constants(rig_calibrations: dict[str, Path]) -> None:
    # ZMO turns the target by 5.8 mrad. Its probes speak for f = .0083333 in, not for the .083333 in of the listings.
    tilts = {}
    for name in ("printed", "section84"):
        calibration = load_calibration(rig_calibrations[name])
        options = PROCEDURE.options(lever=LEVER, session="zmo", wobble_sigma=17e-6, expected_tilt=0.05)
        fit = PROCEDURE.identify(recorded("zmo"), calibration, options).fits["target_plane"]
        tilts[name] = calibration.model_dump()["sensors"][0]["target_plane"]["tilt"]["value"][1]
        assert fit.sigmas[1] < 3e-3
        assert abs(fit.values[1] - tilts["printed"]) < 3.0 * fit.sigmas[1]
    assert abs(fit.values[1] - tilts["section84"]) > 10.0 * fit.sigmas[1]
