"""The one order of steps from a raw scan to an estimate: linearise, predict, solve, covariance, test, update tracker.

``estimate_scans`` takes the straight path for many scans. What is rare is left to the caller (``estimation.posor``),
who uses the same steps: the start from a closed form, the retry of a failed scan, and sensors written in plain Python.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_estimator.estimation.covariance import write_covariances
from posor_estimator.estimation.linearise import linearise_scan
from posor_estimator.estimation.parameter_effects import add_systematic_covariance, find_contributions
from posor_estimator.estimation.residual_test import chi_square
from posor_estimator.estimation.solver import CONVERGED, ILL_CONDITIONED, SINGULAR, solve_pose
from posor_estimator.estimation.tracking import (
    add_prior,
    bumps_off,
    copy_pose,
    forget_pose,
    motion_gate,
    predict,
    restart_where_time_goes_back,
    theta_of,
    turn_about_z,
    update_tracker,
    wrapped,
    write_start,
)
from posor_estimator.model.fault import Fault, State
from posor_estimator.model.reading_rows import (
    begin_scan,
    differentiate_by_parameters,
    pair_spots,
    prepare_row,
    turn_row,
)
from posor_estimator.numerics.compiled import in_place, inlined, without_lock
from posor_estimator.numerics.matrix import matrix
from posor_estimator.numerics.pose import write_pose
from posor_estimator.numerics.vector import at, store

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor_estimator.estimation.workspace import Model

DONE, START, RETRY = 0, 1, 2
"""What is left to do for a scan: nothing; a start, since no pose is known; a retry from a start, since it failed
from the previous pose."""

OK, DEGRADED, LOST, UNCOUNTED = (int(state) for state in (State.OK, State.DEGRADED, State.LOST, State.UNCOUNTED))
NOT_CONVERGED_FAULT, ILL_CONDITIONED_FAULT = int(Fault.NOT_CONVERGED), int(Fault.ILL_CONDITIONED)
RESIDUAL_FAULT, INNOVATION_FAULT, COUNT_FAULT = int(Fault.RESIDUAL), int(Fault.INNOVATION), int(Fault.COUNT)

WEAK = 1e-4
"""At a smaller pivot ratio the previous pose fills the blind direction: its uncertainty is 100 times the usual one."""


@inlined
def estimate_scan(model: Model, scan: Any, estimate: Any) -> int:
    """Estimate the pose of one scan from the previous pose on; return DONE or what is left to do.

    Args:
        model: The POSOR.
        scan: Record of dtype SCAN.
        estimate: Record of dtype ESTIMATE to write; incomplete where the return value is START.

    """
    workspace = model.workspace[0]
    tracker = workspace.tracker
    estimate.number = scan.number
    estimate.stamp_ns = scan.stamp_ns
    if not tracker.epoch_known:
        tracker.epoch_known, tracker.epoch_ns = 1, scan.stamp_ns
    if not linearise_scan(model, scan, estimate):
        estimate.residual = math.nan
        write_lost(estimate, estimate.faults)
        return DONE
    stamp = (scan.stamp_ns - tracker.epoch_ns) * 1e-9
    restart_where_time_goes_back(tracker, stamp)
    if not tracker.initialised:
        return START
    activate_rows(model)
    from_previous_pose = tracker.start_given == 0
    write_start(workspace.settings, tracker, stamp, workspace.pose)
    for i in range(workspace.reading_count):
        for j in range(workspace.reading_count):
            workspace.systematic_readings[i, j] = 0.0
    locate(model, stamp, scan.at_home, True, estimate)  # noqa: FBT003  kernels take no keywords
    retry = (RESIDUAL_FAULT | NOT_CONVERGED_FAULT) & estimate.faults != 0
    return RETRY if retry and estimate.state == LOST and from_previous_pose else DONE


@inlined
def activate_rows(model: Model) -> None:
    """Copy the selected rows of the pool into the workspace, unless they are there; make them ready for a new scan."""
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
        workspace.rows[r] = model.pool[workspace.selected_rows[r]]
        prepare_row(workspace.rows[r])
    pair_spots(workspace.rows, workspace.reading_count)
    find_contributions(model)
    workspace.rows_active = 1
    workspace.row_changes += changed


@inlined
def _solve(model: Model, stamp: float, extrapolate: bool) -> tuple[int, int]:  # noqa: FBT001  kernels take no keywords
    """Solve the scan from ``workspace.pose`` on; return the solver's outcome and faults.

    Where the readings are blind in some direction and the motion is limited, the previous pose, as uncertain as the
    target can have moved since, fills that direction.
    """
    workspace = model.workspace[0]
    settings, tracker = workspace.settings, workspace.tracker
    m, elapsed = workspace.reading_count, stamp - tracker.stamp
    tracked = tracker.initialised and not tracker.start_given
    for r in range(m):
        workspace.weights[r] = 1.0 / workspace.variances[r]
    copy_pose(workspace.pose, workspace.start_pose)
    lag_theta = math.nan
    if extrapolate and tracked:
        if settings.tilt_lags:
            lag_theta = theta_of(tracker.pose.rotation)
        predict(settings, tracker, elapsed, workspace.pose)
    bridging = tracked and settings.max_velocity < math.inf
    outcome = solve_pose(workspace, m, WEAK if bridging else SINGULAR, lag_theta)
    if outcome != ILL_CONDITIONED or not bridging:
        return outcome, 0
    copy_pose(workspace.start_pose, workspace.pose)
    add_prior(workspace, m, elapsed)
    return solve_pose(workspace, m + 6, SINGULAR, lag_theta), ILL_CONDITIONED_FAULT


@in_place
def locate(  # noqa: C901, PLR0912, PLR0915  the steps of one scan, in order
    model: Model,
    stamp: float,
    at_home: int,
    extrapolate: bool,  # noqa: FBT001  kernels take no keywords
    estimate: Any,
) -> None:
    """Solve the active rows from ``workspace.pose`` on, find covariances, test the solution, and update the tracker.

    Args:
        model: The POSOR; ``systematic_readings`` hold what of the readings' systematic covariance does not come from
            ``estimation.parameter_effects``.
        stamp: Time of the scan since the epoch [s].
        at_home: Whether the scan saw the home mark.
        extrapolate: Whether the start may be moved on as the target moved before, and the tilts may lag.
        estimate: Record of dtype ESTIMATE to write; of a LOST scan all numbers are NaN but the chi-square.

    """
    workspace = model.workspace[0]
    settings, tracker, pose = workspace.settings, workspace.tracker, workspace.pose
    counting = settings.bump_angle > 0.0
    tracked = tracker.initialised and not tracker.start_given
    elapsed = stamp - tracker.stamp
    predicted_theta = theta_of(pose.rotation) if counting else 0.0
    estimate.residual = math.nan
    outcome, faults = _solve(model, stamp, extrapolate)
    bridged = faults != 0
    if outcome == CONVERGED and counting and at_home:
        off = bumps_off(settings, theta_of(pose.rotation))
        if off != 0.0:
            tracked = False  # the way from the previous pose is meaningless
            if tracker.counted:
                faults |= COUNT_FAULT
            turn_about_z(pose.rotation, -off * settings.bump_angle)
            bridged = False
            outcome = solve_pose(workspace, workspace.reading_count, SINGULAR, math.nan)
            if outcome != CONVERGED:
                faults |= NOT_CONVERGED_FAULT
        if outcome == CONVERGED:
            tracker.counted = 1
    elif outcome != CONVERGED:
        faults = ILL_CONDITIONED_FAULT if outcome == ILL_CONDITIONED else NOT_CONVERGED_FAULT
    if outcome != CONVERGED:
        forget_pose(tracker)
        write_lost(estimate, faults)
        return
    differentiate_by_parameters(workspace.rows, workspace.reading_count, pose, model.by_row)
    add_systematic_covariance(model)
    write_covariances(workspace, estimate.random, estimate.systematic)
    estimate.residual = 0.0
    if workspace.redundant_count > 0 and not bridged:
        estimate.residual = chi_square(workspace)
    if not estimate.residual <= settings.residual_limit:
        faults |= RESIDUAL_FAULT
    theta = theta_of(pose.rotation)
    if tracked:
        if settings.max_velocity < math.inf and motion_gate(workspace, elapsed, estimate.random) > 1.0:
            faults |= INNOVATION_FAULT
        if counting:
            reach = max(abs(tracker.theta_rate) * elapsed, abs(wrapped(theta - predicted_theta)))
            if reach > 0.25 * settings.bump_angle:
                faults |= COUNT_FAULT
                tracker.counted = 0
    if faults & (RESIDUAL_FAULT | INNOVATION_FAULT):
        write_lost(estimate, faults)
        return
    if tracker.initialised:
        theta = tracker.theta + wrapped(theta - tracker.theta)
    update_tracker(tracker, pose, stamp, theta, elapsed if tracked else math.nan)
    state = DEGRADED if faults else OK
    if counting and not tracker.counted:
        state = UNCOUNTED
    _write_pose(workspace, theta, estimate)
    estimate.state, estimate.faults = state, faults


@inlined
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
        estimate.native[i] = math.nan
        for j in range(6):
            estimate.random[i, j] = math.nan
            estimate.systematic[i, j] = math.nan


@without_lock
def estimate_scans(
    model: Model, scans: NDArray[np.void], estimates: NDArray[np.void], begin: int, end: int
) -> tuple[int, int]:
    """Estimate scans ``begin`` to ``end`` while nothing is left to do for one.

    Returns:
        Where the loop stopped, ``end`` or the scan in question, and what is left to do for that scan.

    """
    for n in range(begin, end):
        left = estimate_scan(model, scans[n], estimates[n])
        if left != DONE:
            return n, left
    return end, DONE
