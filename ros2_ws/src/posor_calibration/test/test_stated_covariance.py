# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The covariance that a calibration file states, carried to the pose by the estimator: blocks, sessions, draws."""

from __future__ import annotations

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration
from posor.calibration.designs import design
from posor.calibration.fit_record import CovarianceRecord, FitRecord, RecordedData
from posor.calibration.parameter_covariance import CovarianceSquareRoot, covariance_square_root, stated_covariance
from posor.calibration.parameter_entries import parameter_entries
from posor.calibration.quantity import Quantity
from posor.calibration.session import Session
from posor.estimation.digital_zero import find_digital_zero
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import native_jacobian
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.uncertainty.budget_poses import pose_from_native, scan_at
from posor.uncertainty.first_order import ErrorBudget, error_budget, sensitivities
from posor.uncertainty.reading_sensitivity import sensitivity_at
from posor_design.monte_carlo import BATCH, monte_carlo
from posor_lab.harness.random_poses import TICK_NS

NATIVE = np.array([1e-4, -1e-4, 0.7e-3, 2e-4, -1e-4, 0.02])
POSE = pose_from_native(NATIVE.tolist())
OF_A_PROBE = ("volts_to_gap[0]", "volts_to_gap[1]", "volts_to_gap[2]", "zero_shift", "tip[2]")
GAPS = (
    *(f"sensors[0].probes[{i}].{what}" for i in range(3) for what in OF_A_PROBE),
    "sensors[0].target_plane.tilt[0]",
    "sensors[0].target_plane.tilt[1]",
)
DIODES = tuple(
    f"sensors[1].{what}"
    for what in ("maps.factory[0].x[0][0]", "maps.factory[0].y[0][0]", "maps.factory[1].x[1][0]", "diodes[1].origin[0]")
)


def stating(calibration: Calibration, *blocks: tuple[tuple[str, ...], FloatArray]) -> Calibration:
    """Return the calibration with a fit record that states these correlations; its uncertainties stay."""
    sigmas = {e.name: float(e.quantity.sigmas[e.index]) for e in parameter_entries(calibration) if e is not None}
    for name, session in calibration.sessions.items():
        shifts = session.zero_shifts
        if shifts is not None:
            sigmas |= {f"sessions.{name}.zero_shifts[{i}]": float(sigma) for i, sigma in enumerate(shifts.sigmas)}
    records = []
    for names, correlation in blocks:
        scale = np.array([sigmas[name] for name in names])
        matrix = correlation * np.outer(scale, scale)
        records.append(
            CovarianceRecord(entries=list(names), rows=[row[: i + 1].tolist() for i, row in enumerate(matrix)])
        )
    record = FitRecord(
        procedure="by_hand",
        method="by hand",
        date="2026-01-01T00:00:00Z",
        recording=RecordedData(name="none", sha256=""),
        replaced=sorted({name for names, _ in blocks for name in names}),
        covariances=records,
    )
    return calibration.model_copy(update={"version": 2, "fits": [record]})


def random_correlation(size: int, directions: int, seed: int) -> FloatArray:
    """Return a correlation of ``size`` numbers that vary in so many directions."""
    root = np.random.default_rng(seed).normal(size=(size, directions))
    root /= np.linalg.norm(root, axis=1)[:, None]
    return np.asarray(root @ root.T)


def pushed(posor: Posor, covariance: FloatArray) -> FloatArray:
    """Return J C J' at the pose, ROS order, from the budget's derivatives."""
    scan = scan_at(posor, POSE)
    jacobian = sensitivity_at(posor, scan, POSE).gain @ posor.stack.residual_jacobian(
        scan, POSE.rotation, POSE.translation
    )
    return np.asarray(jacobian @ covariance @ jacobian.T)


def differ(one: FloatArray, other: FloatArray) -> float:
    """Return how far two covariances (6, 6) are apart, each entry against its two standard uncertainties."""
    scale = np.sqrt(np.diagonal(other))
    return float(np.max(np.abs(one - other) / np.outer(scale, scale)))


BLOCKS = {
    "one dense block": [(GAPS, random_correlation(len(GAPS), 30, 1))],
    "fewer directions than numbers": [(GAPS, random_correlation(len(GAPS), 3, 2))],
    "all of one piece": [(GAPS[:4], np.ones((4, 4)))],
    "gaps and diodes together": [(GAPS + DIODES, random_correlation(len(GAPS + DIODES), 40, 3))],
    "two blocks": [(GAPS, random_correlation(len(GAPS), 30, 4)), (DIODES, random_correlation(len(DIODES), 9, 5))],
}


