from __future__ import annotations

import numpy as np
import pytest
from posor_estimator.core.kernels.cholesky import factor, halve


@pytest.mark.parametrize("size", [1, 2, 6, 11])
def test_factor_and_halve_do_as_numpy_does(size: int, rng: np.random.Generator) -> None:
    for _ in range(50):
        root = rng.normal(size=(size, size)) * rng.uniform(0.1, 10.0, size)
        matrix = root @ root.T + 1e-2 * np.eye(size)
        right = rng.normal(size=size)
        lower, solution = matrix.copy(), right.copy()
        assert factor(lower) > 0.0
        np.testing.assert_allclose(np.tril(lower), np.linalg.cholesky(matrix), rtol=1e-9, atol=1e-12)
        halve(lower, solution)
        np.testing.assert_allclose(np.tril(lower) @ solution, right, rtol=1e-9, atol=1e-9)


def test_factor_reads_and_writes_the_lower_triangle_only() -> None:
    matrix = np.array([[4.0, np.nan], [2.0, 10.0]])
    assert factor(matrix) > 0.0
    assert np.isnan(matrix[0, 1])
    assert np.tril(np.nan_to_num(matrix)).tolist() == [[2.0, 0.0], [1.0, 3.0]]


def test_factor_returns_the_least_share_of_an_unknown_that_the_others_do_not_explain() -> None:
    assert factor(np.diag([1e-6, 1.0, 1e6])) == 1.0  # whatever the units of the unknowns
    correlation = 0.8
    assert factor(np.array([[1.0, 0.0], [correlation, 1.0]])) == pytest.approx(1.0 - correlation**2, rel=1e-15)
    assert factor(np.array([[1e8, 0.0], [correlation * 1e4, 1.0]])) == pytest.approx(1.0 - correlation**2, rel=1e-12)


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
def test_factor_returns_zero_for_what_is_not_positive_definite(matrix: list[list[float]]) -> None:
    assert factor(np.array(matrix)) == 0.0
