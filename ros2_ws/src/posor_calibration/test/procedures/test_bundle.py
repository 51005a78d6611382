# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bundle fit: recovered parameters of a simulated POSOR, their uncertainty, and unusable data."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import DesignName
from posor.calibration.fit_record import FitRecord
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor_calibration.procedures.bundle import BundleOptions, fit_bundle, solve_bundle
from posor_lab.harness.drawn_posor import DrawnPosor, pose_track
from posor_lab.harness.random_poses import STACKS, readable, readable_poses

PROBES = "sensors[0].probes[*].*"


@pytest.mark.long
@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("with_reference", [True, False])
def test_derivatives_agree_with_differences(name: DesignName, with_reference: bool) -> None:  # noqa: FBT001  a case
    campaign = DrawnPosor(name, 12, 5, turning=name == "triad_bumpy_ring")
    recording = campaign.recording() if with_reference else campaign.recording(tracks={})
    options = BundleOptions(loss="linear", mounting_m=1e-5 * with_reference, mounting_rad=1e-4 * with_reference)
    problem = solve_bundle(recording, campaign.calibration, options).problem
    at = problem.start
    analytic = problem.jacobian(at) * problem.scales
    # The basis of the projected readings may rotate or change its sign, the cost may not: compare J'r and the squares.
    gradient, squares = analytic.T @ problem.residuals(at), np.sum(np.square(problem.residuals(at)))
    for i in range(0, len(at), 7):
        shift = np.zeros(len(at))
        shift[i] = 0.05 * problem.scales[i]
        up, down = (np.sum(np.square(problem.residuals(at + sign * shift))) for sign in (1.0, -1.0))
        bend = up + down - 2.0 * squares
        assert (up - down) / 0.2 == pytest.approx(gradient[i], abs=0.01 * (abs(gradient[i]) + abs(bend) + 1e-3))


@pytest.mark.long
@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("with_reference", [True, False])
def test_drawn_parameters_are_recovered_within_their_stated_uncertainty(
    name: DesignName,
    with_reference: bool,  # noqa: FBT001  a case
) -> None:
    pulls, spreads = [], []
    # A ring of lights has several times as many parameters as the others, and takes its time.
    for seed in range(3 if name == "triad_light_ring" else 5):
        campaign = DrawnPosor(name, 40, seed, turning=name == "triad_bumpy_ring" and not with_reference)
        recording = campaign.recording() if with_reference else campaign.recording(tracks={})
        solved = solve_bundle(recording, campaign.calibration, BundleOptions(loss="linear"))
        pulls.append(campaign.pulls(solved.fit))
        spreads.append(solved.fit.spread)
    # Parameters of one campaign are correlated, so the band is wider than for as many independent ones.
    assert np.mean(np.abs(np.concatenate(pulls)) < 1.96) == pytest.approx(0.95, abs=0.04)
    assert np.mean(np.square(spreads)) == pytest.approx(1.0, abs=0.1 if with_reference else 0.35)
    if with_reference:
        remaining = solved.fit.sigmas / solved.problem.scales
        assert np.count_nonzero(remaining < 0.5) > 10


def test_values_that_a_stage_at_rest_repeats_count_once() -> None:
    campaign = DrawnPosor("triad_diodes", 30, 3)
    single, each = campaign.recording(), np.repeat(np.arange(len(campaign.poses)), 5)
    scans = campaign.scans.select(each)
    scans = scans.with_fields({"stamps_ns": np.arange(1, len(each) + 1, dtype=np.int64) * 10_000_000})
    track = pose_track([campaign.measured[n] for n in each], scans.stamps_ns)
    repeated = replace(single, scans=scans, tracks={"/reference": track})
    options = BundleOptions(loss="linear")
    found, expected = (solve_bundle(case, campaign.calibration, options) for case in (repeated, single))
    assert len(found.data) == len(expected.data)
    assert found.fit.sigmas == pytest.approx(expected.fit.sigmas, rel=1e-6)


def test_a_recording_that_the_calibration_contains_is_refused() -> None:
    campaign = DrawnPosor("triad_diodes", 30, 3)
    record = {"procedure": "gap_linearisation", "method": "", "date": "2026-01-01", "replaced": ["sensors[0]"]}
    fits = [FitRecord.model_validate({**record, "recording": {"name": "bag", "sha256": "a" * 64}})]
    calibration = campaign.calibration.model_copy(update={"fits": fits})
    fit_bundle(campaign.recording(sha256="b" * 64), calibration, BundleOptions())
    with pytest.raises(FitError, match="is already fitted to it, by gap_linearisation; expected the calibration from"):
        fit_bundle(campaign.recording(sha256="a" * 64), calibration, BundleOptions())