@pytest.mark.parametrize("blocks", BLOCKS.values(), ids=BLOCKS)
def test_the_systematic_covariance_is_the_stated_one_pushed_through_the_derivatives(
    blocks: list[tuple[tuple[str, ...], FloatArray]],
) -> None:
    calibration = stating(design("triad_diodes"), *blocks)
    posor, stated = Posor(calibration), stated_covariance(calibration)
    assert np.abs(stated - np.diag(np.diag(stated))).max() > 0.0
    scan = scan_at(posor, POSE)
    found = posor.estimate(scan)
    expected = pushed(posor, stated)
    assert differ(found.covariance_systematic, expected) < 1e-6
    assert differ(Posor(design("triad_diodes")).estimate(scan).covariance_systematic, expected) > 1e-3
    by_motion = np.zeros((6, 6))
    by_motion[:3, :3], by_motion[3:, 3:] = np.eye(3), native_jacobian(POSE.rotation)
    budget = error_budget(posor, scan, POSE).covariance
    stated = by_motion @ (found.covariance_random + found.covariance_systematic) @ by_motion.T
    assert differ(stated, budget) < 1e-6


def test_quantities_that_vary_together_count_in_the_total_and_each_by_itself_among_the_contributions() -> None:
    both = ("sensors[0].probes[1].tip[2]", "sensors[0].probes[2].tip[2]")
    plain = budget_of(design("triad_diodes"))
    correlated = budget_of(stating(design("triad_diodes"), (both, np.ones((2, 2)))))  # both tips off by the same
    assert plain.correlated == ()
    assert correlated.correlated == ("gap_2: tip", "gap_3: tip")
    np.testing.assert_allclose(correlated.root_sum_square(), plain.root_sum_square(), rtol=1e-9)
    assert [part.name for part in correlated.contributions] == [part.name for part in plain.contributions]
    gap, alpha = 2, 3
    assert correlated.sigmas[gap] > 1.2 * plain.sigmas[gap]  # the plate looks nearer
    assert correlated.sigmas[alpha] < plain.sigmas[alpha]  # and does not seem to lean


def test_a_quantity_whose_components_cancel_contributes_what_is_left_of_them() -> None:
    both = ("sensors[0].target_plane.tilt[0]", "sensors[0].probes[1].volts_to_gap[0]", "sensors[0].probes[1].tip[2]")
    curve = tuple(f"sensors[0].probes[0].volts_to_gap[{k}]" for k in range(3))
    whole = budget_of(stating(design("triad_diodes"), (curve, random_correlation(3, 1, 8)), (both, np.ones((3, 3)))))
    assert set(whole.correlated) == {"target plane: tilt", "gap_2: linearisation", "gap_2: tip"}  # not the one of gap_1
    part = next(part for part in whole.contributions if part.name == "gap_1: linearisation")
    calibration = stating(design("triad_diodes"), (curve, random_correlation(3, 1, 8)))
    posor = Posor(calibration)
    where = [i for i, e in enumerate(parameter_entries(calibration)) if e is not None and e.name in curve]
    by = sensitivities(posor, scan_at(posor, POSE), POSE).by_parameter[:, where]
    own = stated_covariance(calibration)[np.ix_(where, where)]
    np.testing.assert_allclose(part.effects, np.sqrt(np.einsum("ki,ij,kj->k", by, own, by)), rtol=1e-6)


def budget_of(calibration: Calibration) -> ErrorBudget:
    posor = Posor(calibration)
    return error_budget(posor, scan_at(posor, POSE), POSE)


@pytest.mark.long
def test_the_budgets_draws_are_of_the_stated_covariance() -> None:
    # Large uncertainties that cancel in the gap, and others that do not.
    correlation = np.array([[1.0, -0.97, 0.9], [-0.97, 1.0, -0.97], [0.9, -0.97, 1.0]])
    curve = tuple(f"sensors[0].probes[0].volts_to_gap[{k}]" for k in range(3))
    tips = ("sensors[0].probes[1].tip[2]", "sensors[0].probes[2].tip[2]")
    posor = Posor(stating(design("triad_diodes"), (curve, correlation), (tips, np.ones((2, 2)))))
    scan = scan_at(posor, POSE)
    drawn = monte_carlo(posor, scan, POSE, seed=7, max_draws=2 * BATCH)
    np.testing.assert_allclose(drawn.sigmas, error_budget(posor, scan, POSE).sigmas, rtol=0.025)
    alone = budget_of(design("triad_diodes")).sigmas
    assert np.max(np.abs(drawn.sigmas / alone - 1.0)) > 0.2


