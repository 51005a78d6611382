# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Largest error of a pose by the largest error of its stamp.

A stamp that is wrong by at most L displaces the pose along its motion. Let r be the mean rate along or about an axis
over the last interval d, A the largest acceleration and V the largest velocity that the calibration states. The rate is
within ``A d / 2`` of r at the present pose, and changes by at most ``A L`` within L, so the displacement is at most

    min(L V, L (|r| + A (d + L) / 2) + n),

without a stated acceleration or a previous pose L V, without motion limits infinite. The noise n of the rate is
``NOISE_SIGMAS s L / d`` for a pose with the random standard deviation s, so that the bound holds beside the coverage
factor of the protection level.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import cross, minus, wrapped

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector

NOISE_SIGMAS = 5.0 * math.sqrt(2.0)  # of the difference of two poses


@inlined
def _axis_of(rotation: FloatArray) -> Vector:
    """Return the target's Z axis."""
    return rotation[0, 2], rotation[1, 2], rotation[2, 2]


@inlined
def _largest_shift(
    limit: float, elapsed: float, fastest: float, acceleration: float, moved: float, noise: float
) -> float:
    """Return the largest displacement within ``limit`` [s] after a motion in ``elapsed`` [s]; NaN: unknown."""
    if not elapsed > 0.0:
        return limit * fastest
    after = limit * (abs(moved) / elapsed + 0.5 * acceleration * (elapsed + limit))
    return min(limit * fastest, after + NOISE_SIGMAS * noise * limit / elapsed)


@in_place
def write_stamp_shift(workspace: Any, limit: float, theta: float, elapsed: float, estimate: Any) -> None:
    """Write the largest error of the pose in the workspace by a stamp that is wrong by up to ``limit`` [s].

    ``theta``: of the pose [rad]; ``elapsed``: time since the tracker's pose [s], NaN: the motion from there is unknown;
    ``estimate``: record of dtype ESTIMATE, its ``stamp_shift`` is written: ROS order, axes of the parent [m], [rad].
    """
    settings, previous, pose = workspace.settings, workspace.tracker.pose, workspace.pose
    axis = _axis_of(pose.rotation)
    spin = wrapped(theta - workspace.tracker.theta)
    lean = cross(axis, minus(axis, _axis_of(previous.rotation)))
    for k in range(3):
        fastest, acceleration = settings.max_lean_rate, settings.max_lean_acceleration
        if axis[k] != 0.0:
            fastest += settings.max_theta_rate * abs(axis[k])
            acceleration += settings.max_theta_acceleration * abs(axis[k])
        noise = math.sqrt(estimate.random[3 + k, 3 + k])
        moved = spin * axis[k] + lean[k]
        estimate.stamp_shift[3 + k] = _largest_shift(limit, elapsed, fastest, acceleration, moved, noise)
        fastest, acceleration = settings.max_velocity, settings.max_acceleration
        noise = math.sqrt(estimate.random[k, k])
        moved = pose.translation[k] - previous.translation[k]
        estimate.stamp_shift[k] = _largest_shift(limit, elapsed, fastest, acceleration, moved, noise)
