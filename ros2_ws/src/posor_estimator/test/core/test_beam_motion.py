from __future__ import annotations

import numpy as np
from posor_estimator.core.beam_motion import LEAST_SCANS, BeamMotion

PERIOD_NS = 5_000_000
ACCELERATION = np.array([1.5, -2.0, 0.25])
VELOCITY = np.array([0.3, 0.1, -0.2])


def centre(n: int) -> np.ndarray:
    t = n * PERIOD_NS * 1e-9
    return 0.7 + VELOCITY * t + 0.5 * ACCELERATION * t**2


def test_a_parabola_gives_its_acceleration() -> None:
    motion = BeamMotion(0.05)
    for n in range(30):
        if n != 20:  # a scan that gave no pose
            motion.take(n * PERIOD_NS, {"upper": centre(n), "fore": -centre(n)})
    found = motion.accelerations()
    np.testing.assert_allclose(found["upper"], ACCELERATION, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found["fore"], -ACCELERATION, rtol=0.0, atol=1e-9)


def test_too_few_scans_say_nothing() -> None:
    motion = BeamMotion(0.05)
    for n in range(LEAST_SCANS - 1):
        motion.take(n * PERIOD_NS, {"upper": centre(n)})
    assert motion.accelerations() == {}
    motion.take(LEAST_SCANS * PERIOD_NS, {"upper": centre(LEAST_SCANS)})
    assert set(motion.accelerations()) == {"upper"}


def test_what_is_older_than_the_window_is_forgotten() -> None:
    motion = BeamMotion(0.02)
    for n in range(LEAST_SCANS):
        motion.take(n * PERIOD_NS, {"upper": centre(n)})
    motion.take(1_000_000_000, {"upper": centre(200)})
    assert motion.accelerations() == {}


def test_stamps_that_go_back_begin_anew() -> None:
    motion = BeamMotion(0.05)
    for n in range(10, 20):
        motion.take(n * PERIOD_NS, {"upper": centre(n)})
    motion.take(0, {"upper": centre(0)})
    assert motion.accelerations() == {}
