# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The one order of steps from a raw scan to an estimate: linearise, predict, solve, covariance, test, update tracker.

``estimate_scans`` takes the straight path for many scans. What is rare is left to the caller (``estimation.posor``),
who uses the same steps: the start from a closed form, the retry of a failed scan, and sensors written in plain Python.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.ambient import LIGHT_LEFT, NO_DARK_SCAN, NO_POSE, add_common_effects, follow_ambient
from posor.estimation.clocks import IN_ORDER, elapsed_at, follow_clocks, is_late, motion_allowance, stamp_sigma
from posor.estimation.covariance import (
    add_shared_terms,
    add_systematic_covariance,
    find_contributions,
    write_covariances,
    write_shared_effects,
)
from posor.estimation.fault_effects import write_fault_effects
from posor.estimation.frozen import NOT_FROZEN, count_repetitions
from posor.estimation.linearise import add_unmeasured, environment_is_valid, linearise_scan, missing, unmeasured
from posor.estimation.scan_checks import (
    REGAINABLE_FAULTS,
    begin_checks,
    check_count,
    check_home_mark,
    check_motion,
    check_reference,
    check_residuals,
    check_travel,
    chi_square,
    count_theta,
    latch,
    use_ambient_change,
    use_confirmation,
)
from posor.estimation.solver import CONVERGED, ILL_CONDITIONED, SINGULAR, solve_pose
from posor.estimation.time_errors import TIME_FAULT, add_stamp_variance, move_to_stamp, write_stamp_shift
from posor.estimation.tracking import (
    add_prior,
    copy_pose,
    forget_pose,
    needs_start,
    predict,
    turn_about_z,
    update_tracker,
    write_start,
    write_twist,
)
from posor.model.fault import Fault, State
from posor.model.reading_rows import begin_scan, differentiate_by_parameters, pair_spots, prepare_row, turn_row
from posor.model.scan import DIODES_ESTIMATED, MAX_TERMS, PROBES_ESTIMATED, SATURATED
from posor.numerics.compiled import in_place, without_lock
from posor.numerics.vector import at, matrix, store, theta_in_kernel, wrapped, write_pose

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor.estimation.workspace import Model

DONE, START, RETRY = 0, 1, 2
"""Results of ``estimate_scan``. DONE: estimated. START: no pose is known, so a start is missing. RETRY: the solution
from the previous pose failed, so a start in closed form is missing."""

OK, DEGRADED, LOST, UNCOUNTED = (int(state) for state in (State.OK, State.DEGRADED, State.LOST, State.UNCOUNTED))
BAD_READING_FAULT, NOT_CONVERGED_FAULT = int(Fault.BAD_READING), int(Fault.NOT_CONVERGED)
ILL_CONDITIONED_FAULT = int(Fault.ILL_CONDITIONED)
AMBIENT_FAULT = int(Fault.AMBIENT)
SOURCE_FAULT, FROZEN_FAULT, ENVIRONMENT_FAULT = int(Fault.SOURCE), int(Fault.FROZEN), int(Fault.ENVIRONMENT)
FLAGGED_FAULT, LATCHED_FAULT, ACKNOWLEDGED_FAULT = int(Fault.FLAGGED), int(Fault.LATCHED), int(Fault.ACKNOWLEDGED)

WEAK = 1e-4  # pivot ratio below which the previous pose is a prior: 100 times the usual uncertainty


@in_place
def estimate_scan(model: Model, scan: Any, estimate: Any) -> int:
    """Estimate the pose of one scan from the previous pose on; return DONE or what is left to do.

    ``scan``: record of dtype SCAN; ``estimate``: record of dtype ESTIMATE to write; incomplete where the return value
    is START or RETRY.
    """
    workspace = model.workspace[0]
    tracker = workspace.tracker
    if not begin_scan_estimate(model, scan, estimate, linearise_scan(model, scan, estimate)):
        return DONE
    if needs_start(workspace.settings, tracker):
        return START
    activate_rows(model)
    write_start(workspace.settings, tracker, workspace.pose)
    for i in range(workspace.reading_count):
        for j in range(workspace.reading_count):
            workspace.systematic_readings[i, j] = 0.0
    return int(solve_and_check(model, scan, True, estimate))  # noqa: FBT003  kernels take no keywords


