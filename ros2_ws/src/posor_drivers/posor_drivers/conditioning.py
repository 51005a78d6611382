"""Averages repeated readings of one pose, and tells outliers from noise. Numbers only, no ROS.

A *unit* is what is read at once and is kept or dropped as a whole: the voltage of one probe, or the four contact
currents of one diode, whose ratios mean something only if all four belong to the same moment.

Source: thesis 7.5 and 8.2, where each voltage is the mean of five readings of which the outlier is dropped. Here a
reading is dropped only if a test says that noise does not explain it. To drop the most distant one always would make
the mean of good readings noisier, the published spread too small, and the flag that tells of it worthless.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int64]
    BoolArray = NDArray[np.bool_]

ONE_IN = 5
"""At most one sample in this many is dropped as an outlier, as in 1985; at least one where there are three."""
LEAST_SAMPLES = 3
"""With fewer samples none can be told from the others."""


@dataclass(frozen=True)
class Average:
    """What remains of n samples of u units with w readings each.

    Attributes:
        means: Mean of the samples kept, in the readings' unit, shape (u, w); NaN where no sample is finite.
        spreads: Sample standard deviation of one reading, shape (u, w); NaN where it rests on one reading only.
        counts: Readings averaged in each unit, shape (u,).
        dropped: Whether a sample of any unit was left out.

    """

    means: FloatArray
    spreads: FloatArray
    counts: IntArray
    dropped: bool


def average(
    samples: FloatArray, counts: IntArray, spreads: FloatArray | None = None, significance: float | None = None
) -> Average:
    """Average samples, each of which may already be the mean of several readings.

    A sample with a reading that is not finite is left out of its unit. Where a unit has no finite sample none is left
    out, so that its mean is NaN.

    Args:
        samples: Shape (n, u, w), n at least 1.
        counts: Readings behind each sample, shape (n,), at least 1; the samples' weights.
        spreads: Standard deviation of those readings, shape (n, u, w); not used where the count is 1, and may be left
            out where all are 1.
        significance: Probability that a unit without outliers loses a sample, see ``outliers``; None: keep outliers.

    """
    kept: BoolArray = np.asarray(np.isfinite(samples).all(axis=2))
    unread: BoolArray = np.asarray(~kept.any(axis=0))
    if significance is not None:
        kept &= ~outliers(samples, kept, significance)
    kept[:, unread] = True
    weights = np.where(kept, counts[:, np.newaxis], 0)
    total = weights.sum(axis=0)
    used = np.where(kept[:, :, np.newaxis] & ~unread[:, np.newaxis], samples, 0.0)
    means = np.einsum("nu,nuw->uw", weights, used) / total[:, np.newaxis]
    means[unread] = np.nan
    squares = counts[:, np.newaxis, np.newaxis] * (used - means) ** 2
    if spreads is not None:
        several = counts > 1
        squares[several] += (counts[several] - 1)[:, np.newaxis, np.newaxis] * spreads[several] ** 2
    scatter = np.where(kept[:, :, np.newaxis], squares, 0.0).sum(axis=0)
    freedom = np.where(total > 1, total - 1.0, np.nan)
    return Average(means, np.sqrt(scatter / freedom[:, np.newaxis]), total, bool(not kept.all()))


def outliers(samples: FloatArray, eligible: BoolArray, significance: float) -> BoolArray:
    """Return which samples are outliers, shape (n, u).

    The generalised extreme studentised deviate test (Rosner 1983; for one outlier the test of Grubbs 1969): the sample
    most distant from the mean, in standard deviations, is taken away, and so on, up to one in five; outliers are all
    those taken away until the last one that was more distant than normal noise explains. A unit of several readings
    is as distant as the most distant of them.

    Args:
        samples: Shape (n, u, w).
        eligible: Samples that count, all of them finite, shape (n, u).
        significance: Probability that a unit of normal noise loses a sample; an upper bound for a unit of several
            readings.

    """
    left = eligible.copy()
    found = np.zeros_like(left)
    taken = np.zeros_like(left)
    size, (_, units, width) = left.sum(axis=0), samples.shape
    most = np.where(size >= LEAST_SAMPLES, np.maximum(1, size // ONE_IN), 0)
    for step in range(int(most.max(initial=0))):
        distances = _distances(samples, left)
        worst = distances.argmax(axis=0)
        is_tested = step < most
        remaining = np.where(is_tested, size - step, LEAST_SAMPLES)
        exceeds = is_tested & (distances[worst, np.arange(units)] > _critical(remaining, significance / width))
        taken[worst[is_tested], np.flatnonzero(is_tested)] = True
        left &= ~taken
        found[:, exceeds] = taken[:, exceeds]
    return found


def _distances(samples: FloatArray, left: BoolArray) -> FloatArray:
    """Return how many standard deviations each sample is from the mean of those left, shape (n, u)."""
    mask = left[:, :, np.newaxis]
    size = np.maximum(mask.sum(axis=0), 2)
    deviations = np.where(mask, samples, 0.0)
    deviations = np.where(mask, deviations - deviations.sum(axis=0) / size, 0.0)
    deviation = np.sqrt((deviations**2).sum(axis=0) / (size - 1))
    distances: FloatArray = (np.abs(deviations) / np.where(deviation > 0.0, deviation, np.inf)).max(axis=2)
    return distances


def _critical(size: IntArray, significance: float) -> FloatArray:
    """Return the largest distance, in standard deviations, that noise explains among ``size`` samples."""
    quantile = stdtrit(size - 2, 1.0 - significance / (2.0 * size))
    critical: FloatArray = (size - 1) * quantile / np.sqrt((size - 2 + quantile**2) * size)
    return critical
