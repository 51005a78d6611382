from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.polynomial import polynomial
from posor_estimator.core.calibrate.gap_linearisation import PROCEDURE, GapLinearisationOptions, run
from posor_estimator.core.calibrate.gap_polynomial import aicc
from posor_estimator.core.calibrate.recording import SATURATED, Recording
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.designs import STANDOFF
from posor_estimator.errors import FitError, TrackError
from posor_estimator.testing.campaign import held, lifted, posor, recording
from scipy.stats import binomtest

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.types import FloatArray

DATA = Path(__file__).resolve().parents[5] / "data" / "slocum1985"
LIFTS = STANDOFF + np.linspace(-0.45e-3, 0.45e-3, 31)
TRUE = [0.000735, -0.000118, 1.5e-06, -2e-07, 1e-08]
"""Of all probes of the design, and exact within the model: order 4."""
SIGMA = 50e-9


def linearised(taken: Recording, **options: Any) -> Outcome:
    return run(taken, posor(), GapLinearisationOptions(**options))


def taken(seed: int = 0, **changes: Any) -> Recording:
    return lifted(posor(), LIFTS, np.random.default_rng(seed), **({"sigma": SIGMA, "scans_each": 12} | changes))


def with_reference(before: Recording, change: Any) -> Recording:
    track = before.tracks["/reference"]
    values = change(track.values.copy())
    return replace(before, tracks={"/reference": replace(track, values=values, sigmas=np.full(values.shape[1], SIGMA))})


def coefficients(outcome: Outcome, probe: int) -> tuple[FloatArray, FloatArray]:
    new = next(new for new in outcome.replacements if new.key == f"sensors[0].probes[{probe}].volts_to_gap")
    return np.array(new.value), np.array(new.sigma)


def test_polynomials_are_recovered_and_keep_the_zero() -> None:
    outcome = linearised(taken(), order=4)
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert found[0] == TRUE[0]
        assert np.all(np.abs(found - TRUE)[1:] < 4.0 * sigmas[1:])
        assert np.all(sigmas[1:] < [2e-8, 1e-8, 3e-9, 1e-9])
    assert [fit.probability > 1e-3 for fit in outcome.fits.values()] == [True] * 3


