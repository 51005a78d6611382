# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Least squares: estimates, their covariance, and the refusal of unusable data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from posor.errors import FitError
from posor.numerics.array_types import FloatArray
from posor_calibration.least_squares import Fit, fit_linear, fit_parameters, weak_directions
from posor_calibration.pose_advice import information_gains
from scipy.stats import chi2

TRUTH = np.array([2.0, -0.5, 3e-3])
NAMES, UNITS = ("offset", "slope", "bend"), ("m", "m/V", "m/V^2")
SCALES = np.array([1.0, 1.0, 1e-2])
AT = np.linspace(-3.0, 3.0, 40)
DESIGN = np.column_stack([np.ones_like(AT), AT, AT**2])
SIGMA = 0.02
SIGMAS = np.full(len(AT), SIGMA)
START = np.zeros(3)


def line(readings: FloatArray, *, start: FloatArray = START, scales: FloatArray = SCALES, **options: Any) -> Fit:
    return fit_parameters(lambda p: (DESIGN @ p - readings) / SIGMA, start, NAMES, UNITS, scales, **options)


def noisy(seed: int, sigma: float = SIGMA) -> FloatArray:
    return np.asarray(DESIGN @ TRUTH + np.random.default_rng(seed).normal(scale=sigma, size=len(AT)))


def test_a_linear_fit_is_the_textbook_one() -> None:
    readings = noisy(1)
    found = line(readings)
    expected, squares, *_ = np.linalg.lstsq(DESIGN, readings, rcond=None)
    np.testing.assert_allclose(found.values, expected, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, SIGMA**2 * np.linalg.inv(DESIGN.T @ DESIGN), rtol=1e-6, atol=1e-14)
    assert found.freedoms == 37
    assert found.spread == pytest.approx(np.sqrt(squares[0] / SIGMA**2 / 37))
    assert found.probability == pytest.approx(float(chi2.sf(squares[0] / SIGMA**2, 37)))
    assert (found.value("slope"), found.sigma("slope")) == (found.values[1], found.sigmas[1])
    np.testing.assert_allclose(np.diag(found.correlations), 1.0)
    assert abs(found.correlations[0, 2]) > 0.5  # an offset and a bend over a symmetric span


@pytest.mark.parametrize("given", [False, True])
def test_analytic_derivatives_give_what_differences_give(given: bool) -> None:  # noqa: FBT001  a case
    def residuals(p: FloatArray) -> FloatArray:
        return np.asarray((p[0] * np.exp(p[1] * AT) - np.exp(0.3 * AT)) / 1e-3)

    def jacobian(p: FloatArray) -> FloatArray:
        e = np.exp(p[1] * AT)
        return np.column_stack([e, p[0] * AT * e]) / 1e-3

    start = np.array([0.5, 0.1])
    found = fit_parameters(residuals, start, ("a", "b"), ("m", "1/V"), np.ones(2), jacobian=jacobian if given else None)
    np.testing.assert_allclose(found.values, [1.0, 0.3], atol=1e-9)
    np.testing.assert_allclose(found.jacobian, jacobian(found.values), rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(("loss", "prior"), [("linear", False), ("linear", True), ("huber", False), ("huber", True)])
def test_stated_uncertainties_cover_the_truth(loss: Any, prior: bool) -> None:  # noqa: FBT001  a case
    runs, inside = 1000, np.zeros(3)
    random = np.random.default_rng(1985)
    for _ in range(runs):
        known = TRUTH + SCALES * 1e-2 * random.normal(size=3)
        readings = DESIGN @ TRUTH + random.normal(scale=SIGMA, size=len(AT))
        found = line(readings, start=known, scales=SCALES * 1e-2, loss=loss, prior=prior)
        inside += np.abs(found.values - TRUTH) < 1.96 * found.sigmas
    np.testing.assert_allclose(inside / runs, 0.95, atol=0.03)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_prior_knowledge_counts_once(correlation: float) -> None:
    readings, known = noisy(2), np.array([2.01, -0.48, 2e-3])
    sigmas = np.array([5e-3, 2e-3, 1e-4])
    mixed = np.array([[1.0, correlation, 0.0], [correlation, 1.0, 0.0], [0.0, 0.0, 1.0]])
    weight = np.linalg.inv(np.outer(sigmas, sigmas) * mixed)
    prior = np.linalg.inv(weight) if correlation else True
    found = fit_linear(DESIGN, readings, SIGMAS, known, NAMES, UNITS, sigmas, prior=prior)
    information = DESIGN.T @ DESIGN / SIGMA**2 + weight
    expected = np.linalg.solve(information, DESIGN.T @ readings / SIGMA**2 + weight @ known)
    np.testing.assert_allclose(found.values, expected, rtol=1e-8)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-6, atol=1e-14)
    assert (len(found.residuals), found.freedoms) == (40, 40)
    squares = np.sum(found.residuals**2) + (found.values - known) @ weight @ (found.values - known)
    assert found.spread == pytest.approx(np.sqrt(squares / 40))


def test_without_trust_the_uncertainty_follows_the_residuals() -> None:
    readings = noisy(3, sigma=3.0 * SIGMA)
    trusting, doubting = line(readings), line(readings, trust_sigmas=False)
    assert trusting.spread == pytest.approx(3.0, rel=0.4)
    assert trusting.probability < 1e-6
    np.testing.assert_allclose(doubting.sigmas, trusting.sigmas * trusting.spread, rtol=1e-6)


