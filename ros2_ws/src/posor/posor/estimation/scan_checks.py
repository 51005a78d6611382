# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks between solution and tracker: residuals, travel, motion, count of theta, home marks, reference; the latch.

A fault latches the joint. REGAINABLE_FAULTS hold the tracker at the last accepted pose. They are released where one of
the next scans regains the motion, theta extrapolated, within the gate of one scan interval, by a jump back from the
poses rejected meanwhile. Waiting does not widen this gate: later, a reference releases a latch that concerns theta
only, and an operator releases any latch. Where a home mark or an encoder disagrees, the tracker keeps predicting, and
the reference releases the latch. Contradictory readings may agree at another theta although their fault is still there:
a common gain of the gap probes changes all gaps as another plane would, which only their curvature and the spots
contradict. RESIDUAL is therefore released by scans that pass where chi-square was largest, or anywhere once the first
dark scan since then has shown other ambient light. A pose beyond the travel of the bearing (TRAVEL) is wrong even where
all readings agree.

The chi-square of the redundant readings takes their whole uncertainty into account. The residuals e of the fit lie, as
far as no pose explains them, in the residual space (parity space) Z of the readings, ``J' Z = 0``, which has as many
directions as readings are redundant. There they have the covariance ``Z' (R + S) Z``, so chi-square is ``u' (Z' (R + S)
Z)^-1 u`` with ``u = Z' e`` (R random, S systematic covariance).

Each check reads and writes ``workspace.checks`` and the tracker; ``estimation.estimate_scan`` calls them in order.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.time_offset import follow_offset, move_reference
from posor.estimation.tracking import REGAIN_GAP, REGAIN_S, copy_pose, count_is_stale, turn_about_z
from posor.model.fault import Fault
from posor.model.scan import STATED_HOME
from posor.numerics.compiled import in_place
from posor.numerics.matrix import cholesky_factorise, solve_lower_triangular
from posor.numerics.vector import ZERO_VECTOR, dot, square, theta_in_kernel, within, wrapped

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector


MARKS = 6  # consecutive scans with agreeing home marks that count theta; so many disagreeing marks are a fault
RESIDUAL_RUN = 10  # scans in a row that fail before the latch; scans that pass at the largest chi-square before release
SAME_THETA = 5e-3  # change of theta that changes little of what a fault does [rad]: 1/10 of a bump, 1/4 mm of a spot
LONGEST_STEP = 5.0 * SAME_THETA  # of theta from scan to scan, by which a joint that turns may pass beside a theta [rad]
REFERENCE_SIGMAS = 5.0  # standard deviations within which a reference of theta agrees
NOISE_ALLOWANCE = 5.0  # standard deviations that are added to limits of motion and travel

RESIDUAL, INNOVATION, COUNT, ENCODER, TRAVEL = (
    int(fault) for fault in (Fault.RESIDUAL, Fault.INNOVATION, Fault.COUNT, Fault.ENCODER, Fault.TRAVEL)
)
REGAINABLE_FAULTS = int(Fault.INNOVATION | Fault.SOURCE | Fault.FROZEN | Fault.TRAVEL)
"""Faults whose latch is released by a pose that continues the motion before the fault."""


@in_place
def begin_checks(workspace: Any, scan: Any) -> None:
    """Begin the checks of a scan with its reference of theta, if any; give up a count that nobody followed."""
    tracker, checks = workspace.tracker, workspace.checks
    checks.elapsed = tracker.time - tracker.stamp
    checks.faults, checks.contradictory, checks.accepted = 0, 0, 1
    checks.recounted, checks.confirmed, checks.marks, checks.marks_off = 0, 0, 0, 0.0
    checks.reference_variance = 0.0
    if tracker.initialised and count_is_stale(workspace.settings, tracker, checks.elapsed):
        tracker.counted = 0
    checks.counted = tracker.counted
    if tracker.reference_sigma > 0.0:
        move_reference(workspace, scan, REFERENCE_SIGMAS)


@in_place
def count_theta(workspace: Any, theta: float, at_home: int) -> bool:
    """Count theta by a statement, enough home marks, or a reference; return whether it is periods off."""
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    if at_home == STATED_HOME or (at_home and not checks.counted and not tracker.mark_sticks):
        checks.marks_off = periods_off(settings, theta)
        agrees_with_last = tracker.marks > 0 and checks.marks_off == tracker.marks_off
        checks.marks = tracker.marks + 1 if agrees_with_last else 1
        checks.recounted = 1 if checks.marks >= MARKS or at_home == STATED_HOME else 0
    elif checks.reference_variance > 0.0 and not checks.counted and not tracker.latch & ENCODER:
        checks.marks_off = float(round(wrapped(theta - checks.reference_theta) / settings.period))
        checks.recounted = 1
    if checks.recounted and checks.marks_off != 0.0 and settings.bump_angle == 0.0:
        checks.faults |= COUNT  # the numbers of the light sources contradict the count
        checks.recounted = 0
    return bool(checks.recounted and checks.marks_off != 0.0)


