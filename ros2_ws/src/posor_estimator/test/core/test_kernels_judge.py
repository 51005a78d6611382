"""Covariances and chi-square of a solution against the dense formulas, for any number of redundant readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.core.kernels.blocks import factor, keep_factors, normal_matrix
from posor_estimator.core.kernels.judge import chi_square, covariances
from posor_estimator.core.kernels.tables import (
    BLIND,
    FACTORS,
    GAIN,
    JACOBIAN,
    LINES,
    REACH,
    READINGS,
    RESIDUALS,
    SPREAD,
    TABLES,
    WEIGHTS,
)
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


class Solved:
    """A made-up solution of m readings, in tables as the loop over scans has them.

    Readings are correlated with those of their own group only, of which ``groups`` says how many there are.
    """

    def __init__(self, m: int, rng: np.random.Generator, groups: int = 1) -> None:
        self.m = m
        self.places: IntArray = np.zeros((TABLES, 3), dtype=np.int64)
        start = 0
        shapes = {
            JACOBIAN: (m, 6),
            LINES: (4, m),
            READINGS: (m, m),
            GAIN: (m, 6),
            BLIND: (m - 6, m + 1),
            SPREAD: (m - 6, m - 6),
            FACTORS: (7, 3),
        }
        for which, (rows, columns) in shapes.items():
            self.places[which] = start, rows, columns
            start += rows * columns
        self.floats: FloatArray = np.zeros(start)
        self.jacobian, self.residuals = self.table(JACOBIAN), self.table(LINES)[RESIDUALS]
        self.jacobian[:] = rng.normal(size=(m, 6)) * [1.0, 1.0, 1.0, 0.05, 0.05, 0.05]
        self.variances = rng.uniform(0.2, 2.0, m) * 1e-14
        self.table(LINES)[WEIGHTS] = 1.0 / self.variances
        roots = [rng.normal(size=(len(group),) * 2) * 3e-8 for group in np.array_split(np.arange(m), groups)]
        self.systematic = block_diag(*(root @ root.T for root in roots))
        self.table(READINGS)[:] = self.systematic
        self.residuals[:] = rng.normal(size=m) * 1e-7
        self.places[REACH] = 0, m, 2
        ends = np.cumsum([len(root) for root in roots])
        self.ints: IntArray = np.concatenate(
            [np.tile([end - len(root), end], len(root)) for root, end in zip(roots, ends, strict=True)]
        )

    def covariances(self, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what the kernel finds."""
        factors, _ = factor(normal_matrix(self.jacobian, self.table(LINES)[WEIGHTS], self.m))
        keep_factors(factors, self.table(FACTORS))
        random, systematic = np.empty((6, 6)), np.empty((6, 6))
        covariances(self.places, self.ints, self.floats, self.m, rotation, random, systematic)
        return random, systematic

    def chi_square(self) -> float:
        """Return what the kernel finds, after ``covariances``."""
        return chi_square(self.places, self.ints, self.floats, self.m)

    def table(self, which: int) -> FloatArray:
        start, rows, columns = self.places[which].tolist()
        return self.floats[start : start + rows * columns].reshape(rows, columns)


@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("m", [7, 8, 9, 12])
def test_solution_is_judged_as_the_dense_formulas_say(m: int, groups: int, rng: np.random.Generator) -> None:
    for _ in range(20):
        solved = Solved(m, rng, groups)
        rotation: FloatArray = Rotation.random(rng=rng).as_matrix()
        random, systematic = solved.covariances(rotation)
        found = solved.chi_square()

        jacobian, inverse = solved.jacobian, np.diag(1.0 / solved.variances)
        local = np.linalg.inv(jacobian.T @ inverse @ jacobian)
        gain = local @ jacobian.T @ inverse
        turn = block_diag(rotation, rotation)
        for written, expected in ((random, local), (systematic, gain @ solved.systematic @ gain.T)):
            in_parent = turn @ expected @ turn.T
            sigmas = np.sqrt(np.diag(in_parent))
            np.testing.assert_allclose(
                written / np.outer(sigmas, sigmas), in_parent / np.outer(sigmas, sigmas), atol=1e-9
            )
        total = np.linalg.inv(np.diag(solved.variances) + solved.systematic)
        explained = total @ jacobian @ np.linalg.solve(jacobian.T @ total @ jacobian, jacobian.T @ total)
        assert found == pytest.approx(solved.residuals @ (total - explained) @ solved.residuals, rel=1e-7)


def test_readings_that_know_nothing_of_the_pose_are_judged_by_themselves(rng: np.random.Generator) -> None:
    solved = Solved(8, rng)
    solved.jacobian[6:] = 0.0
    solved.covariances(np.eye(3))
    solved.residuals[:6] = 0.0
    found = solved.chi_square()
    total = np.diag(solved.variances) + solved.systematic
    rest = solved.residuals[6:]
    # Two readings know nothing of the pose; the six others can be fitted whatever they read.
    assert found == pytest.approx(rest @ np.linalg.solve(total[6:, 6:], rest), rel=1e-7)