def test_truth_lies_in_the_95_percent_intervals_of_95_percent_of_campaigns() -> None:
    inside = trials = 0
    for seed in range(20):
        outcome = linearised(taken(seed, scans_each=4), order=4, highest_order=4, least=0.05, settle=0.0)
        for probe in range(3):
            found, sigmas = coefficients(outcome, probe)
            inside += int(np.sum(np.abs(found - TRUE)[1:] < 1.96 * sigmas[1:]))
            trials += 4
    # The four coefficients of a fit vary together: count a fit as one trial.
    assert binomtest(round(inside / 4), trials // 4, 0.95).pvalue > 0.01


def test_curve_of_the_order_that_cross_validation_chose_is_as_good_as_stated() -> None:
    inside = trials = 0
    orders = []
    for seed in range(20):
        outcome = linearised(taken(seed, scans_each=4), least=0.05, settle=0.0, highest_order=7)
        for probe, joint in enumerate(outcome.covariances):
            found, _ = coefficients(outcome, probe)
            orders.append(len(found) - 1)
            span = np.array(next(n.value for n in outcome.replacements if n.key.endswith(f"[{probe}].range")))
            volts = np.linspace(span[0], span[1], 9)
            powers = volts[:, None] ** np.arange(len(found))
            # The zero is kept as it was: its uncertainty is the old one's, and here it is the truth.
            covariance = joint.matrix.copy()
            covariance[0, 0] -= 1.3e-7**2
            sigmas = np.sqrt(np.einsum("ni,ij,nj->n", powers, covariance, powers))
            off = np.abs(polynomial.polyval(volts, found) - polynomial.polyval(volts, np.array(TRUE)))
            inside += int(np.sum(off <= 1.96 * sigmas + 1e-12))
            trials += len(volts)
    assert inside / trials > 0.9
    assert min(orders) == 4
    assert orders.count(4) > 0.85 * len(orders)


@pytest.mark.parametrize("criterion", ["cross_validation", "aicc"])
def test_table_shows_residuals_against_order(criterion: str) -> None:
    outcome = linearised(taken(), criterion=criterion)
    table = outcome.tables[0]
    assert table.columns == ("probe", *(f"order {k}" for k in range(1, 10)), "chosen order")
    assert table.units[1] == "µm"
    for row in table.rows:
        residuals = np.array(row[1:10], dtype=float)
        assert np.all(residuals[:3] > 3.0 * residuals[3])  # orders 1 to 3 do not do
        np.testing.assert_allclose(residuals[3:], residuals[3], rtol=0.2)  # and nothing is gained beyond 4
        assert row[-1] in ({4} if criterion == "cross_validation" else {4, 5, 6})
    checked = np.array(outcome.tables[1].rows[0][1:10], dtype=float)
    assert np.all(checked > np.array(table.rows[0][1:10], dtype=float))


def test_table_compares_the_curves_uncertainty_with_that_of_independent_coefficients() -> None:
    outcome = linearised(taken(), order=6)
    table = next(table for table in outcome.tables if table.title == "standard uncertainty of the curves")
    assert len(table.rows) == 9
    for row in table.rows:
        jointly, alone = float(row[2]), float(row[3])
        assert 0.12 < jointly < 0.2  # of which the zero that was kept is 0.13 um
        assert alone > 0.99 * jointly
    assert max(float(row[3]) / float(row[2]) for row in table.rows) > 2.0
    # The estimator counts the covariance that the file states, so there is nothing to warn of.
    assert not any("vary together" in warning for warning in outcome.warnings)


def test_noise_and_range_come_from_the_stops() -> None:
    outcome = linearised(taken(scans_each=25))
    new = {one.key: one for one in outcome.replacements}
    noise = new["sensors[0].probes[1].noise"]
    assert abs(noise.value - 1e-3) < 4.0 * noise.sigma < 1.5e-4  # type: ignore[operator]
    low, high = new["sensors[0].probes[1].range"].value  # type: ignore[misc]
    assert -6.0 < low < -3.0 < 3.0 < high < 6.0  # type: ignore[operator]
    assert "gap probe gap_1: the stops span" in outcome.warnings[0]
    assert not any(one.key.endswith("noise") for one in linearised(taken(), update_noise=False).replacements)


def test_zero_of_the_reference_is_taken_when_asked_for() -> None:
    outcome = linearised(with_reference(taken(), lambda values: values + 1e-4), zero="reference", order=4)
    found, sigmas = coefficients(outcome, 1)
    # The plane leans by 0.8 mrad about X: at 38.1 mm that is 30.5 um.
    assert abs(found[0] - TRUE[0] - 1e-4) < 35e-6
    assert sigmas[0] < 3e-8


def test_scale_of_the_reference_counts_for_all_stops_alike() -> None:
    sharp, vague = (coefficients(linearised(taken(), order=4, scale_sigma=s), 0)[1] for s in (0.0, 1e-3))
    np.testing.assert_allclose(np.sqrt(vague[1] ** 2 - sharp[1] ** 2), 1e-3 * 118e-6, rtol=1e-3)
    assert vague[0] == sharp[0]


def test_point_along_an_axis_and_pose_serve_as_references() -> None:
    plain = coefficients(linearised(taken(), order=4), 0)[0]
    point = with_reference(taken(), lambda values: np.hstack([np.zeros((len(values), 1)), -values, 0.0 * values]))
    found = coefficients(linearised(point, kind="point", axis="y", direction=-1, order=4), 0)[0]
    np.testing.assert_allclose(found, plain, rtol=1e-9)
    still = [0.0, 0.0, 0.0, 1.0]
    pose = with_reference(
        taken(), lambda values: np.hstack([np.zeros((len(values), 2)), values, np.tile(still, (len(values), 1))])
    )
    found = coefficients(linearised(pose, kind="pose", zero="reference", order=4), 0)[0]
    np.testing.assert_allclose(found[0], TRUE[0], atol=5e-8)
    np.testing.assert_allclose(found[1:], plain[1:], rtol=1e-3)


def test_outliers_of_five_percent_are_named_and_survived() -> None:
    clean = linearised(taken(sigma=0.0, scans_each=20), order=4)
    rng = np.random.default_rng(7)
    path = held(LIFTS[:, None], 20)
    shown = path.copy()
    shown[25 * 4 : 25 * 4 + 20] += 3e-6
    shown[25 * 20 : 25 * 20 + 20] -= 200e-6
    moved = np.column_stack([np.zeros((len(path), 2)), path])
    spoilt = recording(posor(), np.tile(np.eye(3), (len(path), 1, 1)), moved, shown, rng)
    outcome = linearised(spoilt, order=4)
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert np.all(np.abs(found - coefficients(clean, probe)[0])[1:] < 5.0 * sigmas[1:])
        assert f"gap probe gap_{probe + 1}: left out stop 5, stop 21, which do not fit the others." in outcome.warnings


def test_many_outliers_are_refused() -> None:
    def spoil(values: FloatArray) -> FloatArray:
        for stop in range(0, 31, 6):
            values[17 * stop : 17 * stop + 12] += 50e-6 * (1 + stop % 4)
        return values

    with pytest.raises(FitError, match=r"^gap probe gap_1: \d of 31 readings do not fit, such as stop \d+; expected"):
        linearised(with_reference(taken(), spoil))


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [
        (
            25.4,
            r"moves 25.\d+ times as far as the present calibration says, as if it was converted from inches but",
        ),
        (1 / 0.0254, r"moves 39.\d+ times as far as the present calibration says, as if it is in inches;"),
        (1e3, "as if it is in millimetres; expected values in metres"),
        (-1.0, "falls where the readings rise"),
    ],
)
def test_reference_in_the_wrong_unit_or_sign_is_named(factor: float, sentence: str) -> None:
    with pytest.raises(TrackError, match=sentence):
        linearised(with_reference(taken(), lambda values: factor * values), still=1e-6 * abs(factor))