@in_place
def begin_scan_estimate(model: Model, scan: Any, estimate: Any, linearised: bool) -> bool:  # noqa: FBT001
    """Begin the estimate of a scan; return whether its readings can be used, else it is LOST.

    ``linearised``: whether the readings are valid; else ``estimate`` holds sensor, code and fault.
    """
    workspace = model.workspace[0]
    tracker, settings = workspace.tracker, workspace.settings
    estimate.number = scan.number
    estimate.stamp_ns = scan.stamp_ns
    if not tracker.epoch_known:
        tracker.epoch_known, tracker.epoch_ns = 1, scan.stamp_ns
    # Scans that are delivered again are no repeated readings of the electronics.
    frozen = NOT_FROZEN if workspace.is_retry or is_late(tracker, scan) else count_repetitions(model, scan)
    if linearised:
        estimate.faults = 0
        if not environment_is_valid(settings, scan):
            estimate.faults = ENVIRONMENT_FAULT
        elif frozen != NOT_FROZEN:
            estimate.faults, estimate.code = FROZEN_FAULT, frozen
    if estimate.faults == 0:
        lacking = unmeasured(settings, scan)
        if lacking != workspace.unmeasured:
            workspace.unmeasured, workspace.rows_active = lacking, 0
        order = follow_clocks(model, scan)
        if order != IN_ORDER:
            estimate.faults, estimate.code = BAD_READING_FAULT, order
        elif _can_be_solved(workspace, scan, estimate):
            return True
    tracker.reference_sigma = 0.0
    faults, latched = estimate.faults, tracker.latch
    if settings.max_velocity < math.inf and tracker.initialised and faults & (SOURCE_FAULT | FROZEN_FAULT):
        latch(tracker, faults, 1 if faults == SOURCE_FAULT else 0, elapsed_at(tracker, scan))
    estimate.residual = math.nan
    write_lost(estimate, _with_latch(faults, latched) | _flagged(scan))
    return False


@in_place
def _can_be_solved(workspace: Any, scan: Any, estimate: Any) -> bool:
    """Return whether a scan in order can be solved; a dark scan only from a pose, but its ambient light is followed."""
    tracker = workspace.tracker
    if workspace.ambient_unknown:
        estimate.faults = AMBIENT_FAULT
        estimate.code = LIGHT_LEFT if tracker.ambient.light_left else NO_DARK_SCAN
        return False
    if not workspace.is_dark:
        return not _needs_acknowledgement(tracker)
    if not workspace.is_retry:
        use_ambient_change(tracker, follow_ambient(workspace, scan))
    if tracker.initialised and not tracker.start_given and not tracker.latch:
        return True
    estimate.faults, estimate.code = AMBIENT_FAULT, NO_POSE
    return False


@in_place
def _needs_acknowledgement(tracker: Any) -> bool:
    """Return whether only an acknowledgement can release the latch; the scan is not solved then."""
    known = tracker.initialised or tracker.start_given
    return bool(not known and tracker.latch & REGAINABLE_FAULTS and not tracker.latch_about_theta)


@in_place
def _with_latch(faults: int, latched: int) -> int:
    """Return the faults of a LOST scan, given what was latched before it."""
    return int(faults | latched | LATCHED_FAULT) if latched else int(faults)


@in_place
def _flagged(scan: Any) -> int:
    """Return the fault of a scan whose driver has marked a reading as saturated or filled in."""
    return FLAGGED_FAULT if scan.status & (SATURATED | PROBES_ESTIMATED | DIODES_ESTIMATED) else 0


@in_place
def _lasting_faults(workspace: Any, scan: Any) -> int:
    """Return the faults that degrade a pose without a test: flags, what is no longer measured, an acknowledgement."""
    faults = _flagged(scan) | (ENVIRONMENT_FAULT if missing(workspace.settings, workspace.tracker, scan) != 0 else 0)
    return faults | (ACKNOWLEDGED_FAULT if workspace.tracker.acknowledged else 0)


