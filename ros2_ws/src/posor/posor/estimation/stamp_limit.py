"""Largest error of a pose by the largest error of its stamp.

A stamp that is wrong by at most L displaces the pose along its motion, along and about each axis by at most

    |twist| L + |acceleration| L^2 / 2 + |jerk| L^3 / 6.

They follow from the poses of successive scans by triple exponential smoothing (R. G. Brown, *Smoothing, Forecasting and
Prediction of Discrete Time Series*, 1963). With the mean rate r over the last interval d, the memory T = 2 max(L, d)
and the gain g = d / (d + T):

    s1 += g (r - s1),  s2 += g (s1 - s2),  s3 += g (s2 - s3),
    jerk = (s1 - 2 s2 + s3) / T^2,  acceleration = (s1 - s2) / T + 2 T jerk,
    twist = 3 s1 - 3 s2 + s3 + acceleration d / 2.

The memory limits what the noise of the poses adds to 1.9 of its standard deviations s. The bound is wider by
NOISE_SIGMAS s min(1, L / d), so that it holds beside the coverage factor of the protection level, 4.4. A motion that
begins within L is not seen. Where the motion has been followed for less than SETTLED memories, the motion limits of the
calibration times L are the bound, infinite without motion limits; but for the noise, the bound never exceeds them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.tracking import LONGEST_GAP
from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import cross, minus, square, wrapped

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector

NOISE_SIGMAS = 5.0  # 4.4 (sqrt(1 + 1.9^2) - 1)
SETTLED = 6.0  # memories after which the smoothed rates are used


@inlined
def _axis_of(rotation: FloatArray) -> Vector:
    """Return the target's Z axis."""
    return rotation[0, 2], rotation[1, 2], rotation[2, 2]


@inlined
def _smooth(motion: Any, i: int, rate: float, gain: float) -> None:
    motion.once[i] += gain * (rate - motion.once[i])
    motion.twice[i] += gain * (motion.once[i] - motion.twice[i])
    motion.thrice[i] += gain * (motion.twice[i] - motion.thrice[i])


@inlined
def _moved(motion: Any, i: int, limit: float, elapsed: float, memory: float) -> float:
    """Return the largest motion of coordinate i within ``limit`` [s]; infinite while the rates settle."""
    if not motion.followed >= SETTLED * memory:
        return math.inf
    once, twice, thrice = motion.once[i], motion.twice[i], motion.thrice[i]
    jerk = (once - 2.0 * twice + thrice) / square(memory)
    acceleration = (once - twice) / memory + 2.0 * memory * jerk
    twist = 3.0 * (once - twice) + thrice + 0.5 * elapsed * acceleration
    return float(limit * (abs(twist) + limit * (abs(acceleration) / 2.0 + limit * abs(jerk) / 6.0)))


@in_place
def write_stamp_shift(workspace: Any, limit: float, theta: float, elapsed: float, estimate: Any) -> None:
    """Write the largest error of the pose in the workspace by a stamp that is wrong by up to ``limit`` [s].

    ``theta``: of the pose [rad]; ``elapsed``: time since the tracker's pose [s], NaN: the motion from there is unknown;
    ``estimate``: record of dtype ESTIMATE, its ``stamp_shift`` is written: ROS order, axes of the parent [m], [rad].
    """
    settings, tracker, pose = workspace.settings, workspace.tracker, workspace.pose
    motion, axis = tracker.motion, _axis_of(pose.rotation)
    longest = max(limit, elapsed) if elapsed > 0.0 else limit
    memory, noise = 2.0 * longest, NOISE_SIGMAS * limit / longest
    if not elapsed <= LONGEST_GAP * tracker.interval:
        motion.followed = 0.0
    if elapsed > 0.0:
        gain = elapsed / (elapsed + memory) if motion.followed > 0.0 else 1.0
        motion.followed += elapsed
        spin = wrapped(theta - tracker.theta) / elapsed
        lean = cross(axis, minus(axis, _axis_of(tracker.pose.rotation)))
        for k in range(3):
            _smooth(motion, k, (pose.translation[k] - tracker.pose.translation[k]) / elapsed, gain)
            _smooth(motion, 3 + k, spin * axis[k] + lean[k] / elapsed, gain)
    for k in range(3):
        turn = math.inf
        if settings.max_theta_rate < math.inf:
            turn = limit * (settings.max_lean_rate + settings.max_theta_rate * abs(axis[k]))
        estimate.stamp_shift[k] = min(limit * settings.max_velocity, _moved(motion, k, limit, elapsed, memory))
        estimate.stamp_shift[3 + k] = min(turn, _moved(motion, 3 + k, limit, elapsed, memory))
    for i in range(6):
        estimate.stamp_shift[i] += noise * math.sqrt(estimate.random[i, i])