@in_place
def bump_is_unknown(workspace: Any) -> bool:
    """Return whether the bump is not counted: at the start, after an acknowledgement, and where the count was lost."""
    return bool(workspace.settings.bump_angle > 0.0 and not workspace.tracker.counted)


@in_place
def check_residuals(workspace: Any, theta: float, residual: float) -> None:
    """Latch the joint after RESIDUAL_RUN failed residual tests in a row; release it after as many passed tests.

    ``residual``: chi-square of the scan. Only tests near the theta of the largest one release the latch: within
    SAME_THETA and the motion since the scan before. A shorter run of failed tests does not move this place.
    """
    tracker, checks = workspace.tracker, workspace.checks
    before, tracker.tested_theta = tracker.tested_theta, theta
    tracker.residual_run = tracker.residual_run + 1 if checks.contradictory else 0
    if checks.contradictory:
        if tracker.contradictions == 0:
            tracker.same_ambient = 0
        is_run = not tracker.latch & RESIDUAL or tracker.residual_run >= RESIDUAL_RUN
        if tracker.contradictions == 0 or (is_run and not residual <= tracker.largest_residual):
            tracker.largest_residual, tracker.residual_theta = residual, theta
        checks.faults |= RESIDUAL
        checks.recounted = 0
        _count_contradiction(workspace)
    elif tracker.contradictions > 0:
        near = SAME_THETA + min(abs(wrapped(theta - before)), LONGEST_STEP)
        if not tracker.latch & RESIDUAL:
            tracker.contradictions = 0
        elif not abs(wrapped(theta - tracker.residual_theta)) > near:  # NaN: at any theta
            tracker.contradictions -= 1
        if tracker.contradictions == 0:
            tracker.latch &= ~RESIDUAL
    checks.confirmed = checks.recounted


@in_place
def _count_contradiction(workspace: Any) -> None:
    """Count a failed test of a run; the last of RESIDUAL_RUN latches the joint.

    A run does not begin at an unknown bump: bumps differ, so sound readings contradict one another at a wrong bump.
    """
    tracker = workspace.tracker
    if tracker.latch & RESIDUAL:
        tracker.contradictions = RESIDUAL_RUN
    elif tracker.contradictions > 0 or not bump_is_unknown(workspace):
        tracker.contradictions += 1
        if workspace.settings.max_velocity < math.inf and tracker.contradictions >= RESIDUAL_RUN:
            latch(tracker, RESIDUAL, 1, workspace.checks.elapsed)


@in_place
def use_ambient_change(tracker: Any, is_new: bool) -> None:  # noqa: FBT001  a kernel
    """Release RESIDUAL at any theta where only other ambient light may have been its cause.

    ``is_new``: whether a dark scan shows other ambient light. One that shows the same proves another cause.
    """
    if not is_new:
        tracker.same_ambient = 1
    elif not tracker.same_ambient:
        tracker.largest_residual, tracker.residual_theta = 0.0, math.nan


@in_place
def check_travel(workspace: Any, estimate: Any) -> None:
    """Note whether a pose without contradictions is beyond the travel of the bearing by more than its uncertainty.

    The pose of an uncounted scan is not checked: at a wrong bump the tilt of the target plane is taken for a lean, and
    the pose is not usable anyway.
    """
    settings, pose, checks = workspace.settings, workspace.pose, workspace.checks
    checks.beyond_travel = 0
    uncounted = settings.bump_angle > 0.0 and workspace.tracker.counted == 0 and checks.recounted == 0
    if not settings.travel_lean < math.inf or checks.contradictory or uncounted:
        return
    gap, sine = pose.translation[2], math.sqrt(square(pose.rotation[0, 2]) + square(pose.rotation[1, 2]))
    allowance = NOISE_ALLOWANCE * math.sqrt(_variance(estimate, 2))
    beyond = gap < settings.travel_gap[0] - allowance or gap > settings.travel_gap[1] + allowance
    allowance = NOISE_ALLOWANCE * math.sqrt(_variance(estimate, 3) + _variance(estimate, 4))
    lean = math.atan2(sine, pose.rotation[2, 2])
    if beyond or lean > settings.travel_lean + allowance:
        checks.beyond_travel = 1
        workspace.tracker.beyond_gap, workspace.tracker.beyond_lean = gap, lean


