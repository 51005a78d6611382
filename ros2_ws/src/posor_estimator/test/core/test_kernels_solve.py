from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.core.kernels import solve
from posor_estimator.core.kernels.rows import GAP, SPOT_X, SPOT_Y, evaluate_row

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

LEAST_SHARE = 1e-7


@dataclass(frozen=True)
class Problem:
    """A triad of gap probes and two diodes near zero pose: seven readings of one scan."""

    kinds: IntArray
    rows: FloatArray
    weights: FloatArray

    def readings(self, pose: pin.SE3) -> FloatArray:
        """Return what the seven rows read at a pose."""
        rotation, translation, unused = pose.rotation.copy(), pose.translation.copy(), np.empty(6)
        return np.array(
            [
                evaluate_row(kind, row, rotation, translation, np.zeros(6), unused)
                for kind, row in zip(self.kinds, self.rows, strict=True)
            ]
        )

    def solve(self, values: FloatArray, start: pin.SE3) -> Solution:
        """Run the solver from a start pose."""
        rotation, translation = start.rotation.copy(), start.translation.copy()
        jacobian, residuals, moved = np.full((len(values), 6), np.nan), np.full(len(values), np.nan), np.full(6, np.nan)
        outcome = solve.gauss_newton(
            self.kinds, self.rows, values, self.weights, rotation, translation, jacobian, residuals, moved, LEAST_SHARE
        )
        return Solution(outcome, pin.SE3(rotation, translation), jacobian, residuals)


@dataclass(frozen=True)
class Solution:
    """What came out."""

    outcome: int
    pose: pin.SE3
    jacobian: FloatArray
    residuals: FloatArray


@pytest.fixture
def problem() -> Problem:
    rows = np.zeros((7, 16))
    for row, tip in zip(rows[:3], ((-0.076, 0.0), (0.0, 0.038), (0.0, -0.039)), strict=True):
        row[0:2], row[5] = tip, 1.0
    for k, y in enumerate((0.045, -0.031)):
        for row in rows[3 + 2 * k : 5 + 2 * k]:
            row[0:2], row[9:11] = (-0.025, y), (-0.024, y + 0.001)
            row[3], row[7], row[14] = 1.0, 1.0, -1.0
    kinds = np.array([GAP, GAP, GAP, SPOT_X, SPOT_Y, SPOT_X, SPOT_Y])
    return Problem(kinds, rows, np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4]) * 1e12)


@pytest.fixture
def pose() -> pin.SE3:
    return pin.exp6(np.array([1e-4, -2e-4, 8e-4, 1e-3, -2e-3, 0.02]))


