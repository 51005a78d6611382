# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Monte Carlo budget and validation of the first order."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import DesignName, design
from posor.errors import FitError, ParameterError
from posor.estimation.posor import Posor
from posor.model.scan import Scan
from posor.uncertainty.budget_poses import middle_pose, pose_from_native, scan_at
from posor.uncertainty.budget_quantities import PlatePoint
from posor.uncertainty.first_order import ErrorBudget, error_budget
from posor_design.monte_carlo import BATCH, COVERAGE_FACTOR, MonteCarlo, monte_carlo, numerical_tolerance, validate
from posor_lab.harness.random_poses import STACKS

POINTS = (PlatePoint(-0.0254, 0.0381),)
SEED = 7
GAP = 2


@pytest.mark.parametrize(
    ("sigma", "digits", "tolerance"),
    [
        (0.00035, 2, 0.000005),  # the examples of JCGM 101, 7.9.2: masses [g], a length
        (0.00035, 1, 0.00005),
        (2.0, 1, 0.5),
        (25.0, 2, 0.5),
        (0.96, 1, 0.5),  # rounds to 1.0
        (0.94, 1, 0.05),
        (99.6, 2, 5.0),
        (0.0, 1, 0.0),
    ],
)
def test_numerical_tolerance(sigma: float, digits: int, tolerance: float) -> None:
    assert numerical_tolerance(sigma, digits) == pytest.approx(tolerance)


@cache
def case(stack: DesignName) -> tuple[Posor, pin.SE3, Scan, ErrorBudget, MonteCarlo]:
    """A design in the middle of its range, its budget, and 20 000 draws."""
    posor = Posor(design(stack))
    pose = middle_pose(posor)
    scan = scan_at(posor, pose)
    budget = error_budget(posor, scan, pose, POINTS)
    return posor, pose, scan, budget, monte_carlo(posor, scan, pose, POINTS, seed=SEED, max_draws=2 * BATCH)


@pytest.mark.long
@pytest.mark.parametrize("stack", STACKS[:3])
def test_draws_agree_with_the_first_order(stack: DesignName) -> None:
    _, _, _, budget, drawn = case(stack)
    assert drawn.trials + drawn.lost == 2 * BATCH
    # 20 000 draws tell a standard deviation to half a percent.
    np.testing.assert_allclose(drawn.sigmas, budget.sigmas, rtol=0.025)
    np.testing.assert_array_less(np.abs(drawn.means - budget.values), 0.05 * budget.sigmas)
    np.testing.assert_allclose((drawn.high - drawn.low) / 2.0, COVERAGE_FACTOR * budget.sigmas, rtol=0.04)


@pytest.mark.long
def test_validation_detects_a_wrong_first_order() -> None:
    _, _, _, budget, drawn = case("triad_diodes")
    assert all(one.holds for one in validate(budget, drawn))
    too_small = replace(budget, covariance=budget.covariance / 4.0)
    assert not any(one.holds for one in validate(too_small, drawn))
    shifted = replace(budget, values=budget.values + 2.0 * budget.sigmas)
    assert not any(one.holds for one in validate(shifted, drawn))


@pytest.mark.long
def test_the_seed_fixes_the_draws_and_two_digits_need_more_of_them() -> None:
    posor, pose, scan, _, first = case("triad_diodes")
    calls: list[int] = []
    again = monte_carlo(posor, scan, pose, POINTS, seed=SEED, max_draws=2 * BATCH, digits=2, progress=calls.append)
    np.testing.assert_array_equal(first.sigmas, again.sigmas)
    assert first.stable.sum() > again.stable.sum() == 0
    assert calls == sorted(calls)
    assert 0 < calls[-1] < 2 * BATCH


@pytest.mark.long
def test_validation_fails_for_a_model_far_from_linear() -> None:
    # A cubic linearisation read where its slope nearly vanishes: noise is no longer passed on in proportion.
    content = design("triad_diodes").model_dump(mode="json")
    for probe in content["sensors"][0]["probes"]:
        probe["volts_to_gap"] = {"value": [7.35e-4, 1e-8, 0.0, 1e-4], "sigma": 0.0, "unit": "m/V^k"}
        probe["noise"]["value"] = 0.1
        probe["range"]["value"] = [-1.5, 1.5]
    posor = Posor(calibration_from(content))
    tilt = content["sensors"][0]["target_plane"]["tilt"]["value"]
    pose = pose_from_native((0.0, 0.0, 7.35e-4, -tilt[0], -tilt[1], 0.0))
    scan = scan_at(posor, pose)
    np.testing.assert_allclose(scan.gap_voltages, 0.0, atol=0.1)
    budget = error_budget(posor, scan, pose)
    drawn = monte_carlo(posor, scan, pose, seed=SEED, max_draws=2 * BATCH)
    assert not validate(budget, drawn)[GAP].holds


def test_too_few_draws_are_refused() -> None:
    posor = Posor(design("triad_diodes"))
    pose = middle_pose(posor)
    with pytest.raises(ParameterError, match="15000 draws; expected at least 20000"):
        monte_carlo(posor, scan_at(posor, pose), pose, seed=SEED, max_draws=15_000)


@pytest.mark.long
def test_too_many_lost_draws_are_refused() -> None:
    posor = Posor(design("triad_diodes"))
    near, far = 0.735e-3, 1.7e-3
    while far - near > 1e-10:
        middle = 0.5 * (near + far)
        try:
            scan_at(posor, pose_from_native((0.0, 0.0, middle, 0.0, 0.0, 0.0)))
        except ParameterError:
            far = middle
        else:
            near = middle
    pose = pose_from_native((0.0, 0.0, near, 0.0, 0.0, 0.0))
    with pytest.raises(FitError, match=r"\d+ of 10000 draws give no pose; expected a pose further from the ends"):
        monte_carlo(posor, scan_at(posor, pose), pose, seed=SEED, max_draws=2 * BATCH)
