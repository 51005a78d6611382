# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scatter of the transforms of a joint at rest, and of their means.

The variance of the mean of m successive scans is half the mean square difference of two means that follow one another,
the Allan variance with overlap. So it contains noise that lasts for some of the scans, which divided by m would seem
smaller, and no motion that is slow beside m scans. Source: W. J. Riley, *Handbook of Frequency Stability Analysis*,
NIST SP 1065, 2008, 5.2.4, and 5.4.1 for the degrees of freedom (white noise).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.errors import BagError
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray, IntArray

LONGEST_STEP = 1.5  # of the stamps between two scans that follow one another, medians
SLOW_RATIO = 2.0  # of the variance about the mean to that of successive scans, which independent scans do not reach
SLOW_SCANS = 50  # for which they do not


class DwellScatter(NamedTuple):
    """Scatter of the transforms of a joint at rest, ROS order, axes of the parent."""

    covariance: FloatArray  # of the mean of some scans, (6, 6)
    freedoms: float
    slow: FloatArray  # standard deviation of what changes slowly beside a mean [m], [rad], (6,); zero: nothing is known


def dwell_scatter(poses: FloatArray, stamps_ns: IntArray, count: int, where: str) -> DwellScatter:
    """Return the scatter of means of ``count`` scans at rest; ``poses``: (n, 7), ``where``: for errors.

    Raises BagError: too few scans follow one another.
    """
    steps = np.diff(stamps_ns)
    gaps = np.append(0, np.cumsum(steps > LONGEST_STEP * np.median(steps)))
    turns = Rotation.from_quat(poses[:, 3:])
    moved = np.hstack([poses[:, :3] - poses[0, :3], (turns * turns[0].inv()).as_rotvec()])
    sums = np.vstack([np.zeros(6), np.cumsum(moved, axis=0)])
    means = (sums[count:] - sums[:-count]) / count
    pairs = len(moved) - 2 * count + 1
    whole = gaps[2 * count - 1 :] == gaps[: max(pairs, 0)]
    if not whole.any():
        what = f"no {2 * count} of the {len(moved)} scans of the arm at --angles follow one another without a gap"
        raise BagError(what, where=where, expected="twice as many as --average")
    change = (means[count:] - means[:-count])[whole]
    covariance = 0.5 * change.T @ change / len(change)
    n = len(change) + 2 * count - 1
    freedoms = (1.5 * n / count - 2.0 * (n - 1) / (n + 1)) * 4.0 * count**2 / (4.0 * count**2 + 5.0)
    about_mean = np.var(means, axis=0, ddof=1) if len(means) > 1 else np.zeros(6)
    slow = np.where(about_mean > SLOW_RATIO * np.diagonal(covariance), about_mean - np.diagonal(covariance), 0.0)
    return DwellScatter(covariance, freedoms, np.sqrt(slow) if n >= SLOW_SCANS * count else np.zeros(6))