@in_place
def _variance(estimate: Any, k: int) -> float:
    return float(estimate.random[k, k] + estimate.systematic[k, k])


@in_place
def check_motion(workspace: Any, theta: float, estimate: Any) -> None:
    """Reject a pose beyond travel or largest motion; while latched, also one that does not regain the motion."""
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    if checks.beyond_travel:
        checks.faults |= TRAVEL
        latch(tracker, TRAVEL, 0, checks.elapsed)
        checks.accepted = checks.recounted = 0
    elif tracker.latch & REGAINABLE_FAULTS:
        if not checks.contradictory and is_regained(workspace, estimate.random):
            tracker.latch &= ~REGAINABLE_FAULTS
        else:
            checks.accepted = 0
            if _position_jumped(workspace, estimate):
                tracker.latch_about_theta = 0
    elif tracker.initialised and settings.max_velocity < math.inf:
        if checks.recounted or bump_is_unknown(workspace):  # another bump changes theta, and X and Y a little
            position, about_z = _plane_gate(workspace, tracker.pose, checks.elapsed, estimate.random), 0.0
        else:
            position, about_z = motion_gate(workspace, tracker.pose, checks.elapsed, estimate.random)
        if max(position, about_z) > 1.0:
            checks.faults |= INNOVATION
            slipped = settings.period > 0.0 and abs(wrapped(theta - tracker.theta)) > 0.5 * settings.period
            latch(tracker, INNOVATION, 1 if position <= 1.0 or slipped else 0, checks.elapsed)
            checks.accepted = checks.recounted = 0


@in_place
def _position_jumped(workspace: Any, estimate: Any) -> bool:
    """Return whether position or inclination jumped during a latch."""
    tracker, checks = workspace.tracker, workspace.checks
    if tracker.initialised and _jumped_from(workspace, tracker.pose, checks.elapsed, estimate):
        return True
    if not tracker.rejected_known:
        return False
    return bool(_jumped_from(workspace, tracker.rejected, tracker.time - tracker.rejected_stamp, estimate))


@in_place
def _jumped_from(workspace: Any, previous: Any, elapsed: float, estimate: Any) -> bool:
    """Return whether the position jumped without theta; a slip by a period changes both."""
    turned = wrapped(theta_in_kernel(workspace.pose.rotation) - theta_in_kernel(previous.rotation))
    if abs(turned) > 0.5 * workspace.settings.period > 0.0:
        return False
    position, _ = motion_gate(workspace, previous, elapsed, estimate.random)
    return bool(position > 1.0)


@in_place
def check_count(workspace: Any, theta: float) -> None:
    """Lose the count where theta has moved so far that it may be a period off."""
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    if settings.period == 0.0 or not tracker.initialised or checks.recounted:
        return
    if not checks.accepted or checks.contradictory:
        return
    predicted = tracker.theta + tracker.theta_rate * checks.elapsed
    reach = max(abs(tracker.theta_rate) * checks.elapsed, abs(wrapped(theta - predicted)))
    if reach > 0.25 * settings.period:
        checks.faults |= COUNT
        tracker.counted = 0
        checks.marks = 0


@in_place
def check_home_mark(workspace: Any, theta: float, at_home: int) -> None:
    """Compare a counted theta with the home mark; a mark that disagrees latches the joint.

    A mark that is seen at several bumps without a pause confirms none of them, and is not spurious at the last ones.
    """
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    comparable = settings.period > 0.0 and checks.counted and not checks.recounted
    if at_home and comparable and checks.accepted and not checks.contradictory:
        checks.marks_off = periods_off(settings, theta)
        if checks.marks_off == 0.0 and tracker.mark_sticks:
            checks.marks = min(0, tracker.marks)
        elif checks.marks_off == 0.0:
            checks.marks = max(0, tracker.marks) + 1
            checks.confirmed = 1 if checks.marks >= MARKS else 0
        else:
            checks.marks = min(0, tracker.marks) - 1
            checks.faults |= COUNT
            latch(tracker, COUNT, 1, checks.elapsed)
    elif tracker.latch & COUNT and not at_home:
        if -MARKS < tracker.marks < 0 and not tracker.mark_sticks:
            tracker.latch &= ~COUNT  # the disagreeing mark was spurious
        else:
            checks.marks = -MARKS
    tracker.marks, tracker.marks_off = checks.marks, checks.marks_off
    _follow_mark(workspace, theta, at_home)