def test_the_pose_comes_back_from_its_readings(problem: Problem, pose: pin.SE3) -> None:
    solution = problem.solve(problem.readings(pose), pin.SE3.Identity())
    assert solution.outcome == solve.CONVERGED
    error = pin.log6(pose.actInv(solution.pose)).vector
    np.testing.assert_allclose(error, np.zeros(6), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(solution.residuals, np.zeros(7), rtol=0.0, atol=1e-15)


def test_poses_come_back_from_ray_traced_readings(golden_cases: list[dict[str, Any]]) -> None:
    for case in golden_cases:
        rows = []
        for probe in case["probes"]:
            normal = case["target_plane"]["normal"]
            tilt = np.arctan2(normal[1], -normal[2]), -np.arcsin(normal[0])
            rows.append([*probe["tip"], *probe["axis"], *case["target_plane"]["point"], *tilt, 0.0, 0.0, 0.0, 0.0, 0.0])
        for diode, source in zip(case["diodes"], case["sources"], strict=True):
            rows += 2 * [[*diode["origin"], *diode["u"], *diode["v"], *source["origin"], *source["direction"], 0.0]]
        problem = Problem(np.array([GAP, GAP, GAP, SPOT_X, SPOT_Y, SPOT_X, SPOT_Y]), np.array(rows), np.full(7, 1e12))
        truth = pin.SE3(np.array(case["T_R_T"]["rotation"]), np.array(case["T_R_T"]["translation"]))
        theta = np.arctan2(-truth.rotation[0, 1], truth.rotation[1, 1])
        coarse = pin.SE3(pin.utils.rotate("z", theta + 0.05), np.zeros(3))
        spots = np.ravel(case["readings"]["spots"])
        solution = problem.solve(np.concatenate([case["readings"]["gaps"], spots]), coarse)
        assert solution.outcome == solve.CONVERGED, f"case {case['case']}"
        error = pin.log6(truth.actInv(solution.pose)).vector
        np.testing.assert_allclose(error, np.zeros(6), rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


def test_contradicting_readings_are_settled_by_their_weights(
    problem: Problem, pose: pin.SE3, rng: np.random.Generator
) -> None:
    """At the solution the weighted residuals are square to every direction the pose can move in: J' W e = 0."""
    values = problem.readings(pose) + rng.normal(scale=1e-5, size=7)
    solution = problem.solve(values, pin.SE3.Identity())
    assert solution.outcome == solve.CONVERGED
    np.testing.assert_allclose(solution.residuals, values - problem.readings(solution.pose), rtol=0.0, atol=1e-18)
    assert np.abs(solution.residuals).max() > 1e-8
    pull = solution.jacobian.T @ (problem.weights * solution.residuals)
    size = np.abs(solution.jacobian.T) @ np.abs(problem.weights * solution.residuals)
    np.testing.assert_allclose(pull / size, np.zeros(6), rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("off", [1e-2, 1e-3, 1e-5, 3e-6, 1e-6, 3e-7, 1e-9, 0.0])
def test_derivatives_are_those_at_the_solution_from_wherever_it_was_found(
    off: float, problem: Problem, pose: pin.SE3, rng: np.random.Generator
) -> None:
    values = problem.readings(pose) + rng.normal(scale=1e-7, size=7)
    best = problem.solve(values, pose).pose
    solution = problem.solve(values, best * pin.exp6(off * np.array([0.05, -0.03, 0.02, 1.0, -0.7, 0.4])))
    assert solution.outcome == solve.CONVERGED
    np.testing.assert_allclose(pin.log6(best.actInv(solution.pose)).vector, np.zeros(6), rtol=0.0, atol=1e-15)
    derivative = np.empty((7, 6))
    rotation, translation = solution.pose.rotation.copy(), solution.pose.translation.copy()
    for kind, row, out in zip(problem.kinds, problem.rows, derivative, strict=True):
        evaluate_row(kind, row, rotation, translation, np.zeros(6), out)
    np.testing.assert_allclose(solution.jacobian, derivative, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(solution.residuals, values - problem.readings(solution.pose), rtol=0.0, atol=2e-17)


def test_the_solution_does_not_depend_on_the_scale_of_the_weights(problem: Problem, pose: pin.SE3) -> None:
    values = problem.readings(pose) + 1e-5 * np.arange(7)
    small = Problem(problem.kinds, problem.rows, problem.weights * 1e-18)
    solution, other = problem.solve(values, pin.SE3.Identity()), small.solve(values, pin.SE3.Identity())
    assert solution.outcome == other.outcome == solve.CONVERGED
    assert solution.pose.isApprox(other.pose, 1e-12)


@pytest.mark.parametrize("missing", [[0, 1], [3, 4], [3, 5], [0, 1, 2]], ids=str)
def test_readings_that_leave_a_freedom_open_are_ill_conditioned(
    missing: list[int], problem: Problem, pose: pin.SE3
) -> None:
    kept = [row for row in range(7) if row not in missing]
    fewer = Problem(problem.kinds[kept], problem.rows[kept], problem.weights[kept])
    assert fewer.solve(fewer.readings(pose), pin.SE3.Identity()).outcome == solve.ILL_CONDITIONED


def test_three_probes_in_a_line_are_ill_conditioned(problem: Problem, pose: pin.SE3) -> None:
    problem.rows[0, 0:2] = (0.0, 0.01)
    assert problem.solve(problem.readings(pose), pin.SE3.Identity()).outcome == solve.ILL_CONDITIONED


def test_readings_that_no_pose_can_give_do_not_converge(problem: Problem) -> None:
    values = problem.readings(pin.SE3.Identity())
    values[3:] += [0.5, 0.5, -0.5, -0.5]  # the two spots a metre apart and more: the diodes are 76 mm from each other
    solution = problem.solve(values, pin.SE3.Identity())
    assert solution.outcome == solve.NOT_CONVERGED


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reading_that_is_not_finite_never_converges(bad: float, problem: Problem, pose: pin.SE3) -> None:
    for index in range(7):
        values = problem.readings(pose)
        values[index] = bad
        assert problem.solve(values, pin.SE3.Identity()).outcome != solve.CONVERGED


def test_a_geometry_that_is_not_finite_never_converges(problem: Problem, pose: pin.SE3) -> None:
    values = problem.readings(pose)
    problem.rows[4, 9] = np.nan
    assert problem.solve(values, pin.SE3.Identity()).outcome != solve.CONVERGED