@pytest.mark.parametrize(("loss", "limit"), [("huber", 1.0), ("soft_l1", 1.0), ("cauchy", 0.5)])
def test_a_robust_fit_survives_and_names_five_percent_of_outliers(loss: Any, limit: float) -> None:
    readings = noisy(4)
    wrong = [7, 31]
    readings[wrong] += [50.0 * SIGMA, -80.0 * SIGMA]
    plain, robust = line(readings), line(readings, loss=loss)
    sound = line(noisy(4))
    assert np.max(np.abs(plain.values - sound.values) / sound.sigmas) > 3.0
    assert np.max(np.abs(robust.values - sound.values) / sound.sigmas) < limit
    assert np.flatnonzero(robust.outliers()).tolist() == wrong
    assert np.all(robust.weights[wrong] < 0.1)


def test_parameters_that_the_readings_do_not_determine_are_named() -> None:
    twice = np.column_stack([DESIGN, DESIGN[:, 1]])
    names = (*NAMES, "second slope")
    with pytest.raises(
        FitError, match=r"^bench: the readings do not separate (slope and second slope|second slope and slope); "
    ):
        fit_parameters(lambda p: twice @ p / SIGMA, np.zeros(4), names, ("m",) * 4, np.ones(4), what="bench")
    blind = DESIGN * [1.0, 0.0, 1.0]
    with pytest.raises(FitError, match=r"^the fit: the readings do not depend on slope; "):
        fit_parameters(lambda p: blind @ p / SIGMA, np.zeros(3), NAMES, UNITS, SCALES)
    # With a prior the fit succeeds, and leaves the parameter as it was.
    found = fit_parameters(lambda p: blind @ p / SIGMA, np.zeros(3), NAMES, UNITS, SCALES, prior=True)
    assert found.sigma("slope") == pytest.approx(1.0)


def test_too_few_or_no_readings_and_no_start_are_refused() -> None:
    with pytest.raises(FitError, match=r"^the fit: 2 readings for 3 parameters; expected at least as many readings\.$"):
        fit_parameters(lambda p: p[:2], np.zeros(3), NAMES, UNITS, SCALES)
    with pytest.raises(FitError, match=r"^the fit: 0 readings for 3 parameters"):
        fit_parameters(lambda p: p[:0], np.zeros(3), NAMES, UNITS, SCALES, prior=True)
    with pytest.raises(FitError, match=r"^the fit: there is no parameter to fit; expected at least one\.$"):
        fit_parameters(lambda p: p, np.zeros(0), (), (), np.zeros(0))
    with pytest.raises(FitError, match=r"expected finite residuals at the start\.$"):
        fit_parameters(lambda p: p * np.nan, np.zeros(3), NAMES, UNITS, SCALES)
    with pytest.raises(FitError, match=r"^the fit: the prior is no covariance; expected a positive definite matrix\.$"):
        fit_parameters(lambda p: p, np.zeros(3), NAMES, UNITS, SCALES, prior=-np.eye(3))


def test_weak_directions_are_named_and_candidate_poses_ranked() -> None:
    # Two parameters that nearly always come as their sum, and a third that is known well.
    jacobian = np.array([[100.0, 100.0, 0.0], [100.0, 100.01, 0.0], [0.0, 0.0, 50.0]])
    [weak] = weak_directions(jacobian, ("a", "b", "c"))
    assert set(weak.names) == {"a", "b"}
    assert weak.remaining > 10.0
    np.testing.assert_allclose(np.abs(weak.shares), [0.7071, 0.7071, 0.0], atol=1e-3)
    assert weak.shares[0] * weak.shares[1] < 0.0
    candidates = np.array([[[1.0, 1.0, 0.0]], [[1.0, -1.0, 0.0]], [[1.0, 0.0, 9.0]]])
    assert np.argsort(-information_gains(weak, candidates)).tolist() == [1, 2, 0]
    assert weak_directions(jacobian[:1], ("a", "b", "c"))[0].remaining == np.inf


@pytest.mark.long
@pytest.mark.parametrize("estimated_along", [True, False])
def test_fixed_parameters_add_to_the_uncertainty(estimated_along: bool) -> None:  # noqa: FBT001  a case
    """A scale common to all readings, known to 1 %, and an offset of the second half."""
    random = np.random.default_rng(7)
    runs, inside, together = 1000, np.zeros(3), np.zeros((3, 2))
    for _ in range(runs):
        factors = random.normal(size=2)
        effects = np.column_stack([0.01 * DESIGN @ TRUTH, 3.0 * SIGMA * (np.median(AT) < AT)])
        readings = DESIGN @ TRUTH + effects @ factors + random.normal(scale=SIGMA, size=len(AT))
        fixed = effects / SIGMA
        found = line(readings, fixed_effects=fixed if estimated_along else None)
        found = found if estimated_along else found.consider(fixed)
        inside += np.abs(found.values - TRUTH) < 1.96 * found.sigmas
        together += np.outer(found.values - TRUTH, -factors) / runs
    np.testing.assert_allclose(inside / runs, 0.95, atol=0.03)
    # A fixed parameter keeps its value: its error is the factor, reversed.
    np.testing.assert_allclose(
        together / found.sigmas[:, None], found.cross_covariance / found.sigmas[:, None], atol=0.1
    )