def test_probe_without_a_calibration_takes_what_the_reference_says() -> None:
    doubled = with_reference(taken(), lambda values: 3.0 * values)
    found, _ = coefficients(linearised(doubled, uncalibrated=True, order=4, still=3e-6), 0)
    np.testing.assert_allclose(found[1], 3.0 * TRUE[1], rtol=1e-2)


def test_swapped_axes_are_named() -> None:
    point = with_reference(taken(), lambda values: np.hstack([0.0 * values, values, 1e-3 * values]))
    point = with_reference(point, lambda values: values * [1.0, 1.0, 0.0])
    with pytest.raises(TrackError, match="axis y moves with the readings, axis z does not; the axes look swapped"):
        linearised(point, kind="point", axis="z")


def test_stuck_channel_is_named() -> None:
    before = taken()
    volts = before.scans.gap_voltages.copy()
    volts[:, 1] = 0.3
    with pytest.raises(FitError, match=r"gap probe gap_2 stays at 0\.3 while the reference moves"):
        linearised(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})))
    volts = before.scans.gap_voltages.copy()
    volts[len(volts) // 2 :, 2] = 0.7
    with pytest.raises(FitError, match=r"gap probe gap_3 is stuck at 0\.7 from stop \d+ on"):
        linearised(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})))


def test_too_few_stops_are_refused() -> None:
    few = lifted(posor(), LIFTS[::8], np.random.default_rng(0), sigma=SIGMA)
    with pytest.raises(FitError, match="4 stops of the reference with scans; expected at least 6"):
        linearised(few)


