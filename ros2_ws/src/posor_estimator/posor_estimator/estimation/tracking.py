"""From scan to scan: prediction of the next pose, motion gate, latch, prior where readings are blind, counting.

A fault latches the joint. REGAINABLE_FAULTS hold the tracker at the last accepted pose. They are released where one of
the next scans regains the extrapolated motion within the gate of one scan interval, by a jump back from the poses
rejected meanwhile. Waiting does not widen this gate: later, only a reference of theta releases a latch that is about
theta, or an operator any latch. Where a home mark or an encoder disagrees, the tracker goes on, and the reference
releases the latch.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_estimator.model.fault import Fault
from posor_estimator.model.reading_rows import AFFINE
from posor_estimator.numerics.compiled import in_place, inlined
from posor_estimator.numerics.vector import square

if TYPE_CHECKING:
    from posor_estimator.numerics.array_types import FloatArray

LONGEST_GAP = 3.5
"""Longest extrapolation of the motion, in intervals of the previous scans."""
REGAIN_GAP = 4.5
"""Intervals after the last accepted pose within which the motion is regained: up to three bad scans in a row."""
MARKS = 6
"""Consecutive scans with agreeing home marks that count theta; as many disagreeing marks are not taken for spurious."""
RESIDUAL_RUN = 10
"""Scans in a row that fail the residual test before the joint is latched, and that pass it before it is released."""
REFERENCE_SIGMAS = 5.0
"""Standard deviations within which a reference of theta agrees."""
REGAINABLE_FAULTS = int(Fault.INNOVATION | Fault.SOURCE | Fault.FROZEN)
"""Faults whose latch a pose that goes on from the earlier motion releases."""
NOISE_ALLOWANCE = 5.0
"""Standard deviations of noise that are added to the largest motion before a jump is a fault."""


@inlined
def wrapped(angle: float) -> float:
    """Return the angle [rad] in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@inlined
def theta_of(rotation: FloatArray) -> float:
    """Return the heading of the Y axis of T in R [rad] (``model.native_coordinates``)."""
    return math.atan2(-rotation[0, 1], rotation[1, 1])


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
def restart_where_time_goes_back(tracker: Any, stamp: float) -> None:
    """Forget the previous pose where time has not gone on: a replay has started over."""
    if tracker.initialised and not stamp > tracker.stamp:
        forget_pose(tracker)
        tracker.theta = 0.0


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
def motion_gate(workspace: Any, previous: Any, elapsed: float, covariance: FloatArray) -> tuple[float, float]:
    """Return the distance of the pose from another one as a share of the largest possible motion: position, theta."""
    settings, pose = workspace.settings, workspace.pose
    largest = 0.0
    for i in range(3):
        allowed = settings.max_velocity * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * covariance[i, i])
        largest = max(largest, abs(pose.translation[i] - previous.translation[i]) / allowed)
    for i in range(2):
        leaned = abs(pose.rotation[i, 2] - previous.rotation[i, 2])
        spread = covariance[4, 4] if i == 0 else covariance[3, 3]
        allowed = settings.max_lean_rate * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * spread)
        largest = max(largest, leaned / allowed)
    turned = abs(wrapped(theta_of(pose.rotation) - theta_of(previous.rotation)))
    allowed = settings.max_theta_rate * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * covariance[5, 5])
    return largest, turned / allowed


@in_place
def latch(tracker: Any, faults: int, about_theta: int, elapsed: float) -> None:
    """Keep the joint out; ``elapsed`` [s] since the last accepted pose, ``about_theta``: a reference may release it."""
    if faults & REGAINABLE_FAULTS and tracker.latch & REGAINABLE_FAULTS == 0:
        tracker.latch_interval = tracker.interval
        if elapsed > 0.0 and (tracker.interval <= 0.0 or elapsed < tracker.interval):
            tracker.latch_interval = elapsed
        tracker.rejected_known = 0
    if tracker.latch == 0:
        tracker.latch_about_theta = 1
    tracker.latch |= faults
    tracker.latch_about_theta &= about_theta


@inlined
def count_is_stale(settings: Any, tracker: Any, elapsed: float) -> bool:
    """Return whether no scan was accepted for so long that theta can be half a period off: UNCOUNTED, no fault."""
    unseen = elapsed > REGAIN_GAP * tracker.interval and tracker.interval > 0.0
    return bool(unseen and settings.max_theta_rate * elapsed > 0.5 * settings.period)


@inlined
def is_regained(workspace: Any, stamp: float, covariance: FloatArray) -> bool:
    """Return whether the pose goes on from the last accepted pose, and not from one that was rejected since."""
    tracker, centre = workspace.tracker, workspace.start_pose
    elapsed, interval = stamp - tracker.stamp, tracker.latch_interval
    if not tracker.initialised or elapsed > REGAIN_GAP * interval:
        return False
    if tracker.rejected_known:
        position, theta = motion_gate(workspace, tracker.rejected, stamp - tracker.rejected_stamp, covariance)
        if max(position, theta) <= 1.0:
            return False
    copy_pose(tracker.pose, centre)
    if tracker.interval > 0.0:
        moved = min(elapsed, LONGEST_GAP * interval)
        turn_about_z(centre.rotation, tracker.theta_rate * moved)
        for i in range(3):
            centre.translation[i] += tracker.velocity[i] * moved
    position, theta = motion_gate(workspace, centre, interval, covariance)
    return bool(max(position, theta) <= 1.0)


@in_place
def periods_off(settings: Any, theta: float) -> float:
    """Return by how many whole periods theta misses the home mark's; whole turns count as no miss."""
    per_turn = round(2.0 * math.pi / settings.period)
    off = float(round((theta - settings.home_theta) / settings.period))
    return float(off - per_turn * math.floor(off / per_turn + 0.5))


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
