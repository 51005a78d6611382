# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import numpy as np
import pytest
from posor.numerics import matrix as symmetric
from posor.numerics.array_types import FloatArray
from posor.numerics.matrix import Symmetric, cholesky_factorise, solve_lower_triangular
from posor.numerics.vector import Matrix, Vector


def vector(a: FloatArray) -> Vector:
    x, y, z = a.tolist()
    return x, y, z


def rows(a: FloatArray) -> Matrix:
    return vector(a[0]), vector(a[1]), vector(a[2])


def in_blocks(matrix: FloatArray) -> Symmetric:
    """Return a symmetric matrix (6, 6) in blocks; NaN where nothing must be read."""
    lower = np.where(np.tri(6, dtype=bool), matrix, math.nan)
    return rows(lower[:3, :3]), rows(lower[3:, :3]), rows(lower[3:, 3:])


def whole(made: Symmetric) -> FloatArray:
    a, b, d = (np.array(block) for block in made)
    return np.block([[a, b.T], [b, d]])


def positive(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(6, 6)) * rng.uniform(0.1, 10.0, 6)
    made: FloatArray = root @ root.T + 1e-2 * np.eye(6)
    return made


def test_six_equations_are_solved_and_inverted_as_by_numpy(rng: np.random.Generator) -> None:
    for _ in range(50):
        matrix, right = positive(rng), rng.normal(size=6)
        factors, weakest = symmetric.factorise(in_blocks(matrix))
        assert weakest > 0.0
        solution = np.concatenate(symmetric.solve(factors, vector(right[:3]), vector(right[3:])))
        np.testing.assert_allclose(matrix @ solution, right, rtol=1e-9, atol=1e-9)
        inverse = whole(symmetric.invert(factors))
        np.testing.assert_allclose(matrix @ inverse, np.eye(6), rtol=0.0, atol=1e-9)
        applied = np.concatenate(
            symmetric.multiply_vector(symmetric.invert(factors), vector(right[:3]), vector(right[3:]))
        )
        np.testing.assert_allclose(applied, inverse @ right, rtol=1e-9, atol=1e-12)


def test_the_normal_matrix_is_that_of_the_rows_asked_for(rng: np.random.Generator) -> None:
    jacobian, weights = rng.normal(size=(9, 6)), rng.uniform(0.5, 2.0, 9)
    expected = jacobian[:7].T @ np.diag(weights[:7]) @ jacobian[:7]
    np.testing.assert_allclose(whole(symmetric.normal_matrix(jacobian, weights, 7)), expected, rtol=1e-13, atol=1e-13)


def test_factorise_returns_the_smallest_ratio_of_a_pivot_to_its_diagonal_entry(rng: np.random.Generator) -> None:
    assert symmetric.factorise(in_blocks(np.diag([1e-6, 1.0, 1e6, 1e-3, 1.0, 1e3])))[1] == 1.0  # whatever the units
    for _ in range(20):
        matrix = positive(rng)
        shares = np.diagonal(np.linalg.cholesky(matrix)) ** 2 / np.diagonal(matrix)
        assert symmetric.factorise(in_blocks(matrix))[1] == pytest.approx(shares.min(), rel=1e-9)


@pytest.mark.parametrize(
    ("i", "j", "bad"),
    [
        *((n, n, bad) for n in range(6) for bad in (0.0, -1.0, math.nan)),
        *((*pair, bad) for pair in ((1, 0), (3, 2), (5, 0), (5, 4)) for bad in (1.0, 2.0, math.nan)),
    ],
)
def test_factorise_returns_zero_for_a_matrix_that_is_not_positive_definite(i: int, j: int, bad: float) -> None:
    matrix = np.eye(6)
    matrix[i, j] = matrix[j, i] = bad
    assert symmetric.factorise(in_blocks(matrix))[1] == 0.0


@pytest.mark.parametrize("size", [1, 2, 6, 11])
def test_factor_and_solution_agree_with_numpy(size: int, rng: np.random.Generator) -> None:
    for _ in range(50):
        root = rng.normal(size=(size, size)) * rng.uniform(0.1, 10.0, size)
        matrix = root @ root.T + 1e-2 * np.eye(size)
        right = rng.normal(size=size)
        lower, solution = np.full((size + 2, size + 2), np.nan), right.copy()  # the rest must not be read
        lower[:size, :size] = matrix
        assert cholesky_factorise(lower, size)
        np.testing.assert_allclose(np.tril(lower[:size, :size]), np.linalg.cholesky(matrix), rtol=1e-9, atol=1e-12)
        solve_lower_triangular(lower, size, solution)
        np.testing.assert_allclose(np.tril(lower[:size, :size]) @ solution, right, rtol=1e-9, atol=1e-9)


def test_only_the_lower_triangle_is_read_and_written() -> None:
    matrix = np.array([[4.0, np.nan], [2.0, 10.0]])
    assert cholesky_factorise(matrix, 2)
    assert np.isnan(matrix[0, 1])
    assert np.tril(np.nan_to_num(matrix)).tolist() == [[2.0, 0.0], [1.0, 3.0]]


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 0.0], [2.0, 1.0]],
        [[1.0, 0.0], [1.0, 1.0]],
        [[0.0, 0.0], [0.0, 1.0]],
        [[-1.0, 0.0], [0.0, 1.0]],
        [[np.nan, 0.0], [0.0, 1.0]],
        [[1.0, 0.0], [np.nan, 1.0]],
    ],
    ids=["indefinite", "singular", "zero", "negative", "nan on the diagonal", "nan off the diagonal"],
)
def test_a_matrix_that_is_not_positive_definite_has_no_factor(matrix: list[list[float]]) -> None:
    assert not cholesky_factorise(np.array(matrix), 2)
