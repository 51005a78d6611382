from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import polynomial
from posor_estimator.core.beam_motion import ROOM, BeamMotion
from posor_estimator.core.kernels import chain_motion as kernel
from posor_estimator.core.kernels.chain_motion import LEAST_SCANS

PERIOD_NS = 5_000_000
ACCELERATION = np.array([1.5, -2.0, 0.25])
VELOCITY = np.array([0.3, 0.1, -0.2])
NONE = np.zeros((1, 3))


def centre(n: int) -> np.ndarray:
    t = n * PERIOD_NS * 1e-9
    return 0.7 + VELOCITY * t + 0.5 * ACCELERATION * t**2


class Motion(BeamMotion):
    """Does with one scan after the other what the chain's loop does."""

    def take(self, stamp_ns: int, centres: np.ndarray) -> None:
        kernel.begin_anew(stamp_ns, self.kept, self.seen_ns)
        if not kernel.has_room(self.kept, self.seen_ns, self.seen):
            self.make_room()
        kernel.take(stamp_ns, np.ravel(centres), self.kept, self.seen_ns, self.seen)

    def accelerations(self) -> np.ndarray:
        found = np.empty(self.seen.shape[1])
        kernel.accelerations(self.kept, self.seen_ns, self.seen, found)
        return found.reshape(-1, 3)


def test_a_parabola_gives_its_acceleration() -> None:
    motion = Motion(0.05, 2)
    for n in range(30):
        if n != 20:  # a scan that gave no pose
            motion.take(n * PERIOD_NS, np.array([centre(n), -centre(n)]))
    np.testing.assert_allclose(motion.accelerations(), [ACCELERATION, -ACCELERATION], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scans", [LEAST_SCANS, 2 * ROOM, 5 * ROOM])
def test_the_parabola_is_that_of_least_squares(scans: int, rng: np.random.Generator) -> None:
    """Noise, and stamps that are anywhere; the window holds more scans than there is room for at first."""
    stamps = np.cumsum(rng.integers(1, PERIOD_NS, 3 * scans))
    span = int(stamps[-1] - stamps[-scans])
    centres = rng.normal(size=(len(stamps), 1, 3))
    motion = Motion(span * 1e-9, 1)
    for stamp, at in zip(stamps, centres, strict=True):
        motion.take(int(stamp), at)
    seconds = (stamps[-scans:] - stamps[-scans]) / span
    expected = 2.0 * polynomial.polyfit(seconds, centres[-scans:, 0], 2)[2] / (span * 1e-9) ** 2
    np.testing.assert_allclose(motion.accelerations()[0], expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


def test_too_few_scans_say_nothing() -> None:
    motion = Motion(0.05, 1)
    for n in range(LEAST_SCANS - 1):
        motion.take(n * PERIOD_NS, centre(n)[None])
    np.testing.assert_array_equal(motion.accelerations(), NONE)
    motion.take(LEAST_SCANS * PERIOD_NS, centre(LEAST_SCANS)[None])
    assert np.all(motion.accelerations() != 0.0)


def test_what_is_older_than_the_window_is_forgotten() -> None:
    motion = Motion(0.02, 1)
    for n in range(LEAST_SCANS):
        motion.take(n * PERIOD_NS, centre(n)[None])
    motion.take(1_000_000_000, centre(200)[None])
    np.testing.assert_array_equal(motion.accelerations(), NONE)


def test_stamps_that_go_back_begin_anew() -> None:
    motion = Motion(0.05, 1)
    for n in range(10, 20):
        motion.take(n * PERIOD_NS, centre(n)[None])
    motion.take(0, centre(0)[None])
    np.testing.assert_array_equal(motion.accelerations(), NONE)
