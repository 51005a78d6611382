# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Quantiles of chi-square, against scipy."""

from __future__ import annotations

import pytest
from posor.numerics.chi_square import noncentrality, upper_quantile
from scipy.special import chdtri, chndtr

PROBABILITIES = (0.5, 1e-2, 1e-5, 1e-7, 1e-12, 1e-100, 1e-300)


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7, 12, 30])
def test_quantiles_are_those_of_scipy(degrees: int) -> None:
    for probability in PROBABILITIES:
        limit = upper_quantile(degrees, probability)
        assert limit == pytest.approx(chdtri(degrees, probability), rel=1e-14)
        assert chndtr(limit, degrees, noncentrality(degrees, limit, 0.01)) == pytest.approx(0.01, rel=1e-12)