@in_place
def activate_rows(model: Model) -> None:
    """Copy the selected reading rows into the workspace, unless they are there; make them ready for a new scan."""
    workspace = model.workspace[0]
    same = workspace.rows_active == 1
    for r in range(workspace.reading_count):
        same &= workspace.active_rows[r] == workspace.selected_rows[r]
        begin_scan(workspace.rows[r])
    if not same:
        _copy_selected_rows(model)
    elif workspace.settings.tilt_lags:
        for r in range(workspace.reading_count):
            turn_row(workspace.rows[r], 0.0)


@in_place
def _copy_selected_rows(model: Model) -> None:
    workspace = model.workspace[0]
    changed = 0
    for r in range(workspace.reading_count):
        if workspace.active_rows[r] != workspace.selected_rows[r]:
            changed = 1
        workspace.active_rows[r] = workspace.selected_rows[r]
        workspace.rows[r] = model.reading_rows[workspace.selected_rows[r]]
        prepare_row(workspace.rows[r])
    pair_spots(workspace.rows, workspace.reading_count)
    find_contributions(model)
    workspace.rows_active = 1
    workspace.row_changes += changed


@in_place
def _solve(model: Model, extrapolate: bool) -> tuple[int, int]:  # noqa: FBT001  kernels take no keywords
    """Solve the scan from ``workspace.pose`` on; return the solver's outcome and faults.

    Where the readings are blind in some direction and the motion is limited, the previous pose, as uncertain as the
    target can have moved since, fills that direction.
    """
    workspace = model.workspace[0]
    settings, tracker = workspace.settings, workspace.tracker
    m, elapsed = workspace.reading_count, tracker.time - tracker.stamp
    faults = AMBIENT_FAULT if workspace.is_dark or workspace.ambient_old else 0
    tracked = tracker.initialised and not tracker.start_given  # a start may be anywhere
    copy_pose(workspace.pose, workspace.start_pose)
    lag_theta = math.nan
    if extrapolate and tracked:
        if settings.tilt_lags:
            lag_theta = theta_in_kernel(tracker.pose.rotation)
        predict(settings, tracker, elapsed, workspace.pose)
    if workspace.is_dark:
        copy_pose(workspace.pose, workspace.start_pose)
    write_twist(workspace, elapsed)
    if workspace.has_offsets and move_to_stamp(workspace):
        faults |= TIME_FAULT
    for r in range(m):
        workspace.weights[r] = 1.0 / workspace.variances[r]
    may_use_prior = tracked and settings.max_velocity < math.inf
    outcome = solve_pose(workspace, m, WEAK if may_use_prior else SINGULAR, lag_theta)
    if outcome != ILL_CONDITIONED or not may_use_prior:
        return outcome, faults
    copy_pose(workspace.start_pose, workspace.pose)
    add_prior(workspace, m, elapsed)
    return solve_pose(workspace, m + 6, SINGULAR, lag_theta), faults | ILL_CONDITIONED_FAULT


