# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From scan to scan: the previous pose, the motion, prediction of the next pose, the prior where readings are blind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.model.reading_rows import AFFINE
from posor.numerics.compiled import in_place
from posor.numerics.vector import square, wrapped

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

RATE_MEMORY = 0.9  # share of the largest change of a rate that is kept from scan to scan
REGAIN_GAP = 4.5  # intervals since the last accepted pose in which motion is regained and a count kept: 3 bad scans
REGAIN_S = 0.02  # least time within which motion is regained [s]: a burst of disturbances, a device that pauses
FIRST_GAP_S = 0.2  # time in which a count is kept where no interval is known [s], as at the second scan without numbers
COUNTED_SHARE = 0.75  # of a period: ``check_count`` sees a departure from the extrapolated theta that is smaller
LONGEST_GAP = 3.5  # longest extrapolation of the motion, in intervals of the previous scans


@in_place
def turn_about_z(rotation: FloatArray, angle: float) -> None:
    """Turn a rotation about the target's own Z by ``angle`` [rad], in place."""
    c, s = math.cos(angle), math.sin(angle)
    for i in range(3):
        x, y = rotation[i, 0], rotation[i, 1]
        rotation[i, 0] = c * x + s * y
        rotation[i, 1] = c * y - s * x


@in_place
def copy_pose(source: Any, target: Any) -> None:
    """Copy a pose, records of dtype POSE or with the same fields."""
    for i in range(3):
        target.translation[i] = source.translation[i]
        for j in range(3):
            target.rotation[i, j] = source.rotation[i, j]


@in_place
def forget_pose(tracker: Any) -> None:
    """Forget the previous pose, the count, and the home marks that agreed with them."""
    tracker.initialised = 0
    tracker.counted = 0
    tracker.marks = 0


@in_place
def count_is_stale(settings: Any, tracker: Any, elapsed: float) -> bool:
    """Return whether theta may be a period off because the last pose is too old: UNCOUNTED, not a fault.

    Theta departs from its extrapolation by at most ``A t (t + d) / 2``, A the largest acceleration, d the interval over
    which the rate was found. Without a limit of the motion, theta is extrapolated over any time.
    """
    interval = tracker.interval if tracker.interval > 0.0 else tracker.clocks.period
    followed_for = REGAIN_GAP * interval if interval > 0.0 else FIRST_GAP_S
    if elapsed <= followed_for:
        limit = 2.0 * COUNTED_SHARE * settings.period / settings.max_theta_acceleration  # zero: not stated
        if not 0.0 < limit < elapsed * (elapsed + interval):
            return False
    return bool(0.5 * settings.period < settings.max_theta_rate * elapsed < math.inf)


@in_place
def needs_start(settings: Any, tracker: Any) -> bool:
    """Return whether a scan needs a start in closed form: no pose is known, or the phase of its bumps is not.

    While latched, the phase is not looked for.
    """
    if tracker.start_given:
        return False
    lost_phase = settings.bump_angle > 0.0 and tracker.latch == 0
    lost_phase = lost_phase and count_is_stale(settings, tracker, tracker.time - tracker.stamp)
    return bool(not tracker.initialised or lost_phase)


@in_place
def write_start(settings: Any, tracker: Any, pose: Any) -> None:
    """Write the start of a scan: the given one, or the previous pose, a counted theta extrapolated at the last rate."""
    if tracker.start_given:
        copy_pose(tracker.start, pose)
        return
    copy_pose(tracker.pose, pose)
    if settings.bump_angle > 0.0:
        turn_about_z(pose.rotation, tracker.theta_rate * (tracker.time - tracker.stamp))


@in_place
def predict(settings: Any, tracker: Any, elapsed: float, pose: Any) -> None:
    """Move a start from ``write_start`` on as the target moved before, for ``elapsed`` [s], if that was recent enough.

    The solution is then near and found in fewer iterations.
    """
    if not elapsed <= LONGEST_GAP * tracker.interval:
        return
    for i in range(3):
        pose.translation[i] += tracker.velocity[i] * elapsed
    if settings.bump_angle == 0.0:
        turn_about_z(pose.rotation, tracker.theta_rate * elapsed)


