"""From scan to scan: the previous pose, prediction of the next one, and the prior where readings are blind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.model.reading_rows import AFFINE
from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import square

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

CLOCK_STEP_S = 1.0  # largest time by which a wrong stamp is behind the scan before; beyond, the clock was set
LONGEST_GAP = 3.5  # longest extrapolation of the motion, in intervals of the previous scans


@in_place
def turn_about_z(rotation: FloatArray, angle: float) -> None:
    """Turn a rotation about the target's own Z by ``angle`` [rad], in place."""
    c, s = math.cos(angle), math.sin(angle)
    for i in range(3):
        x, y = rotation[i, 0], rotation[i, 1]
        rotation[i, 0] = c * x + s * y
        rotation[i, 1] = c * y - s * x


@inlined
def copy_pose(source: Any, target: Any) -> None:
    """Copy a pose, records of dtype POSE or with the same fields."""
    for i in range(3):
        target.translation[i] = source.translation[i]
        for j in range(3):
            target.rotation[i, j] = source.rotation[i, j]


@in_place
def follow_time(tracker: Any, stamp: float, number: int) -> bool:
    """Return whether a scan comes after the one before; else its stamp is wrong.

    Where its number has not gone on either, a recording has started over: the previous pose is forgotten. Where time
    goes back by more than CLOCK_STEP_S, the clock was set: the previous pose stays, one interval before the scan.
    """
    goes_on, is_later = number > tracker.number, stamp > tracker.stamp
    if not tracker.initialised or is_later:
        tracker.number = number
        return True
    if goes_on and tracker.stamp - stamp <= CLOCK_STEP_S:
        return False
    tracker.number = number
    if goes_on and tracker.interval > 0.0:
        tracker.stamp, tracker.rejected_known = stamp - tracker.interval, 0
    else:
        forget_pose(tracker)
        tracker.theta = 0.0
    return True


@inlined
def forget_pose(tracker: Any) -> None:
    """Forget the previous pose and the count."""
    tracker.initialised = 0
    tracker.counted = 0


@inlined
def write_start(settings: Any, tracker: Any, stamp: float, pose: Any) -> None:
    """Write the start of a scan: the given one, or the previous pose, a counted theta extrapolated at the last rate."""
    if tracker.start_given:
        copy_pose(tracker.start, pose)
        return
    copy_pose(tracker.pose, pose)
    if settings.bump_angle > 0.0:
        turn_about_z(pose.rotation, tracker.theta_rate * (stamp - tracker.stamp))


@inlined
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


@inlined
def update_tracker(tracker: Any, pose: Any, stamp: float, theta: float, elapsed: float) -> None:
    """Keep a pose as the previous one; ``elapsed`` [s] since the one before, NaN: its motion is unknown."""
    tracker.interval = 0.0
    if elapsed > 0.0:
        tracker.interval = elapsed
        tracker.theta_rate = (theta - tracker.theta) / elapsed
        for i in range(3):
            tracker.velocity[i] = (pose.translation[i] - tracker.pose.translation[i]) / elapsed
    tracker.initialised = 1
    tracker.start_given = 0
    tracker.stamp = stamp
    tracker.theta = theta
    copy_pose(pose, tracker.pose)
