# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Linearisation of gap probes: simulated truth, wrong references, and the curves and tables of 1985."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import polynomial
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import STANDOFF
from posor.errors import TrackError
from posor.model.scan import SATURATED
from posor.numerics.array_types import FloatArray
from posor_calibration.gap_polynomial import akaike_criterion
from posor_calibration.procedure import Outcome
from posor_calibration.procedures.gap_linearisation import PROCEDURE
from posor_lab.harness.simulated_recordings import diode_calibration, dwell_path, lifted_recording, simulated_recording
from scipy.stats import binomtest

from .simulated_case import SimulatedCase

DATA = Path(__file__).resolve().parents[5] / "data" / "slocum1985"
LIFTS = STANDOFF + np.linspace(-0.45e-3, 0.45e-3, 31)
TRUE = np.array([0.000735, -0.000118, 1.5e-06, -2e-07, 1e-08])
"""Of all probes of the design, and exact within the model: order 4."""
SIGMA = 50e-9


def simulate(seed: int = 0, **changes: Any) -> SimulatedCase:
    options = {"sigma": SIGMA, "scans_each": 12} | changes
    recording = lifted_recording(diode_calibration(), LIFTS, np.random.default_rng(seed), **options)
    return SimulatedCase(PROCEDURE, diode_calibration(), recording)


def with_columns(case: SimulatedCase, change: Any) -> SimulatedCase:
    """Return the case with a reference of other values, all with the same uncertainty."""
    values = change(case.reference.values.copy())
    return case.with_reference(values=values, sigmas=np.full(values.shape[1], SIGMA))


def coefficients(outcome: Outcome, probe: int) -> tuple[FloatArray, FloatArray]:
    new = next(new for new in outcome.replacements if new.key == f"sensors[0].probes[{probe}].volts_to_gap")
    return np.array(new.value), np.array(new.sigma)


def test_polynomials_are_recovered_and_keep_the_zero() -> None:
    outcome = simulate().identify(order=4)
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert found[0] == TRUE[0]
        assert np.all(np.abs(found - TRUE)[1:] < 4.0 * sigmas[1:])
        assert np.all(sigmas[1:] < [2e-8, 1e-8, 3e-9, 1e-9])
    assert all(fit.probability > 1e-3 for fit in outcome.fits.values())


