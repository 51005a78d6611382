# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest
from posor.estimation import solver
from posor.estimation.workspace import WORKSPACE
from posor.model.reading_rows import GAP, ROW, SPOT_X, SPOT_Y, evaluate_rows, prepare_rows
from posor.numerics.array_types import FloatArray, IntArray
from posor.numerics.compiled import in_place, record_view

LEAST_RATIO = 1e-7


@in_place
def solve_workspace(memory: npt.NDArray[np.void], count: int) -> int:
    """Run the solver; compiled code takes records in arrays only."""
    return solver.solve_pose(memory[0], count, LEAST_RATIO, math.nan)


@dataclass(frozen=True)
class Problem:
    """A triad of gap probes and two diodes near zero pose: seven readings of one scan."""

    kinds: IntArray
    rows: FloatArray
    weights: FloatArray

    def readings(self, pose: pin.SE3) -> FloatArray:
        return evaluate_rows(self._records(), pose.rotation, pose.translation)[0]

    def jacobian(self, pose: pin.SE3) -> FloatArray:
        return evaluate_rows(self._records(), pose.rotation, pose.translation)[1]

    def solve(self, values: FloatArray, start: pin.SE3) -> Solution:
        memory, m = np.zeros(1, dtype=WORKSPACE), len(values)
        workspace = memory[0]
        workspace["rows"][:m], workspace["values"][:m], workspace["weights"][:m] = self._records(), values, self.weights
        workspace["pose"]["rotation"], workspace["pose"]["translation"] = start.rotation, start.translation
        outcome = solve_workspace(record_view(memory), m)
        pose = pin.SE3(workspace["pose"]["rotation"], workspace["pose"]["translation"])
        return Solution(outcome, pose, workspace["jacobian"][:m], workspace["residuals"][:m])

    def _records(self) -> npt.NDArray[np.void]:
        records = np.zeros(len(self.kinds), dtype=ROW)
        records["kind"], records["parameters"][:, : self.rows.shape[1]] = self.kinds, self.rows
        prepare_rows(record_view(records))
        return records


@dataclass(frozen=True)
class Solution:
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
    assert solution.outcome == solver.CONVERGED
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
        assert solution.outcome == solver.CONVERGED, f"case {case['case']}"
        error = pin.log6(truth.actInv(solution.pose)).vector
        np.testing.assert_allclose(error, np.zeros(6), rtol=0.0, atol=1e-12, err_msg=f"case {case['case']}")


def test_contradicting_readings_are_settled_by_their_weights(
    problem: Problem, pose: pin.SE3, rng: np.random.Generator
) -> None:
    """At the solution the weighted residuals are square to every direction the pose can move in: J' W e = 0."""
    values = problem.readings(pose) + rng.normal(scale=1e-5, size=7)
    solution = problem.solve(values, pin.SE3.Identity())
    assert solution.outcome == solver.CONVERGED
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
    assert solution.outcome == solver.CONVERGED
    np.testing.assert_allclose(pin.log6(best.actInv(solution.pose)).vector, np.zeros(6), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(solution.jacobian, problem.jacobian(solution.pose), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(solution.residuals, values - problem.readings(solution.pose), rtol=0.0, atol=2e-17)


def test_the_solution_does_not_depend_on_the_scale_of_the_weights(problem: Problem, pose: pin.SE3) -> None:
    values = problem.readings(pose) + 1e-5 * np.arange(7)
    small = Problem(problem.kinds, problem.rows, problem.weights * 1e-18)
    solution, other = problem.solve(values, pin.SE3.Identity()), small.solve(values, pin.SE3.Identity())
    assert solution.outcome == other.outcome == solver.CONVERGED
    assert solution.pose.isApprox(other.pose, 1e-12)


@pytest.mark.parametrize("missing", [[0, 1], [3, 4], [3, 5], [0, 1, 2]], ids=str)
def test_readings_that_leave_a_freedom_open_are_ill_conditioned(
    missing: list[int], problem: Problem, pose: pin.SE3
) -> None:
    kept = [row for row in range(7) if row not in missing]
    fewer = Problem(problem.kinds[kept], problem.rows[kept], problem.weights[kept])
    assert fewer.solve(fewer.readings(pose), pin.SE3.Identity()).outcome == solver.ILL_CONDITIONED


def test_three_probes_in_a_line_are_ill_conditioned(problem: Problem, pose: pin.SE3) -> None:
    problem.rows[0, 0:2] = (0.0, 0.01)
    assert problem.solve(problem.readings(pose), pin.SE3.Identity()).outcome == solver.ILL_CONDITIONED


def test_readings_that_no_pose_can_give_do_not_converge(problem: Problem) -> None:
    values = problem.readings(pin.SE3.Identity())
    values[3:] += [0.5, 0.5, -0.5, -0.5]  # the two spots a metre apart and more: the diodes are 76 mm from each other
    solution = problem.solve(values, pin.SE3.Identity())
    assert solution.outcome == solver.NOT_CONVERGED


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reading_that_is_not_finite_never_converges(bad: float, problem: Problem, pose: pin.SE3) -> None:
    for index in range(7):
        values = problem.readings(pose)
        values[index] = bad
        assert problem.solve(values, pin.SE3.Identity()).outcome != solver.CONVERGED


def test_a_geometry_that_is_not_finite_never_converges(problem: Problem, pose: pin.SE3) -> None:
    values = problem.readings(pose)
    problem.rows[4, 9] = np.nan
    assert problem.solve(values, pin.SE3.Identity()).outcome != solver.CONVERGED