@in_place
def add_prior(workspace: Any, first: int, elapsed: float) -> None:
    """Make rows ``first`` to ``first + 6`` state that the pose is at the start, with the largest motion as spread."""
    settings = workspace.settings
    for i in range(6):
        row = workspace.rows[first + i]
        row.kind = AFFINE
        row.value = 0.0
        for k in range(6):
            row.derivative[k] = 0.0
        row.derivative[i] = 1.0
        workspace.values[first + i] = 0.0
        rate = settings.max_velocity if i < 3 else settings.max_lean_rate  # noqa: PLR2004  translation first
        if i == 5:  # noqa: PLR2004  about Z
            rate = settings.max_theta_rate
        workspace.weights[first + i] = 1.0 / square(rate * elapsed)


@in_place
def rate_is_known(tracker: Any, elapsed: float) -> bool:
    """Return whether the motion is known ``elapsed`` [s] after the previous pose."""
    known = tracker.initialised and not tracker.start_given and tracker.interval > 0.0
    return bool(known and elapsed <= LONGEST_GAP * tracker.interval)


@in_place
def uniform_sigma(largest: float) -> float:
    """Return the standard uncertainty of a rate within a motion limit; zero where the motion is not limited."""
    return largest / math.sqrt(3.0) if largest < math.inf else 0.0


@in_place
def write_twist(workspace: Any, elapsed: float) -> None:
    """Write the twist of the target and its standard uncertainties, ROS order, ``elapsed`` [s] after the previous pose.

    The inclinations hardly change; their rates are taken as zero. An unknown rate is taken as zero too, with the
    uncertainty of a uniform distribution over the largest motion, or zero where the calibration states no limit.
    """
    settings, tracker, rotation = workspace.settings, workspace.tracker, workspace.pose.rotation
    known = rate_is_known(tracker, elapsed)
    turn, turn_sigma = tracker.theta_rate, tracker.rate_sigmas[3]
    if not known:
        turn, turn_sigma = 0.0, uniform_sigma(settings.max_theta_rate)
    for i in range(3):
        workspace.twist[i], workspace.twist_sigmas[i] = tracker.velocity[i], tracker.rate_sigmas[i]
        if not known:
            workspace.twist[i], workspace.twist_sigmas[i] = 0.0, uniform_sigma(settings.max_velocity)
        workspace.twist[3 + i], workspace.twist_sigmas[3 + i] = turn * rotation[i, 2], turn_sigma * abs(rotation[i, 2])


@in_place
def renew_twist(workspace: Any, theta: float, elapsed: float) -> None:
    """Write the twist over the last interval; its change from that before is part of the uncertainty."""
    previous, pose = workspace.tracker.pose, workspace.pose
    turn = wrapped(theta - workspace.tracker.theta)
    for i in range(6):
        moved = turn * pose.rotation[i - 3, 2] if i >= 3 else pose.translation[i] - previous.translation[i]  # noqa: PLR2004  translation first
        change = moved / elapsed - workspace.twist[i]
        workspace.twist[i] += change
        workspace.twist_sigmas[i] = max(abs(change), workspace.twist_sigmas[i])


@in_place
def _update_rate(tracker: Any, i: int, rate: float, former: float) -> float:
    """Return a rate; write its standard uncertainty: its largest change in the last scans, of a first rate itself."""
    kept = RATE_MEMORY * tracker.rate_sigmas[i] if tracker.rates > 1 else 0.0
    tracker.rate_sigmas[i] = max(abs(rate - former), kept) if tracker.rates > 0 else abs(rate)
    return rate


@in_place
def update_tracker(tracker: Any, pose: Any, theta: float, elapsed: float) -> None:
    """Keep a pose as the previous one; ``elapsed`` [s] since the one before, NaN: its motion is unknown."""
    tracker.rates = tracker.rates if tracker.interval > 0.0 else 0
    tracker.interval = 0.0
    if elapsed > 0.0:
        tracker.interval = elapsed
        tracker.theta_rate = _update_rate(tracker, 3, (theta - tracker.theta) / elapsed, tracker.theta_rate)
        for i in range(3):
            rate = (pose.translation[i] - tracker.pose.translation[i]) / elapsed
            tracker.velocity[i] = _update_rate(tracker, i, rate, tracker.velocity[i])
        tracker.rates += 1
    tracker.initialised = 1
    tracker.start_given = 0
    tracker.stamp = tracker.time
    tracker.theta = theta
    copy_pose(pose, tracker.pose)
