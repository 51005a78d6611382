# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interpolation between three frames of a device whose noise is that of one frame at every time.

The mean of two frames has less noise than one frame, by a factor from 0.71 to 1 that depends on where the time lies
between them. A calibration states one noise for all scans, so linear interpolation would make the stated covariance too
large by a factor that drifts with the clock of the device. The weights here are the ones that are exact for uniform
motion, that sum to one, and whose squares sum to one. The published covariance is then right at every phase.
"""

from __future__ import annotations

import math
from typing import NamedTuple

MOST_WEIGHT = 5.0 / 3.0
"""Largest sum of the absolute values of the weights."""
ERROR_FACTOR = 0.125
"""Largest error of an interpolated value, per acceleration of the value and square of the longer interval."""


class FrameWeights(NamedTuple):
    """Weights of three consecutive frames."""

    before: float
    nearest: float
    after: float


def frame_weights(since_before: float, until_after: float, offset: float) -> FrameWeights:
    """Return the weights of the frames around a time; the solution with the least weight of the outer frames.

    Args:
        since_before: Time from the frame before to the nearest frame, more than 0.
        until_after: Time from the nearest frame to the one after, more than 0.
        offset: Time from the nearest frame to the wanted time, at most half of the interval that it lies in.

    """
    interval, shift = since_before / until_after, offset / until_after
    # With after = shift + interval * before and nearest = 1 - before - after, the squares sum to one where
    # a before^2 + b before + c = 0.
    a = 1.0 + interval * interval + (1.0 + interval) ** 2
    b = 2.0 * interval * shift - 2.0 * (1.0 - shift) * (1.0 + interval)
    c = 2.0 * shift * (shift - 1.0)
    before = (-b - math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    after = shift + interval * before
    return FrameWeights(before, 1.0 - before - after, after)


def interpolation_error(acceleration: float, interval: float) -> float:
    """Return the largest error of a value by its largest ``acceleration``, such as [V/s^2], and frame interval [s]."""
    return ERROR_FACTOR * acceleration * interval * interval
