# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles and non-centrality of chi-square, against scipy and a printed table."""

from __future__ import annotations

import pytest
from posor.numerics.chi_square import noncentrality, upper_quantile
from scipy.special import chdtri, chndtr

PROBABILITIES = (0.999, 0.5, 1e-2, 1e-5, 1e-7, 1e-12, 1e-100, 1e-300)
PRINTED = [(1, 0.05, 3.84146), (5, 0.01, 15.0863), (10, 0.5, 9.34182)]  # Abramowitz and Stegun, table 26.8


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 12, 30])
def test_quantiles_are_those_of_scipy(degrees: int) -> None:
    for probability in PROBABILITIES:
        assert upper_quantile(degrees, probability) == pytest.approx(chdtri(degrees, probability), rel=1e-13)


@pytest.mark.parametrize(("degrees", "probability", "printed"), PRINTED)
def test_quantiles_are_those_of_a_printed_table(degrees: int, probability: float, printed: float) -> None:
    assert upper_quantile(degrees, probability) == pytest.approx(printed, rel=5e-6)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 12, 30])
@pytest.mark.parametrize("limit", [60.0, 250.0])
def test_noncentrality_is_that_of_scipy(degrees: int, limit: float) -> None:
    for probability in (0.9, 0.01, 1e-6):
        found = noncentrality(degrees, limit, probability)
        assert chndtr(limit, degrees, found) == pytest.approx(probability, rel=1e-9)


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, float("nan")])
def test_a_probability_without_a_quantile_is_refused(probability: float) -> None:
    with pytest.raises(ValueError, match="expected above 0 and below 1"):
        upper_quantile(3, probability)
    with pytest.raises(ValueError, match="expected above 0 and below"):
        noncentrality(3, 10.0, probability)


def test_a_limit_that_is_too_low_for_the_probability_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected above 0 and below 0\.00216"):
        noncentrality(6, 0.5, 0.01)
