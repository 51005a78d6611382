# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of many times, against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from posor.numerics.summary_statistics import FIGURES, figures_of

NO_LIMIT = 2**62


def test_figures_are_those_of_numpy() -> None:
    values, out = np.random.default_rng(5).integers(-1000, 1000, 101), np.empty(FIGURES)
    assert figures_of(values, NO_LIMIT, out) == 101
    np.testing.assert_allclose(out, [values.mean(), values.std(ddof=1), values.min(), values.max()], rtol=1e-12)


def test_values_that_reach_the_limit_do_not_count() -> None:
    out = np.empty(FIGURES)
    assert figures_of(np.array([100, -100, 7, 5, 99, -99]), 100, out) == 4
    assert tuple(out[2:]) == (-99.0, 99.0)
    assert out[0] == pytest.approx(3.0)


def test_one_value_has_no_deviation_and_none_gives_no_figures() -> None:
    out = np.full(FIGURES, 8.0)
    assert figures_of(np.array([3, 200]), 100, out) == 1
    assert tuple(out) == (3.0, 0.0, 3.0, 3.0)
    assert figures_of(np.array([200, -200]), 100, out) == 0
    assert figures_of(np.empty(0, np.int64), 100, out) == 0