@in_place
def _follow_mark(workspace: Any, theta: float, at_home: int) -> None:
    """Note whether the home mark sticks: it is seen at several bumps without a pause, as far as theta is followed."""
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    if not at_home or settings.period == 0.0:
        tracker.mark_sticks, tracker.mark_bump = 0, math.nan
    elif at_home != STATED_HOME and checks.accepted and not checks.contradictory:
        bump = periods_off(settings, theta)
        is_followed = tracker.initialised and not count_is_stale(settings, tracker, checks.elapsed)
        was_seen = not math.isnan(tracker.mark_bump)
        if was_seen and is_followed and not checks.recounted and bump != tracker.mark_bump:
            tracker.mark_sticks = 1
        tracker.mark_bump = bump


@in_place
def check_reference(workspace: Any, theta: float, estimate: Any, limit: float) -> None:
    """Compare theta with the reference of this scan, if there is one; disagreement latches the joint.

    ``limit``: stated largest error of the stamps [s].
    """
    settings, tracker, checks = workspace.settings, workspace.tracker, workspace.checks
    comparable = settings.bump_angle == 0.0 or checks.counted or checks.recounted
    if comparable and checks.reference_variance > 0.0 and not checks.contradictory:
        difference = wrapped(checks.reference_theta - theta)
        noise, systematic = checks.reference_variance + estimate.random[5, 5], estimate.systematic[5, 5]
        if checks.accepted and (settings.period == 0.0 or tracker.counted or checks.recounted):
            bias = square(tracker.reference_sigma) + systematic
            follow_offset(workspace, theta, difference, noise, bias, limit)
        allowed = REFERENCE_SIGMAS * math.sqrt(noise + systematic) + checks.reference_tolerance
        checks.confirmed = 1 if abs(difference) <= allowed and tracker.offset.disagreeing == 0.0 else 0
        if not checks.confirmed:
            checks.faults |= ENCODER
            latch(tracker, ENCODER, 1, checks.elapsed)
    tracker.reference_sigma = 0.0


@in_place
def use_confirmation(workspace: Any, at_home: int) -> None:
    """Count theta where marks or a reference have confirmed it, and release a latch that is about theta only."""
    tracker, checks = workspace.tracker, workspace.checks
    if not checks.confirmed or not (checks.accepted or tracker.latch_about_theta):
        return
    tracker.counted = 1
    if at_home != STATED_HOME:  # a statement is not independent of the operator
        tracker.acknowledged = 0
    if tracker.latch_about_theta:
        tracker.latch &= RESIDUAL
        checks.faults &= ~(INNOVATION | COUNT)
        if not checks.accepted:
            checks.recounted, checks.accepted = 1, 1


@in_place
def motion_gate(workspace: Any, previous: Any, elapsed: float, covariance: FloatArray) -> tuple[float, float]:
    """Return the distance of the pose from another one as a share of the largest possible motion: position, theta.

    ``elapsed`` [s]: time between them, to which the allowance for scattered stamps is added.
    """
    settings, pose = workspace.settings, workspace.pose
    largest = _plane_gate(workspace, previous, elapsed, covariance)
    elapsed += workspace.checks.allowance
    for i in range(2):
        largest = max(largest, _shifted(workspace, previous, elapsed, covariance, i))
    turned = abs(wrapped(theta_in_kernel(pose.rotation) - theta_in_kernel(previous.rotation)))
    allowed = settings.max_theta_rate * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * covariance[5, 5])
    return largest, turned / allowed


@in_place
def _shifted(workspace: Any, previous: Any, elapsed: float, covariance: FloatArray, i: int) -> float:
    """Return the shift along axis i as a share of the largest one possible."""
    allowed = workspace.settings.max_velocity * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * covariance[i, i])
    return float(abs(workspace.pose.translation[i] - previous.translation[i]) / allowed)


@in_place
def _plane_gate(workspace: Any, previous: Any, elapsed: float, covariance: FloatArray) -> float:
    """Return the motion of the target plane, gap and lean, as a share of the largest one possible."""
    settings, pose = workspace.settings, workspace.pose
    elapsed += workspace.checks.allowance
    largest = _shifted(workspace, previous, elapsed, covariance, 2)
    for i in range(2):
        leaned = abs(pose.rotation[i, 2] - previous.rotation[i, 2])
        spread = covariance[4, 4] if i == 0 else covariance[3, 3]
        allowed = settings.max_lean_rate * elapsed + NOISE_ALLOWANCE * math.sqrt(2.0 * spread)
        largest = max(largest, leaned / allowed)
    return largest


