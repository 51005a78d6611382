# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scatter of means of scans at rest: independent and lasting noise, slow motion, gaps, too few scans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor.errors import BagError
from posor.numerics.array_types import FloatArray, IntArray
from posor_design.dwell_scatter import dwell_scatter
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

SIGMA, PERIOD_NS, COUNT = 2e-7, 5_000_000, 40_000


def stamps(count: int) -> IntArray:
    return PERIOD_NS * np.arange(count, dtype=np.int64)


def poses(noise: FloatArray) -> FloatArray:
    """Return poses (n, 7) of a joint at rest that turn and move by noise (n, 6)."""
    rest = Rotation.from_rotvec([0.3, -0.2, 1.1])
    turned = Rotation.from_rotvec(noise[:, 3:]) * rest
    return np.hstack([np.array([0.1, 0.2, 0.3]) + noise[:, :3], turned.as_quat()])


def white(seed: int, count: int = COUNT) -> FloatArray:
    return SIGMA * np.random.default_rng(seed).normal(size=(count, 6))


@pytest.mark.parametrize("count", [1, 20])
def test_independent_noise_is_divided_by_the_number_of_scans(count: int) -> None:
    found = dwell_scatter(poses(white(1)), stamps(COUNT), count, "bag")
    np.testing.assert_allclose(np.diagonal(found.covariance), SIGMA**2 / count, rtol=0.1)
    assert found.freedoms == pytest.approx(1.5 * COUNT / count * (4.0 / 9.0 if count == 1 else 1.0), rel=0.01)
    assert not found.slow.any()


def test_the_degrees_of_freedom_are_those_of_the_scatter_of_the_variance() -> None:
    count, scans = 10, 400
    found = [dwell_scatter(poses(white(seed, scans)), stamps(scans), count, "bag") for seed in range(200)]
    variances = np.array([np.diagonal(each.covariance) for each in found])
    observed = 2.0 * np.mean(variances, axis=0) ** 2 / np.var(variances, axis=0)
    assert np.mean(observed) == pytest.approx(found[0].freedoms, rel=0.15)


def test_noise_that_lasts_for_some_scans_is_not_divided_by_the_number_of_scans() -> None:
    rho, count = 0.9, 100
    noise = lfilter([1.0], [1.0, -rho], white(2), axis=0) * math.sqrt(1.0 - rho**2)
    lags = np.arange(1, count)
    of_mean = SIGMA**2 / count * (1.0 + 2.0 * np.sum((1.0 - lags / count) * rho**lags))  # of independent series
    found = np.diagonal(dwell_scatter(poses(noise), stamps(COUNT), count, "bag").covariance)
    np.testing.assert_allclose(found, of_mean, rtol=0.35)
    assert found.min() > 10.0 * SIGMA**2 / count
    assert dwell_scatter(poses(noise), stamps(COUNT), 1, "bag").slow == pytest.approx(SIGMA, rel=0.1)


def test_a_slow_motion_is_named_and_not_in_the_scatter() -> None:
    noise = white(3, 4000)
    noise[:, 4] += 5e-6 * np.sin(np.linspace(0.0, 2.0 * math.pi, len(noise)))
    found = dwell_scatter(poses(noise), stamps(len(noise)), 1, "bag")
    np.testing.assert_allclose(np.diagonal(found.covariance), SIGMA**2, rtol=0.15)
    assert found.slow[4] == pytest.approx(5e-6 / math.sqrt(2.0), rel=0.05)
    assert not found.slow[[0, 1, 2, 3, 5]].any()


def test_means_do_not_reach_across_a_gap() -> None:
    noise, when = white(4, 2000), stamps(2000)
    noise[1000:, 0] += 1e-3  # moved meanwhile
    when[1000:] += 10**9
    found = dwell_scatter(poses(noise), when, 50, "bag")
    assert found.covariance[0, 0] == pytest.approx(SIGMA**2 / 50, rel=0.5)


def test_fewer_scans_than_two_means_are_refused() -> None:
    assert dwell_scatter(poses(white(5, 100)), stamps(100), 50, "bag").freedoms == pytest.approx(1.0, abs=0.1)
    with pytest.raises(BagError, match="no 102 of the 100 scans"):
        dwell_scatter(poses(white(5, 100)), stamps(100), 51, "bag")
