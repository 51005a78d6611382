# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a statement have the digits that their uncertainty allows (JCGM 100, 7.2.6); a bound is rounded up."""

from __future__ import annotations

import math

import pytest
from posor_design.statement_report import micro, micro_bound, rounded


@pytest.mark.parametrize(
    ("value", "uncertainty", "bound"),
    [
        (12.34e-6, "12", "12.4"),
        (1.234e-6, "1.2", "1.24"),
        (0.01234e-6, "0.012", "0.0124"),
        (123.4e-6, "123", "124"),
        (66.8e-6, "67", "66.8"),
        (1e-10, "0", "0.000100"),
        (0.0, "0", "0.000000"),
        (math.inf, "∞", "not bounded"),
    ],
)
def test_uncertainties_have_two_digits_and_bounds_three(value: float, uncertainty: str, bound: str) -> None:
    assert (micro(value), micro_bound(value)) == (uncertainty, bound)


@pytest.mark.parametrize(
    ("expanded", "text"),
    [
        (23.9e-6, "-0.162092"),
        (7.7e-6, "-0.1620915"),
        (0.12e-6, "-0.16209154"),
        (240e-6, "-0.162092"),
        (0.0, "-0.162091538"),
    ],
)
def test_a_value_ends_where_its_uncertainty_ends(expanded: float, text: str) -> None:
    assert rounded(-0.162091538, expanded) == text
