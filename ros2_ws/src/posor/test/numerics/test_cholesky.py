from __future__ import annotations

import numpy as np
import pytest
from posor.numerics.cholesky import cholesky_factorise, solve_lower_triangular


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
