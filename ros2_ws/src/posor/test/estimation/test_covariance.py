# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Covariances and chi-square of a solution against the dense formulas, for any number of redundant readings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from posor.estimation.covariance import write_covariances
from posor.estimation.scan_checks import chi_square
from posor.estimation.workspace import WORKSPACE
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import in_place, record_view
from posor.numerics.matrix import factorise, normal_matrix, store_factors
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation


@in_place
def covariances_of_workspace(memory: npt.NDArray[np.void], random: FloatArray, systematic: FloatArray) -> None:
    """Write the covariances; compiled code takes records in arrays only."""
    write_covariances(memory[0], random, systematic)


@in_place
def chi_square_of_workspace(memory: npt.NDArray[np.void]) -> float:
    return chi_square(memory[0])


class Solved:
    """An invented solution of m readings in a workspace.

    Readings are correlated with those of their own group only; ``groups`` is the number of groups.
    """

    def __init__(self, m: int, rng: np.random.Generator, groups: int = 1) -> None:
        self.m = m
        self._memory = np.zeros(1, dtype=WORKSPACE)
        workspace = self._memory[0]
        workspace["reading_count"], workspace["redundant_count"] = m, m - 6
        self.jacobian, self.residuals = workspace["jacobian"][:m], workspace["residuals"][:m]
        self.jacobian[:] = rng.normal(size=(m, 6)) * [1.0, 1.0, 1.0, 0.05, 0.05, 0.05]
        self.variances = rng.uniform(0.2, 2.0, m) * 1e-14
        workspace["weights"][:m] = 1.0 / self.variances
        roots = [rng.normal(size=(len(group),) * 2) * 3e-8 for group in np.array_split(np.arange(m), groups)]
        self.systematic = block_diag(*(root @ root.T for root in roots))
        workspace["systematic_readings"][:m, :m] = self.systematic
        self.residuals[:] = rng.normal(size=m) * 1e-7
        ends = np.cumsum([len(root) for root in roots])
        workspace["first_correlated"][:m] = np.repeat(ends - [len(root) for root in roots], [len(r) for r in roots])
        workspace["end_correlated"][:m] = np.repeat(ends, [len(root) for root in roots])

    def covariances(self, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        workspace = self._memory[0]
        workspace["pose"]["rotation"] = rotation
        weights = np.ascontiguousarray(workspace["weights"])
        factors, _ = factorise(normal_matrix(np.ascontiguousarray(workspace["jacobian"]), weights, self.m))
        store_factors(factors, workspace["factors"])
        random, systematic = np.empty((6, 6)), np.empty((6, 6))
        covariances_of_workspace(record_view(self._memory), random, systematic)
        return random, systematic

    def chi_square(self) -> float:
        return chi_square_of_workspace(record_view(self._memory))


@pytest.mark.parametrize("groups", [1, 3])
@pytest.mark.parametrize("m", [7, 8, 9, 12])
def test_covariances_and_chi_square_agree_with_the_dense_formulas(
    m: int, groups: int, rng: np.random.Generator
) -> None:
    for _ in range(20):
        solved = Solved(m, rng, groups)
        rotation: FloatArray = Rotation.random(None, rng).as_matrix()
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


def test_readings_that_do_not_depend_on_the_pose_are_tested_by_themselves(rng: np.random.Generator) -> None:
    solved = Solved(8, rng)
    solved.jacobian[6:] = 0.0
    solved.covariances(np.eye(3))
    solved.residuals[:6] = 0.0
    found = solved.chi_square()
    total = np.diag(solved.variances) + solved.systematic
    rest = solved.residuals[6:]
    # Two readings do not depend on the pose; the pose fits the six others exactly.
    assert found == pytest.approx(rest @ np.linalg.solve(total[6:, 6:], rest), rel=1e-7)