@pytest.mark.long
def test_unfitted_parameters_add_to_the_uncertainty() -> None:
    pulls = []
    for seed in range(20):
        campaign = DrawnPosor("triad_diodes", 40, 200 + seed)
        options = BundleOptions(loss="linear", parameters=("sensors[0].probes[*].zero_shift", "*.tilt", "*.origin"))
        pulls.append(campaign.pulls(solve_bundle(campaign.recording(), campaign.calibration, options).fit))
    assert np.mean(np.abs(np.concatenate(pulls)) < 1.96) == pytest.approx(0.95, abs=0.06)
    alone = solve_bundle(campaign.recording(), campaign.calibration, options)
    scaled = alone.fit.jacobian * alone.problem.scales
    with_others_exact = np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled + np.eye(len(alone.fit.names)))))
    growth = alone.fit.sigmas / (with_others_exact * alone.problem.scales)
    assert np.min(growth) >= 1.0 - 1e-9
    assert np.max(growth) > 2.0


def test_the_calibrated_posor_measures_new_poses_better() -> None:
    campaign = DrawnPosor("triad_diodes", 150, 11)
    solved = solve_bundle(campaign.recording(), campaign.calibration, BundleOptions())
    random = np.random.default_rng(12)
    before = Posor(campaign.calibration)
    unknowns, fitted = campaign.unknowns, dict(zip(solved.fit.names, solved.fit.values, strict=True))
    values = np.array([fitted.get(n, s) for n, s in zip(unknowns.names, unknowns.start, strict=True)])
    after = before.stack.with_parameter_values(unknowns.parameter_vector(values))
    true = before.stack.with_parameter_values(campaign.unknowns.parameter_vector(campaign.truth))
    rotations, translations = readable_poses(before, "triad_diodes", 40, random)
    scans = scans_at(true, rotations, translations, np.arange(40, dtype=np.int64))
    scans = scans.select(np.flatnonzero(readable(scans)))
    errors = []
    for stack in (before.stack, after):
        found = before.with_parameter_values(stack.parameter_values).estimate_each(scans)
        kept = found.states == 0
        off = found.translations[kept] - translations[: len(scans)][kept] if len(scans) == 40 else None
        assert off is not None
        errors.append(np.sqrt(np.mean(np.square(off))))
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.long
def test_a_misaligned_reference_frame_is_fitted_as_its_mounting() -> None:
    campaign = DrawnPosor("triad_diodes", 120, 21)
    turn, hold = pin.exp6(np.array([30e-6, -20e-6, 10e-6, 1e-4, -2e-4, 1e-4])), pin.exp6(np.full(6, 2e-5))
    askew = [turn.inverse() * pose * hold.inverse() for pose in campaign.measured]
    exact = solve_bundle(campaign.recording(askew), campaign.calibration, BundleOptions(loss="linear"))
    options = BundleOptions(loss="linear", mounting_m=5e-5, mounting_rad=2e-4)
    free = solve_bundle(campaign.recording(askew), campaign.calibration, options)
    assert free.fit.probability > 0.001
    assert free.fit.spread < exact.fit.spread or np.max(np.abs(campaign.pulls(exact.fit))) > 6.0
    assert np.mean(np.abs(campaign.pulls(free.fit)) < 1.96) > 0.85
    about = free.fit.value("mounting of the reference on the receiving plate, about z")
    assert abs(about - 1e-4) < 4.0 * free.fit.sigma("mounting of the reference on the receiving plate, about z")