@in_place
def solve_and_check(
    model: Model,
    scan: Any,
    extrapolate: bool,  # noqa: FBT001  kernels take no keywords
    estimate: Any,
) -> int:
    """Solve the active rows from ``workspace.pose`` on, find covariances, check the solution, and update the tracker.

    ``model``: the POSOR; on entry its ``systematic_readings`` hold the part of sensors in Python, the rest is added
    here. ``scan``: record of dtype SCAN. ``extrapolate``: whether to move the start by the last velocity, and to use
    the last theta for tilts that lag. ``estimate``: record of dtype ESTIMATE to write; of a LOST scan all numbers are
    NaN but the chi-square. Return DONE, or RETRY: the scan failed from the previous pose, and the tracker is unchanged.
    """
    workspace = model.workspace[0]
    settings, tracker, pose, checks = workspace.settings, workspace.tracker, workspace.pose, workspace.checks
    may_retry = tracker.initialised and not tracker.start_given and settings.bump_angle == 0.0
    may_retry = may_retry and not workspace.is_dark
    latched = tracker.latch
    estimate.residual = math.nan
    begin_checks(workspace, scan)
    outcome, checks.faults = _solve(model, extrapolate)
    prior_used = checks.faults & ILL_CONDITIONED_FAULT != 0
    if (
        outcome == CONVERGED
        and settings.period > 0.0
        and count_theta(workspace, theta_in_kernel(pose.rotation), scan.at_home)
    ):
        turn_about_z(pose.rotation, -checks.marks_off * settings.bump_angle)
        prior_used, checks.faults = False, checks.faults & ~ILL_CONDITIONED_FAULT
        outcome = solve_pose(workspace, workspace.reading_count, SINGULAR, math.nan)
    if outcome != CONVERGED:
        if may_retry and outcome != ILL_CONDITIONED:
            return RETRY
        _write_unsolved(workspace, outcome, _flagged(scan), estimate)
        return DONE
    differentiate_by_parameters(workspace.rows, workspace.reading_count, pose, model.by_row)
    _write_covariances(model, estimate)
    sigma = stamp_sigma(tracker, scan)
    theta = theta_in_kernel(pose.rotation)
    if sigma > 0.0:
        since = checks.elapsed if tracker.initialised and not checks.recounted else math.nan
        checks.faults |= add_stamp_variance(workspace, sigma, theta, since, estimate.random, estimate.systematic)
    checks.allowance = motion_allowance(tracker, scan)
    estimate.residual = 0.0
    if workspace.redundant_count > 0 and not prior_used:
        estimate.residual = chi_square(workspace)
    checks.contradictory = 0 if estimate.residual <= settings.residual_limit else 1
    if checks.contradictory and may_retry:
        return RETRY
    check_travel(workspace, estimate)
    if workspace.is_dark:
        return _write_dark(workspace, scan, theta, estimate)
    check_residuals(workspace, theta, estimate.residual)
    check_motion(workspace, theta, estimate)
    check_count(workspace, theta)
    check_home_mark(workspace, theta, scan.at_home)
    check_reference(workspace, theta, estimate, scan.stamp_limit)
    use_confirmation(workspace, scan.at_home)
    checks.faults |= _lasting_faults(workspace, scan)
    _end_start(settings, tracker)
    _bound_stamp_shift(workspace, scan, theta, estimate)
    theta = _keep_pose(workspace, theta)
    if checks.contradictory or tracker.latch:
        write_lost(estimate, _with_latch(checks.faults, latched))
        return DONE
    _write_pose(workspace, theta, estimate)
    estimate.state, estimate.faults = DEGRADED if checks.faults else OK, checks.faults
    if settings.period > 0.0 and not tracker.counted:
        estimate.state = UNCOUNTED
    return DONE


@in_place
def _write_dark(workspace: Any, scan: Any, theta: float, estimate: Any) -> int:
    """Write the pose of a dark scan, DEGRADED; beyond the travel it is LOST and latches the joint; return DONE."""
    tracker, checks = workspace.tracker, workspace.checks
    tracker.reference_sigma = 0.0
    if checks.beyond_travel:
        check_motion(workspace, theta, estimate)
        _keep_pose(workspace, theta)
        write_lost(estimate, checks.faults | _lasting_faults(workspace, scan))
        return DONE
    _bound_stamp_shift(workspace, scan, theta, estimate)
    _write_pose(workspace, tracker.theta + wrapped(theta - tracker.theta), estimate)
    estimate.state, estimate.faults = DEGRADED, checks.faults | _lasting_faults(workspace, scan)
    return DONE


@in_place
def _write_covariances(model: Model, estimate: Any) -> None:
    """Write both covariances of the solution, and the effects of shared terms."""
    workspace, has_terms = model.workspace[0], model.shared_readings.shape[1] > 0
    add_systematic_covariance(model)
    if workspace.unmeasured != 0:
        add_unmeasured(workspace)
    if workspace.has_common_effects:
        add_common_effects(workspace)
    if has_terms:
        add_shared_terms(model)
    write_covariances(workspace, estimate.random, estimate.systematic)
    if has_terms:
        write_shared_effects(model, estimate.shared)


@in_place
def _write_unsolved(workspace: Any, outcome: int, flagged: int, estimate: Any) -> None:
    """Write that a scan without a solution is LOST."""
    settings, tracker = workspace.settings, workspace.tracker
    faults = ILL_CONDITIONED_FAULT if outcome == ILL_CONDITIONED else NOT_CONVERGED_FAULT
    latched = tracker.latch
    if settings.period > 0.0 or not settings.max_velocity < math.inf:
        forget_pose(tracker)
    tracker.reference_sigma = 0.0
    _end_start(settings, tracker)
    write_lost(estimate, _with_latch(faults, latched) | flagged)


