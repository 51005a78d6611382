# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Means, spreads and outliers of repeated readings of one pose; numbers only, no ROS.

A *unit* is read at once and kept or dropped as a whole: the voltage of one probe, or the four contact currents of one
diode, whose ratios are meaningful only if all four belong to the same moment.

Source: thesis 7.2, where each voltage is the mean of five readings without the outlier. Here a reading is
dropped only if a test shows that noise does not explain it. Dropping the most distant reading in any case would make
the mean of good readings noisier and the published spread too small.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

if TYPE_CHECKING:
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

SAMPLES_PER_OUTLIER = 5
"""At most one sample in this many is dropped as an outlier, as in 1985; at least one if there are three."""
MIN_SAMPLES = 3
"""With fewer samples no outlier can be found."""


@dataclass(frozen=True)
class SampleAverage:
    """Statistics of n samples of u units with w readings each."""

    means: FloatArray
    """Mean of the remaining samples, in the readings' unit, shape (u, w); NaN where no sample is finite."""
    spreads: FloatArray  # sample standard deviation of one reading, shape (u, w); NaN for a single reading
    weights: IntArray  # readings behind each sample that are averaged, shape (n, u)
    dropped: bool  # whether a sample of any unit was left out

    @property
    def counts(self) -> IntArray:
        """Readings averaged in each unit, shape (u,)."""
        return np.asarray(self.weights.sum(axis=0))


def average_samples(
    samples: FloatArray, counts: IntArray, spreads: FloatArray | None = None, significance: float | None = None
) -> SampleAverage:
    """Average samples, each of which may already be the mean of several readings.

    A sample with a reading that is not finite is left out of its unit. A unit without finite sample keeps all of them,
    so its mean is NaN.

    Args:
        samples: Shape (n, u, w), n at least 1.
        counts: Readings behind each sample, shape (n,), at least 1; the samples' weights.
        spreads: Standard deviation of those readings, shape (n, u, w); unused where the count is 1, and optional if all
            counts are 1.
        significance: Probability that a unit without outliers loses a sample, see ``find_outliers``; None: keep
            outliers.

    """
    valid: BoolArray = np.asarray(np.isfinite(samples).all(axis=2))
    unread: BoolArray = np.asarray(~valid.any(axis=0))
    if significance is not None:
        valid &= ~find_outliers(samples, valid, significance)
    valid[:, unread] = True
    weights = np.where(valid, counts[:, np.newaxis], 0)
    total = weights.sum(axis=0)
    used = np.where(valid[:, :, np.newaxis] & ~unread[:, np.newaxis], samples, 0.0)
    means = np.einsum("nu,nuw->uw", weights, used) / total[:, np.newaxis]
    means[unread] = np.nan
    squares = counts[:, np.newaxis, np.newaxis] * (used - means) ** 2
    if spreads is not None:
        several = counts > 1
        squares[several] += (counts[several] - 1)[:, np.newaxis, np.newaxis] * spreads[several] ** 2
    scatter = np.where(valid[:, :, np.newaxis], squares, 0.0).sum(axis=0)
    freedom = np.where(total > 1, total - 1.0, np.nan)
    return SampleAverage(means, np.sqrt(scatter / freedom[:, np.newaxis]), weights, bool(not valid.all()))


def find_outliers(samples: FloatArray, eligible: BoolArray, significance: float) -> BoolArray:
    """Return which samples are outliers, shape (n, u).

    Generalised extreme studentised deviate test (Rosner 1983; for one outlier the test of Grubbs 1969): the sample most
    distant from the mean, in standard deviations, is removed repeatedly, up to one in five. Outliers are all samples
    removed up to the last one whose distance normal noise does not explain. The distance of a unit of several readings
    is that of its most distant reading.

    Args:
        samples: Shape (n, u, w).
        eligible: Samples that count, all of them finite, shape (n, u).
        significance: Probability that a unit of normal noise loses a sample; an upper bound for a unit of several
            readings.

    """
    left = eligible.copy()
    outliers = np.zeros_like(left)
    removed = np.zeros_like(left)
    size, (_, units, width) = left.sum(axis=0), samples.shape
    limit = np.where(size >= MIN_SAMPLES, np.maximum(1, size // SAMPLES_PER_OUTLIER), 0)
    for step in range(int(limit.max(initial=0))):
        distances = _distances(samples, left)
        worst = distances.argmax(axis=0)
        is_tested = step < limit
        remaining = np.where(is_tested, size - step, MIN_SAMPLES)
        exceeds = is_tested & (distances[worst, np.arange(units)] > _critical_distance(remaining, significance / width))
        removed[worst[is_tested], np.flatnonzero(is_tested)] = True
        left &= ~removed
        outliers[:, exceeds] = removed[:, exceeds]
    return outliers


def _distances(samples: FloatArray, left: BoolArray) -> FloatArray:
    """Return the distance of each sample from the mean of those left, in standard deviations, shape (n, u)."""
    mask = left[:, :, np.newaxis]
    size = np.maximum(mask.sum(axis=0), 2)
    deviations = np.where(mask, samples, 0.0)
    deviations = np.where(mask, deviations - deviations.sum(axis=0) / size, 0.0)
    deviation = np.sqrt((deviations**2).sum(axis=0) / (size - 1))
    distances: FloatArray = (np.abs(deviations) / np.where(deviation > 0.0, deviation, np.inf)).max(axis=2)
    return distances


def _critical_distance(size: IntArray, significance: float) -> FloatArray:
    """Return the largest distance, in standard deviations, that noise explains among ``size`` samples."""
    quantile = stdtrit(size - 2, 1.0 - significance / (2.0 * size))
    critical: FloatArray = (size - 1) * quantile / np.sqrt((size - 2 + quantile**2) * size)
    return critical
