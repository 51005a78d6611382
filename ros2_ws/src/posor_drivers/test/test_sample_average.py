# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Means, spreads and outliers, against theory: the bounds are quantiles that chance exceeds once in a million."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from posor_drivers.sample_average import SampleAverage, average_samples
from scipy.stats import binom, chi2

FloatArray = NDArray[np.float64]

CHANCE = 1e-6
SIGMA_V = 0.002
GROUPS = 4000


def is_chi_square(statistic: float, freedom: int) -> bool:
    return bool(chi2.ppf(CHANCE / 2, freedom) < statistic < chi2.isf(CHANCE / 2, freedom))


def noise(samples: int, seed: int, width: int = 1) -> FloatArray:
    """Return groups as units, since units do not know of each other: shape (samples, GROUPS, width)."""
    return np.random.default_rng(seed).normal(0.5, SIGMA_V, (samples, GROUPS, width))


def averaged(samples: FloatArray, significance: float | None = None) -> SampleAverage:
    return average_samples(samples, np.ones(len(samples), dtype=np.int64), significance=significance)


def column(*values: float) -> FloatArray:
    return np.array(values).reshape(-1, 1, 1)


@pytest.mark.parametrize("samples", [2, 5, 20])
def test_noise_of_the_mean_falls_with_the_root_of_the_number_and_the_spread_is_that_of_one(samples: int) -> None:
    result = averaged(noise(samples, seed=samples))
    assert is_chi_square((GROUPS - 1) * result.means.var(ddof=1) / (SIGMA_V**2 / samples), GROUPS - 1)
    assert is_chi_square((samples - 1) * (result.spreads**2).sum() / SIGMA_V**2, (samples - 1) * GROUPS)
    assert set(result.counts.tolist()) == {samples}


def test_mean_without_outlier_has_the_noise_of_the_remaining_samples() -> None:
    samples = noise(5, seed=30)
    samples[3] += 1000.0 * SIGMA_V
    result = averaged(samples, significance=0.01)
    assert result.dropped
    assert set(result.counts.tolist()) == {4}
    assert is_chi_square((GROUPS - 1) * result.means.var(ddof=1) / (SIGMA_V**2 / 4), GROUPS - 1)
    assert is_chi_square(3 * (result.spreads**2).sum() / SIGMA_V**2, 3 * GROUPS)
    assert GROUPS * 4 * (result.means.mean() - 0.5) ** 2 / SIGMA_V**2 < chi2.isf(CHANCE / 2, 1)


@pytest.mark.parametrize("significance", [0.01, 0.1])
def test_good_samples_are_dropped_with_the_stated_probability(significance: float) -> None:
    result = averaged(noise(5, seed=40), significance)
    low, high = binom(GROUPS, significance).ppf([CHANCE / 2, 1.0 - CHANCE / 2])
    assert low < (result.counts < 5).sum() < high
    assert result.counts.min() == 4


def test_good_samples_of_a_diode_are_dropped_at_most_with_the_stated_probability() -> None:
    result = averaged(noise(5, seed=41, width=4), significance=0.05)
    assert 0 < (result.counts < 5).sum() < binom.isf(CHANCE / 2, GROUPS, 0.05)


def test_at_most_one_in_five_is_dropped() -> None:
    samples = np.random.default_rng(50).normal(0.0, 1.0, (20, 1, 1))
    samples[:4] += 1e4 * np.arange(1, 5).reshape(-1, 1, 1)
    result = averaged(samples, significance=0.01)
    assert result.counts.tolist() == [16]
    assert result.means[0, 0] == pytest.approx(samples[4:].mean(), abs=1e-12)
    samples[4] -= 5e4
    assert averaged(samples, significance=0.01).counts.tolist() == [16]


def test_masked_outliers_are_found() -> None:
    samples = np.random.default_rng(51).normal(0.0, 1.0, (10, 1, 1))
    samples[[2, 7]] = 1000.0
    result = averaged(samples, significance=0.01)
    assert result.counts.tolist() == [8]
    assert abs(result.means[0, 0]) < 2.0


def test_four_contacts_are_dropped_together() -> None:
    samples = np.random.default_rng(52).normal(1.0, 0.01, (5, 2, 4))
    samples[1, 0, 2] = 9.0
    result = averaged(samples, significance=0.01)
    assert result.counts.tolist() == [4, 5]
    np.testing.assert_allclose(result.means[0], samples[[0, 2, 3, 4], 0].mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(result.means[1], samples[:, 1].mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(result.spreads[0], samples[[0, 2, 3, 4], 0].std(axis=0, ddof=1), rtol=1e-12)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_sample_that_is_not_finite_is_dropped(bad: float) -> None:
    result = averaged(column(1.0, bad, 3.0))
    assert (result.means.item(), result.counts.item(), result.dropped) == (2.0, 2, True)
    assert result.spreads.item() == pytest.approx(np.sqrt(2.0))


def test_unit_without_finite_sample_is_nan_and_does_not_affect_others() -> None:
    samples = np.array([[[np.nan], [1.0]], [[np.inf], [3.0]]])
    result = averaged(samples)
    assert np.isnan(result.means[0, 0])
    assert np.isnan(result.spreads[0, 0])
    assert (result.means[1, 0], result.counts.tolist(), result.dropped) == (2.0, [2, 2], False)


def test_equal_samples_have_no_outlier_and_no_spread() -> None:
    result = averaged(column(0.1, 0.1, 0.1, 0.1, 0.1), significance=0.2)
    assert result.means.item() == pytest.approx(0.1)
    assert (result.spreads.item(), result.dropped) == (0.0, False)


def test_single_sample_has_no_spread() -> None:
    result = averaged(column(0.25), significance=0.01)
    assert result.means.item() == 0.25
    assert np.isnan(result.spreads.item())


def test_means_of_means_are_the_mean_of_all_readings() -> None:
    readings = np.random.default_rng(60).normal(3.0, 0.5, 12)
    parts = np.split(readings, [3, 4])
    result = average_samples(
        column(*(part.mean() for part in parts)),
        np.array([len(part) for part in parts]),
        column(*(part.std(ddof=1) if len(part) > 1 else np.nan for part in parts)),
    )
    assert result.means.item() == pytest.approx(readings.mean(), rel=1e-14)
    assert result.spreads.item() == pytest.approx(readings.std(ddof=1), rel=1e-13)
    assert result.counts.item() == 12


def test_missing_sensor_gives_empty_results() -> None:
    result = averaged(np.empty((5, 0, 1)), significance=0.01)
    assert (result.means.size, result.counts.size, result.dropped) == (0, 0, False)