@in_place
def _bound_stamp_shift(workspace: Any, scan: Any, theta: float, estimate: Any) -> None:
    """Write the largest error of an accepted pose by its times; zero where neither limit nor span is known."""
    checks = workspace.checks
    if not (scan.stamp_limit > 0.0 or workspace.tracker.clocks.step > 0.0 or scan.exposure_span > 0.0):
        for i in range(6):
            estimate.stamp_shift[i] = 0.0
    elif checks.accepted and not checks.contradictory:
        moved_from_previous = workspace.tracker.initialised and not checks.recounted
        elapsed = checks.elapsed if moved_from_previous else math.nan
        write_stamp_shift(workspace, scan, theta, elapsed, estimate)


@in_place
def _keep_pose(workspace: Any, theta: float) -> float:
    """Keep an accepted pose as the previous one, else as rejected; return theta, of an accepted one with its turns."""
    tracker, checks = workspace.tracker, workspace.checks
    if checks.contradictory:
        return theta
    if not checks.accepted:
        tracker.rejected_known, tracker.rejected_stamp = 1, tracker.time
        copy_pose(workspace.pose, tracker.rejected)
        return theta
    theta = tracker.theta + wrapped(theta - tracker.theta)
    moved_from_previous = tracker.initialised and not checks.recounted
    update_tracker(tracker, workspace.pose, theta, checks.elapsed if moved_from_previous else math.nan)
    return theta


@in_place
def _end_start(settings: Any, tracker: Any) -> None:
    """Use a given start for one scan only, but the one that knows a count until a scan has used it."""
    if tracker.initialised or not (settings.bump_angle > 0.0 and tracker.counted):
        tracker.start_given = 0


@in_place
def _write_pose(workspace: Any, theta: float, estimate: Any) -> None:
    """Write the solution as rotation and translation, as quaternion, and in native coordinates, theta counted."""
    pose = workspace.pose
    rotation = pose.rotation
    copy_pose(pose, estimate)
    write_pose(matrix(rotation, 0), at(pose.translation, 0), estimate.pose)
    store(estimate.native, 0, at(pose.translation, 0))
    estimate.native[3] = math.asin(max(-1.0, min(1.0, -rotation[1, 2])))
    estimate.native[4] = math.atan2(rotation[0, 2], rotation[2, 2])
    estimate.native[5] = theta
    estimate.redundancy = workspace.redundant_count


@in_place
def write_lost(estimate: Any, faults: int) -> None:
    """Write that a scan is LOST: every number NaN but the chi-square, which may be the reason."""
    estimate.state, estimate.faults, estimate.redundancy = LOST, faults, 0
    for i in range(3):
        estimate.translation[i] = math.nan
        for j in range(3):
            estimate.rotation[i, j] = math.nan
    for i in range(7):
        estimate.pose[i] = math.nan
    for i in range(6):
        estimate.native[i] = estimate.stamp_shift[i] = math.nan
        for j in range(6):
            estimate.random[i, j] = math.nan
            estimate.systematic[i, j] = math.nan
    for t in range(MAX_TERMS):
        for i in range(6):
            estimate.shared[t, i] = math.nan


@without_lock
def estimate_scans(
    model: Model,
    scans: NDArray[np.void],
    estimates: NDArray[np.void],
    effects: NDArray[np.float32],
    begin: int,
    end: int,
) -> tuple[int, int]:
    """Estimate scans ``begin`` to ``end`` while nothing is left to do for one.

    ``effects``: fault effects to write, (n, C, EFFECT), or (0, C, EFFECT). Return where the loop stopped, ``end`` or
    the scan in question, and what is left to do for that scan.
    """
    for n in range(begin, end):
        left = estimate_scan(model, scans[n], estimates[n])
        if left != DONE:
            return n, left
        if effects.shape[0] > 0:
            write_fault_effects(model, scans[n], estimates[n], effects[n])
    return end, DONE