@pytest.mark.long
def test_five_percent_of_outliers_are_survived_and_named() -> None:
    campaign = DrawnPosor("triad_diodes", 200, 31)
    sound = solve_bundle(campaign.recording(), campaign.calibration, BundleOptions())
    volts = campaign.scans.gap_voltages.copy()
    wrong = campaign.random.choice(volts.size, volts.size // 20, replace=False)
    volts.flat[wrong] += campaign.random.choice([-1.0, 1.0], len(wrong)) * 40e-3
    campaign.scans = campaign.scans.with_fields({"gap_voltages": volts})
    outcome = fit_bundle(campaign.recording(), campaign.calibration, BundleOptions(loss="cauchy"))
    found = outcome.fits["bundle"]
    off = np.abs(found.values - sound.fit.values) / sound.fit.sigmas
    assert np.max(off) < 2.0
    assert np.mean(np.abs(campaign.pulls(found)) < 1.96) > 0.85
    rows = np.flatnonzero(found.outliers())
    assert len(rows) >= 0.9 * len(wrong)
    said = next(warning for warning in outcome.warnings if "outliers" in warning)
    assert re.search(r"the worst of scan \d+, gap gap_[123], \d+\.\d sigmas\.", said)
    plain = solve_bundle(campaign.recording(), campaign.calibration, BundleOptions(loss="linear"))
    assert np.max(np.abs(plain.fit.values - sound.fit.values) / sound.fit.sigmas) > 3.0


def test_the_outcome_fits_the_file_and_lists_weak_combinations() -> None:
    campaign = DrawnPosor("triad_diodes", 40, 41)
    outcome = fit_bundle(campaign.recording(), campaign.calibration, BundleOptions(parameters=(PROBES,)))
    assert {new.key.rpartition(".")[2] for new in outcome.replacements} <= {"tip", "axis", "volts_to_gap", "zero_shift"}
    probe: Any = campaign.calibration.sensors[0].probes[1]  # type: ignore[attr-defined]
    for new in outcome.replacements:
        Quantity(value=new.value, sigma=new.sigma, unit="any")
        if new.key.endswith("axis"):
            assert np.linalg.norm(new.value) == pytest.approx(1.0, abs=1e-12)
        if new.key == "sensors[0].probes[1].volts_to_gap":
            assert np.shape(new.value) == probe.volts_to_gap.array.shape
    [joint] = outcome.covariances
    assert len(joint.entries) == len(joint.matrix)
    where = joint.entries.index("sensors[0].probes[1].zero_shift")
    stated = next(new.sigma for new in outcome.replacements if new.key == "sensors[0].probes[1].zero_shift")
    assert np.sqrt(joint.matrix[where, where]) == pytest.approx(stated)
    tables = {table.title: table for table in outcome.tables}
    weak = tables["weakly determined combinations"].rows
    assert len(weak) > 3
    # An offset of a gap and a shift of its voltage are nearly the same thing: neither is determined.
    named = " and ".join(str(row[0]) for row in weak)
    for n, key in product(range(3), ("volts_to_gap[0]", "zero_shift")):
        assert f"sensors[0].probes[{n}].{key}" in named
    assert all(0.0 <= float(row[1]) <= 1.0 for row in weak)


def test_new_poses_are_proposed() -> None:
    """All poses are level and at one gap: the curvature of the probes requires other gaps."""
    campaign = DrawnPosor("triad_diodes", 8, 51)
    posor = Posor(campaign.calibration)
    true = posor.stack.with_parameter_values(campaign.unknowns.parameter_vector(campaign.truth))
    rotations = np.tile(np.eye(3), (40, 1, 1))
    translations = np.tile([0.0, 0.0, 0.735e-3], (40, 1)) + campaign.random.normal(scale=2e-6, size=(40, 3))
    stamps = np.arange(1, 41, dtype=np.int64) * 10_000_000
    campaign.scans = scans_at(true, rotations, translations, stamps, noise=campaign.random)
    poses = [pin.SE3(rotations[i], translations[i]) for i in range(40)]
    options = BundleOptions(parameters=("sensors[0].probes[*].volts_to_gap", "sensors[0].probes[*].zero_shift"))
    outcome = fit_bundle(campaign.recording(poses), campaign.calibration, options)
    [advice] = [table for table in outcome.tables if table.title == "poses that would determine more"]
    assert advice.rows
    for row in advice.rows:
        assert float(row[-1]) < 0.9 * float(row[-2])
        assert abs(float(row[3]) - 0.735e-3) > 20e-6 or max(abs(float(row[4])), abs(float(row[5]))) > 3e-4


def test_scans_of_another_posor_are_refused() -> None:
    campaign = DrawnPosor("triad_diodes", 20, 64)
    campaign.scans = campaign.scans.with_fields({"gap_voltages": np.full_like(campaign.scans.gap_voltages, 9.0)})
    for tracks in ({}, {"/reference": pose_track(campaign.measured, campaign.scans.stamps_ns)}):
        with pytest.raises(FitError, match=r"^bench: no scan is left to fit"):
            solve_bundle(campaign.recording(tracks=tracks), campaign.calibration, BundleOptions())


def test_a_calibration_with_tilts_of_the_previous_scan_is_refused(rig_calibrations: dict[str, Path]) -> None:
    campaign = DrawnPosor("triad_diodes", 20, 65)
    with pytest.raises(FitError, match=r"expected tilt_angle this_scan\.$"):
        solve_bundle(campaign.recording(), load_calibration(rig_calibrations["printed"]), BundleOptions())


def test_scans_at_the_edge_of_the_range_are_left_out_and_counted() -> None:
    campaign = DrawnPosor("triad_diodes", 60, 66, drawn=0.0)
    probe: Any = campaign.calibration.sensors[0].probes[0]  # type: ignore[attr-defined]
    low = probe.range.array[0]
    volts = campaign.scans.gap_voltages.copy()
    volts[7, 0] = low - probe.zero_shift.number + 1e-7
    campaign.scans = campaign.scans.with_fields({"gap_voltages": volts})
    outcome = fit_bundle(campaign.recording(), campaign.calibration, BundleOptions(loss="cauchy"))
    assert any("1 scans are not used" in warning for warning in outcome.warnings) or any(
        "outliers" in warning for warning in outcome.warnings
    )
