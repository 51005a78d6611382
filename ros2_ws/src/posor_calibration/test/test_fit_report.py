# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Warnings and refusals after a fit."""

from __future__ import annotations

import numpy as np
import pytest
from posor.errors import FitError
from posor_calibration.fit_report import describe_enlargement, describe_rejected, describe_spread, enlarge_if_improbable
from posor_calibration.least_squares import fit_parameters


def test_outliers_are_named_and_too_many_refused() -> None:
    names = [f"dwell {n}" for n in range(40)]
    outliers = np.zeros(40, dtype=bool)
    assert describe_rejected(outliers, names, "gap_1") == ()
    outliers[[3, 17]] = True
    assert describe_rejected(outliers, names, "gap_1") == (
        "gap_1: left out dwell 3, dwell 17, which do not fit the others.",
    )
    outliers[20:24] = True
    with pytest.raises(FitError) as caught:
        describe_rejected(outliers, names, "gap_1")
    assert str(caught.value) == ("gap_1: 6 of 40 readings do not fit, such as dwell 3; expected at most 10 % outliers.")


@pytest.mark.parametrize(("times", "improbable"), [(1.0, False), (2.0, True)])
def test_residuals_beyond_the_stated_uncertainties_are_reported(
    times: float, *, improbable: bool, rng: np.random.Generator
) -> None:
    readings = times * rng.normal(size=100)
    found = fit_parameters(lambda values: readings - values[0], np.zeros(1), ("mean",), ("m",), np.ones(1))
    assert bool(describe_enlargement(found, "the mean")) == improbable
    growth = found.spread if improbable else 1.0
    np.testing.assert_allclose(enlarge_if_improbable(found).sigmas, growth * found.sigmas)


@pytest.mark.parametrize(
    ("times", "count", "why"),
    [(1.0, 100, ""), (0.3, 100, ""), (0.05, 100, "too large"), (0.05, 2, ""), (2.0, 100, "too small")],
)
def test_stated_uncertainties_that_the_residuals_contradict_are_reported(
    times: float, count: int, why: str, rng: np.random.Generator
) -> None:
    readings = times * rng.normal(size=count)
    found = fit_parameters(lambda values: readings - values[0], np.zeros(1), ("mean",), ("m",), np.ones(1))
    for sentences in (describe_spread(found), describe_enlargement(found, "the mean")):
        assert len(sentences) == bool(why)
    assert why in "".join(describe_spread(found))