@pytest.mark.long
def test_draws_from_the_stated_covariance_scatter_as_the_estimator_says() -> None:
    # What a linearisation leaves: large uncertainties of the coefficients that all but cancel in the gap.
    correlation = np.array([[1.0, -0.97, 0.9], [-0.97, 1.0, -0.97], [0.9, -0.97, 1.0]])
    blocks = [(tuple(f"sensors[0].probes[{i}].volts_to_gap[{k}]" for k in range(3)), correlation) for i in range(3)]
    calibration = stating(design("triad_diodes"), *blocks)
    posor, draws = Posor(calibration, false_alarm=0.0), 600
    truth = scans_at(posor.stack, POSE.rotation[None], POSE.translation[None], np.array([TICK_NS]))
    stated = posor.estimate(truth[0]).covariance_systematic
    values, random = posor.stack.parameter_values, np.random.default_rng(7)
    drawn = random.multivariate_normal(values, stated_covariance(calibration), draws, method="eigh")
    errors = np.empty((draws, 6))
    for n, real in enumerate(drawn):
        scans = scans_at(
            posor.stack.with_parameter_values(real), POSE.rotation[None], POSE.translation[None], np.array([TICK_NS])
        )
        posor.reset()
        estimate = posor.estimate(scans[0])
        assert estimate.T_R_T is not None
        errors[n] = estimate.native - NATIVE
    by_motion = np.zeros((6, 6))
    by_motion[:3, :3], by_motion[3:, 3:] = np.eye(3), native_jacobian(POSE.rotation)
    ratios = np.mean(np.square(errors), axis=0) / np.diagonal(by_motion @ stated @ by_motion.T)
    assert np.abs(ratios - 1.0).max() < 5.0 * np.sqrt(2.0 / draws)


def test_a_root_squares_to_the_covariance_and_gives_what_stands_alone_one_deviate() -> None:
    correlation = np.eye(7)
    correlation[np.ix_([1, 4, 6], [1, 4, 6])] = random_correlation(3, 2, 6)
    sigmas = np.array([1.0, 2.0, 0.0, 3.0, 4.0, 5.0, 6.0])
    root = CovarianceSquareRoot.of(sigmas, correlation)
    assert root.spans[:, 1].tolist() == [1, 2, 0, 1, 2, 1, 2]
    assert root.factor_count == 5
    np.testing.assert_allclose(
        root.dense() @ root.dense().T, correlation * np.outer(sigmas, sigmas), rtol=1e-12, atol=1e-12
    )


def test_what_a_session_replaces_has_the_sessions_correlations() -> None:
    shifts = Quantity(value=[0.01, 0.0, -0.01], sigma=[2e-3, 3e-3, 4e-3], unit="V")
    with_session = design("triad_diodes").model_copy(
        update={"sessions": {"s": Session(note="test", zero_shifts=shifts)}}
    )
    of_file = tuple(f"sensors[0].probes[{i}].zero_shift" for i in range(3))
    of_session = tuple(f"sessions.s.zero_shifts[{i}]" for i in range(3))
    high = np.full((3, 3), 0.9) + 0.1 * np.eye(3)
    for names, correlated in ((of_file, False), (of_session, True)):
        calibration = stating(with_session, (names, high))
        applied = calibration.for_session("s")
        assert (applied.session, calibration.session) == ("s", "")
        posor = Posor(applied)
        expected = pushed(posor, stated_covariance(calibration, "s"))
        found = posor.estimate(scan_at(posor, POSE)).covariance_systematic
        assert differ(found, expected) < 1e-6
        alone = pushed(posor, np.diag(np.square(posor.stack.parameter_sigmas)))
        assert (differ(found, alone) > 1e-3) == correlated


def test_a_digital_zero_is_independent_of_what_the_fits_said_of_the_shifts() -> None:
    high = np.full((3, 3), 0.9) + 0.1 * np.eye(3)
    calibration = stating(design("triad_diodes"), (tuple(f"sensors[0].probes[{i}].zero_shift" for i in range(3)), high))
    posor = Posor(calibration)
    stamps = np.arange(1, 21, dtype=np.int64) * TICK_NS
    poses = np.tile(POSE.rotation, (20, 1, 1)), np.tile(POSE.translation, (20, 1))
    scans = scans_at(posor.stack, *poses, stamps, noise=np.random.default_rng(3))
    zeroed = Posor(find_digital_zero(calibration, scans, (NATIVE[2], NATIVE[3], NATIVE[4])).calibration)
    expected = pushed(zeroed, np.diag(np.square(zeroed.stack.parameter_sigmas)))
    found = zeroed.estimate_all(Scans.of([scan_at(zeroed, POSE)])).covariances_systematic[0]
    assert differ(found, expected) < 1e-6


def test_a_file_without_fits_states_standard_uncertainties() -> None:
    calibration = design("triad_diodes")
    np.testing.assert_allclose(
        stated_covariance(calibration), np.diag(np.square(Posor(calibration).stack.parameter_sigmas)), rtol=1e-12
    )


def test_roots_square_to_the_covariance_even_where_it_has_no_breadth() -> None:
    covariance = np.diag([4.0, 0.0, 1.0])
    covariance[0, 2] = covariance[2, 0] = 2.0
    root = covariance_square_root(covariance)
    assert root.shape == (3, 1)
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-12)