@pytest.mark.long
def test_95_percent_intervals_cover_the_truth() -> None:
    inside = trials = 0
    for seed in range(20):
        case = simulate(seed, scans_each=4)
        outcome = case.identify(order=4, highest_order=4, least_dwell=0.05, settle=0.0)
        for probe in range(3):
            found, sigmas = coefficients(outcome, probe)
            inside += int(np.sum(np.abs(found - TRUE)[1:] < 1.96 * sigmas[1:]))
            trials += 4
    # The four coefficients of a fit are correlated: count a fit as one trial.
    assert binomtest(round(inside / 4), trials // 4, 0.95).pvalue > 0.01


@pytest.mark.long
def test_the_curve_of_the_selected_order_is_as_good_as_stated() -> None:
    inside = trials = 0
    orders = []
    for seed in range(20):
        outcome = simulate(seed, scans_each=4).identify(least_dwell=0.05, settle=0.0, highest_order=7)
        for probe, joint in enumerate(outcome.covariances):
            found, _ = coefficients(outcome, probe)
            orders.append(len(found) - 1)
            span = np.array(next(n.value for n in outcome.replacements if n.key.endswith(f"[{probe}].range")))
            volts = np.linspace(span[0], span[1], 9)
            powers = volts[:, None] ** np.arange(len(found))
            # The zero is kept with its former uncertainty, and here it is true.
            covariance = joint.matrix.copy()
            covariance[0, 0] -= 1.3e-7**2
            sigmas = np.sqrt(np.einsum("ni,ij,nj->n", powers, covariance, powers))
            off = np.abs(polynomial.polyval(volts, found) - polynomial.polyval(volts, TRUE))
            inside += int(np.sum(off <= 1.96 * sigmas + 1e-12))
            trials += len(volts)
    assert inside / trials > 0.9
    assert min(orders) == 4
    assert orders.count(4) > 0.85 * len(orders)


@pytest.mark.parametrize(("criterion", "orders"), [("cross_validation", {4}), ("aicc", {4, 5, 6})])
def test_table_shows_residuals_against_order(criterion: str, orders: set[int]) -> None:
    outcome = simulate().identify(criterion=criterion)
    table = outcome.tables[0]
    assert table.columns == ("probe", *(f"order {k}" for k in range(1, 10)), "chosen order")
    assert table.units[1] == "µm"
    for row in table.rows:
        residuals = np.array(row[1:10], dtype=float)
        assert np.all(residuals[:3] > 3.0 * residuals[3])  # orders 1 to 3 are too low
        np.testing.assert_allclose(residuals[3:], residuals[3], rtol=0.2)  # and nothing is gained beyond 4
        assert row[-1] in orders
    checked = np.array(outcome.tables[1].rows[0][1:10], dtype=float)
    assert np.all(checked > np.array(table.rows[0][1:10], dtype=float))


def test_table_compares_the_uncertainty_with_that_of_independent_coefficients() -> None:
    outcome = simulate().identify(order=6)
    table = next(table for table in outcome.tables if table.title == "standard uncertainty of the curves")
    assert len(table.rows) == 9
    for row in table.rows:
        joint, independent = float(row[2]), float(row[3])
        assert 0.12 < joint < 0.2  # of which the zero that was kept is 0.13 um
        assert independent > 0.99 * joint
    assert max(float(row[3]) / float(row[2]) for row in table.rows) > 2.0
    # The estimator uses the stated covariance, so there is nothing to warn of.
    assert not any("correlated" in warning for warning in outcome.warnings)


def test_noise_and_range_come_from_the_dwells() -> None:
    outcome = simulate(scans_each=25).identify()
    new = {replacement.key: replacement for replacement in outcome.replacements}
    noise = new["sensors[0].probes[1].noise"]
    assert abs(noise.value - 1e-3) < 4.0 * noise.sigma < 1.5e-4  # type: ignore[operator]
    low, high = new["sensors[0].probes[1].range"].value  # type: ignore[misc]
    assert -6.0 < low < -3.0 < 3.0 < high < 6.0  # type: ignore[operator]
    assert "gap probe gap_1: the dwells span" in outcome.warnings[0]
    assert not any(new.key.endswith("noise") for new in simulate().identify(update_noise=False).replacements)


def test_the_zero_of_the_reference_is_used_when_asked_for() -> None:
    outcome = simulate().with_values(lambda values: values + 1e-4).identify(zero="reference", order=4)
    found, sigmas = coefficients(outcome, 1)
    # The plane leans by 0.8 mrad about X: at 38.1 mm that is 30.5 um.
    assert abs(found[0] - TRUE[0] - 1e-4) < 35e-6
    assert sigmas[0] < 3e-8


def test_the_scale_of_the_reference_is_common_to_all_dwells() -> None:
    sharp, vague = (coefficients(simulate().identify(order=4, scale_sigma=s), 0)[1] for s in (0.0, 1e-3))
    np.testing.assert_allclose(np.sqrt(vague[1] ** 2 - sharp[1] ** 2), 1e-3 * 118e-6, rtol=1e-3)
    assert vague[0] == sharp[0]


def test_a_point_along_an_axis_and_a_pose_serve_as_references() -> None:
    plain = coefficients(simulate().identify(order=4), 0)[0]
    point = with_columns(simulate(), lambda values: np.hstack([0.0 * values, -values, 0.0 * values]))
    found = coefficients(point.identify(kind="point", axis="y", direction=-1, order=4), 0)[0]
    np.testing.assert_allclose(found, plain, rtol=1e-9)
    pose = with_columns(simulate(), lambda values: values * [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0] + np.eye(7)[6])
    found = coefficients(pose.identify(kind="pose", zero="reference", order=4), 0)[0]
    np.testing.assert_allclose(found[0], TRUE[0], atol=5e-8)
    np.testing.assert_allclose(found[1:], plain[1:], rtol=1e-3)


def test_a_probe_without_a_calibration_follows_the_reference() -> None:
    tripled = simulate().with_values(lambda values: 3.0 * values)
    found, _ = coefficients(tripled.identify(uncalibrated=True, order=4, still=3e-6), 0)
    np.testing.assert_allclose(found[1], 3.0 * TRUE[1], rtol=1e-2)


@pytest.mark.long
def test_five_percent_of_outliers_are_named_and_survived() -> None:
    clean = simulate(sigma=0.0, scans_each=20).identify(order=4)
    path = dwell_path(LIFTS[:, None], 20)
    shown = path.copy()
    shown[25 * 4 : 25 * 4 + 20] += 3e-6
    shown[25 * 20 : 25 * 20 + 20] -= 200e-6
    moved, level = np.column_stack([np.zeros((len(path), 2)), path]), np.tile(np.eye(3), (len(path), 1, 1))
    spoilt = simulated_recording(diode_calibration(), level, moved, shown, np.random.default_rng(7))
    outcome = SimulatedCase(PROCEDURE, diode_calibration(), spoilt).identify(order=4)
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert np.all(np.abs(found - coefficients(clean, probe)[0])[1:] < 5.0 * sigmas[1:])
        sentence = f"gap probe gap_{probe + 1}: left out dwell 5, dwell 21, which do not fit the others."
        assert sentence in outcome.warnings


def test_swapped_axes_are_named() -> None:
    point = with_columns(simulate(), lambda values: np.hstack([0.0 * values, values, 0.0 * values]))
    sentence = "axis y moves with the readings, axis z does not; the axes look swapped"
    point.check_refusal(TrackError, sentence, kind="point", axis="z")


def test_saturated_scans_are_not_used() -> None:
    case = simulate().with_readings("gap_voltages", 10.0, np.s_[::3])
    statuses = np.zeros(len(case.recording.scans), dtype=np.int64)
    statuses[::3] = SATURATED
    found, sigmas = coefficients(case.with_recording(statuses=statuses).identify(order=4), 0)
    assert np.all(np.abs(found - TRUE)[1:] < 4.0 * sigmas[1:])


def read_table(name: str) -> list[list[str]]:
    with (DATA / name).open(encoding="utf-8") as file:
        return list(csv.reader(line for line in file if not line.startswith("#")))[1:]


def test_coefficients_of_1985_are_recovered(rig_calibrations: dict[str, Path]) -> None:
    """Table 7.10, with the scatter of table 7.12: 7, 21 and 25 microinches."""
    rig = load_calibration(rig_calibrations["printed"])
    with (DATA / "probe_linearization.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    units = ("", "_per_V", "_per_V2", "_per_V3", "_per_V4")
    printed = np.array([[float(row[f"A{k}_in{unit}"]) for k, unit in enumerate(units)] for row in rows]) * 0.0254
    path = dwell_path(np.linspace(-0.012, 0.012, 41)[:, None] * 0.0254, 15)
    moved, level = np.column_stack([np.zeros((len(path), 2)), path]), np.tile(np.eye(3), (len(path), 1, 1))
    recording = simulated_recording(rig, level, moved, path, np.random.default_rng(1985), reference_sigma=25e-9)
    seen = np.asarray(np.isfinite(recording.scans.gap_voltages).all(axis=1))
    outcome = SimulatedCase(PROCEDURE, rig, recording).with_scans(recording.scans.select(seen)).identify(order=4)
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert np.all(np.abs(found - printed[probe])[1:] < 4.0 * sigmas[1:])


def residuals_of_1985() -> FloatArray:
    return np.array([row[2:] for row in read_table("linearization_residuals_tables_7_3_to_7_5.csv")], dtype=float)


def test_tables_of_1985_are_standard_deviations_with_the_freedoms_left_of_15_dwells() -> None:
    """Squares never grow with the order: n - p of n dwells bounds how the printed deviations may rise."""
    printed = residuals_of_1985()
    assert len(printed) == 45
    rises = printed[:, 1:] / printed[:, :-1]
    left = 15 - np.arange(4, 10)  # freedoms of order 3 to 8
    limits = np.sqrt(left / (left - 1.0))
    assert np.all(rises <= limits * 1.008)  # printed to whole microinches, the least 53
    # Where an order gains nothing, the deviation rises just so much; it could not with 14 dwells.
    for step in (0, 3, 4, 5):
        assert abs(rises[:, step].max() / limits[step] - 1.0) < 0.005


def test_the_criterion_selects_orders_below_nine_for_the_curves_of_1985() -> None:
    """The thesis used order 9 for its least mean deviation (table 7.7); 15 dwells determine no more than 5 to 8."""
    orders = np.arange(3, 10)
    selected = []
    for deviations in residuals_of_1985():
        squares = deviations**2 * (15 - orders - 1) / 15
        pairs = zip(squares.tolist(), orders.tolist(), strict=True)
        criteria = [akaike_criterion(square, 15, order) for square, order in pairs]
        selected.append(int(orders[np.argmin(criteria)]))
    assert set(selected) == {5, 6, 7, 8}
    assert np.median(selected) == 6
