# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Weights of the interpolation between frames: noise and error of the result."""

from __future__ import annotations

import numpy as np
import pytest
from posor_drivers.instruments.interpolation import frame_weights, interpolation_error


def intervals_and_offsets() -> list[tuple[float, float, float]]:
    """Return interval before, interval after, and offset within half of the interval that it lies in [s]."""
    ratios = np.geomspace(1e-3, 1e3, 13)
    intervals = [(min(1.0, ratio), min(1.0, 1.0 / ratio)) for ratio in ratios.tolist()]
    return [
        (before, after, float(offset))
        for before, after in intervals
        for offset in np.linspace(-0.5 * before, 0.5 * after, 21)
    ]


@pytest.mark.parametrize(("before", "after", "offset"), intervals_and_offsets())
def test_uniform_motion_is_exact_and_noise_that_of_one_frame(before: float, after: float, offset: float) -> None:
    weights = np.array(frame_weights(before, after, offset))
    times = np.array([-before, 0.0, after])
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert weights @ times == pytest.approx(offset, abs=1e-12)
    assert weights @ weights == pytest.approx(1.0, abs=1e-9)
    error = abs(weights @ (0.5 * times**2) - 0.5 * offset**2)
    assert error <= interpolation_error(1.0, 1.0) * (1.0 + 1e-9)


def test_a_frame_at_the_time_is_taken_alone() -> None:
    assert frame_weights(0.7, 1.3, 0.0) == (0.0, 1.0, 0.0)