@in_place
def latch(tracker: Any, faults: int, about_theta: int, elapsed: float) -> None:
    """Latch the joint, ``elapsed`` [s] after the last accepted pose; ``about_theta``: a reference may release it."""
    if faults & REGAINABLE_FAULTS and tracker.latch & REGAINABLE_FAULTS == 0:
        tracker.latch_interval = tracker.interval
        if elapsed > 0.0 and (tracker.interval <= 0.0 or elapsed < tracker.interval):
            tracker.latch_interval = elapsed
        tracker.rejected_known = 0
    if tracker.latch == 0:
        tracker.latch_about_theta = 1
    tracker.latch |= faults
    tracker.latch_about_theta &= about_theta


@in_place
def is_regained(workspace: Any, covariance: FloatArray) -> bool:
    """Return whether the pose continues the motion of the last accepted pose, not that of a pose rejected since."""
    tracker, centre = workspace.tracker, workspace.start_pose
    elapsed, interval = workspace.checks.elapsed, tracker.latch_interval
    if not tracker.initialised or elapsed > max(REGAIN_GAP * interval, REGAIN_S):
        return False
    if tracker.rejected_known:
        position, theta = motion_gate(workspace, tracker.rejected, tracker.time - tracker.rejected_stamp, covariance)
        if max(position, theta) <= 1.0:
            return False
    copy_pose(tracker.pose, centre)
    if tracker.interval > 0.0:  # theta only: else the target hardly moves, and rates from two poses would add noise
        turn_about_z(centre.rotation, tracker.theta_rate * elapsed)
    position, theta = motion_gate(workspace, centre, interval, covariance)
    return bool(max(position, theta) <= 1.0)


@in_place
def periods_off(settings: Any, theta: float) -> float:
    """Return by how many whole periods theta misses the home mark's; whole turns count as no miss."""
    per_turn = round(2.0 * math.pi / settings.period)
    off = float(round((theta - settings.home_theta) / settings.period))
    return float(off - per_turn * math.floor(off / per_turn + 0.5))


@in_place
def chi_square(workspace: Any) -> float:
    """Return the chi-square of the solution in the workspace, NaN where the residual space cannot be found."""
    m, redundant = workspace.reading_count, workspace.redundant_count
    space, components = workspace.residual_space, workspace.residual_components
    covariance, systematic = workspace.residual_covariance, workspace.systematic_readings
    if not _find_residual_space(workspace):
        return math.nan
    for t in range(redundant):
        components[t] = 0.0
        for s in range(t):
            covariance[t, s] = 0.0
        covariance[t, t] = 1.0
        for r in range(m):
            components[t] += space[t, r] * workspace.residuals[r]
            covariance_times_direction = 0.0
            for q in range(workspace.first_correlated[r], workspace.end_correlated[r]):
                covariance_times_direction += systematic[r, q] * space[t, q]
            for s in range(t + 1):
                covariance[t, s] += space[s, r] * covariance_times_direction
    if not cholesky_factorise(covariance, redundant):
        return math.nan
    solve_lower_triangular(covariance, redundant, components)
    out = 0.0
    for t in range(redundant):
        out += components[t] * components[t]
    return out


@in_place
def _find_residual_space(workspace: Any) -> bool:
    """Write directions Z with ``J' Z = 0`` and ``Z' R Z = 1`` into ``residual_space``; return whether there are enough.

    The columns of ``R^-1 (R - J (J' R^-1 J)^-1 J')`` are such directions; the pivoted Cholesky factorisation selects
    those that differ most.
    """
    jacobian, weights, gain, space = workspace.jacobian, workspace.weights, workspace.gain, workspace.residual_space
    m = workspace.reading_count
    for t in range(workspace.redundant_count):
        largest, pivot, v, w = 0.0, 0, ZERO_VECTOR, ZERO_VECTOR
        for r in range(m):
            own_v, own_w = within(jacobian, r, 0), within(jacobian, r, 3)
            rest = 1.0 - _explained(own_v, own_w, gain, r)
            for s in range(t):
                rest -= space[s, r] * space[s, r] / weights[r]
            if rest > largest:
                largest, pivot, v, w = rest, r, own_v, own_w
        if not largest > 0.0:
            return False
        weight = weights[pivot]
        scale = math.sqrt(weight / largest)
        for r in range(m):
            rest = (1.0 if r == pivot else 0.0) - _explained(v, w, gain, r)
            for s in range(t):
                rest -= space[s, r] * space[s, pivot] / weight
            space[t, r] = scale * rest
    return True


@in_place
def _explained(v: Vector, w: Vector, gain: FloatArray, r: int) -> float:
    """Return an entry of ``J G``: how a reading with derivatives v, w follows a change of reading r."""
    return dot(v, within(gain, r, 0)) + dot(w, within(gain, r, 3))
