# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import polynomial
from posor.chain.beam_acceleration import (
    INITIAL_CAPACITY,
    MINIMUM_SCANS,
    BeamHistory,
    append_centres,
    estimate_accelerations,
    forget_after_gap,
    has_free_row,
)

PERIOD_NS = 5_000_000
ACCELERATION = np.array([1.5, -2.0, 0.25])
VELOCITY = np.array([0.3, 0.1, -0.2])
NONE = np.zeros((1, 3))


def centre(n: int) -> np.ndarray:
    t = n * PERIOD_NS * 1e-9
    return 0.7 + VELOCITY * t + 0.5 * ACCELERATION * t**2


class BeamMotion:
    """Updates a history as the kernel does for each scan."""

    def __init__(self, window_s: float, beams: int) -> None:
        self.history = BeamHistory.allocate(window_s, beams)

    def append(self, stamp_ns: int, centres: np.ndarray) -> None:
        forget_after_gap(stamp_ns, self.history)
        if not has_free_row(self.history):
            self.history = self.history.enlarged()
        self.history.centres[:] = np.ravel(centres)
        append_centres(stamp_ns, self.history)

    def accelerations(self) -> np.ndarray:
        estimate_accelerations(self.history)
        return self.history.accelerations.reshape(-1, 3)


def test_a_parabola_gives_its_acceleration() -> None:
    motion = BeamMotion(0.05, 2)
    for n in range(30):
        if n != 20:  # a scan that gave no pose
            motion.append(n * PERIOD_NS, np.array([centre(n), -centre(n)]))
    np.testing.assert_allclose(motion.accelerations(), [ACCELERATION, -ACCELERATION], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scans", [MINIMUM_SCANS, 2 * INITIAL_CAPACITY, 5 * INITIAL_CAPACITY])
def test_the_parabola_is_that_of_least_squares(scans: int, rng: np.random.Generator) -> None:
    """Noise, and stamps that are anywhere; the window holds more scans than there is room for at first."""
    stamps = np.cumsum(rng.integers(1, PERIOD_NS, 3 * scans))
    span = int(stamps[-1] - stamps[-scans])
    centres = rng.normal(size=(len(stamps), 1, 3))
    motion = BeamMotion(span * 1e-9, 1)
    for stamp, at in zip(stamps, centres, strict=True):
        motion.append(int(stamp), at)
    seconds = (stamps[-scans:] - stamps[-scans]) / span
    expected = 2.0 * polynomial.polyfit(seconds, centres[-scans:, 0], 2)[2] / (span * 1e-9) ** 2
    np.testing.assert_allclose(motion.accelerations()[0], expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_too_few_scans_give_zero() -> None:
    motion = BeamMotion(0.05, 1)
    for n in range(MINIMUM_SCANS - 1):
        motion.append(n * PERIOD_NS, centre(n)[None])
    np.testing.assert_array_equal(motion.accelerations(), NONE)
    motion.append(MINIMUM_SCANS * PERIOD_NS, centre(MINIMUM_SCANS)[None])
    assert np.all(motion.accelerations() != 0.0)


@pytest.mark.parametrize(
    ("window_s", "scans", "last"),
    [(0.02, range(MINIMUM_SCANS), 200), (0.05, range(10, 20), 0)],
    ids=["scans before the window", "stamps that go back"],
)
def test_old_scans_are_forgotten(window_s: float, scans: range, last: int) -> None:
    motion = BeamMotion(window_s, 1)
    for n in (*scans, last):
        motion.append(n * PERIOD_NS, centre(n)[None])
    np.testing.assert_array_equal(motion.accelerations(), NONE)