def test_scans_that_were_saturated_do_not_count() -> None:
    before = taken()
    volts = before.scans.gap_voltages.copy()
    statuses = np.zeros(len(volts), dtype=np.int64)
    statuses[::3] = SATURATED
    volts[::3] = 10.0
    spoilt = replace(before, scans=before.scans.with_fields({"gap_voltages": volts}), statuses=statuses)
    found, sigmas = coefficients(linearised(spoilt, order=4), 0)
    assert np.all(np.abs(found - TRUE)[1:] < 4.0 * sigmas[1:])


def test_every_option_says_what_it_is() -> None:
    assert PROCEDURE.name == "gap_linearisation"
    assert all(field.description for field in PROCEDURE.options.model_fields.values())


def test_coefficients_of_1985_come_back_from_readings_of_1985(rig_calibrations: dict[str, Path]) -> None:
    """Table 7.10, with the scatter of table 7.12: 7, 21 and 25 microinches."""
    rig = load_calibration(rig_calibrations["printed"])
    with (DATA / "probe_linearization.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    printed = np.array([[float(row[f"A{k}_in{u}"]) for k, u in enumerate(_UNITS)] for row in rows]) * 0.0254
    heights = np.linspace(-0.012, 0.012, 41) * 0.0254
    rng = np.random.default_rng(1985)
    path = held(heights[:, None], 15)
    moved = np.column_stack([np.zeros((len(path), 2)), path])
    simulated = recording(rig, np.tile(np.eye(3), (len(path), 1, 1)), moved, path, rng, reference_sigma=25e-9)
    seen = np.asarray(np.isfinite(simulated.scans.gap_voltages).all(axis=1))
    simulated = replace(simulated, scans=simulated.scans.chosen(seen))
    outcome = run(simulated, rig, GapLinearisationOptions(order=4))
    for probe in range(3):
        found, sigmas = coefficients(outcome, probe)
        assert np.all(np.abs(found - printed[probe])[1:] < 4.0 * sigmas[1:])


_UNITS = ("", "_per_V", "_per_V2", "_per_V3", "_per_V4")


def residuals_of_1985() -> dict[tuple[str, str], FloatArray]:
    with (DATA / "linearization_residuals_tables_7_3_to_7_5.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    return {(row[0], row[1]): np.array(row[2:], dtype=float) for row in rows[1:]}


def test_tables_of_1985_are_standard_deviations_with_the_freedoms_left_of_15_stops() -> None:
    """Squares never grow with the order: n - p of n stops bounds how the printed deviations may rise."""
    printed = residuals_of_1985()
    assert len(printed) == 45
    rises = np.array([row[1:] / row[:-1] for row in printed.values()])
    left = 15 - np.arange(4, 10)  # freedoms of order 3 to 8
    limits = np.sqrt(left / (left - 1.0))
    within = rises <= limits * 1.008  # printed to whole microinches, the least 53
    assert np.all(within)
    # Where an order gains nothing, the deviation rises just so much: with 14 stops it could not, with 17 it would more.
    for step in (0, 3, 4, 5):
        assert abs(rises[:, step].max() / limits[step] - 1.0) < 0.005


def test_criterion_finds_the_order_of_1985s_curves_lower_than_nine() -> None:
    """The thesis took order 9 for its least mean deviation (table 7.7); 15 stops tell no more than 5 to 8."""
    orders = np.arange(3, 10)
    chosen = []
    for deviations in residuals_of_1985().values():
        squares = deviations**2 * (15 - orders - 1) / 15
        criteria = [aicc(float(square), 15, int(order)) for square, order in zip(squares, orders, strict=True)]
        chosen.append(int(orders[np.argmin(criteria)]))
    assert set(chosen) == {5, 6, 7, 8}
    assert np.median(chosen) == 6
