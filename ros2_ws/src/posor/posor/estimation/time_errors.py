# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the times of a scan add to the errors of its pose: exposures away from the stamp, and a wrong stamp.

A multiplexing converter reads the channels of a scan one after another, while the target moves on (thesis 8.3.3: eleven
conversions of 100 us). With the tracker's twist xi and the offset t of a reading's exposure from the stamp, the reading
exceeds the reading at the stamp by ``J xi t``, J its derivative at the pose of ``t / 2``, by linear interpolation
between the pose at the stamp and that at half of the longest offset. The shift is subtracted before the solution, so
the pose is that at the stamp; the uncertainty of xi enters the variance of the reading (JCGM 100, 5.1.2). An unknown
offset is uniformly distributed over the span of the scan and enters the variance with ``span^2 / 12`` (4.3.7).

The ratio ``u = (A - C)/(A + C)`` of two contact currents that are read at times a and c has the offset
``((1 - u) a + (1 + u) c) / 2``. A map mixes both ratios; its slope M turns the offsets of the ratios into
``M diag(t_u, t_v) M^-1``, which acts on the rates of both coordinates of the spot.

A stamp with the standard uncertainty s displaces the pose along its motion: the random covariance grows by
``s^2 (xi xi' + diag(sigma_xi^2))``.

A stamp that is wrong by at most L displaces the pose too. Let r be the mean rate along or about an axis over the last
interval d, A the largest acceleration and V the largest velocity that the calibration states. The rate is within
``A d / 2`` of r at the present pose, and changes by at most ``A L`` within L, so the displacement is at most

    min(L V, L (|r| + A (d + L) / 2) + n).

Without a stated acceleration or a previous pose it is at most L V; without motion limits it is not bounded (infinite).
The part n from the noise of the rate is ``NOISE_SIGMAS s L / d`` for a pose with the random standard deviation s, so
that the bound holds beside the coverage factor of the protection level.

Readings within an exposure span S are averaged, or moved to the stamp, as if the target moved evenly meanwhile. It
departs from the even motion by at most ``A (S/2)^2 / 2`` and by at most ``V S / 2``; the bound adds the smaller one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.tracking import copy_pose, renew_twist, turn_about_z
from posor.model.fault import Fault
from posor.model.reading_rows import predict_readings
from posor.model.scan import CONTACTS
from posor.numerics.compiled import in_place
from posor.numerics.vector import cross, minus, square, wrapped

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector

LONGEST_OFFSET_S = 100.0  # largest offset of an exposure from the stamp that is accepted, of means of slow scans [s]
TIME_SHARE = 0.5  # TIME is set where the part from time exceeds this share of the rest of the standard uncertainty
TIME_FAULT = int(Fault.TIME)
NOISE_SIGMAS = 5.0 * math.sqrt(2.0)  # 5 standard deviations of the difference of two poses, in those of one pose


@in_place
def begin_exposures(workspace: Any, scan: Any) -> bool:
    """Set all offsets to zero with the variance of an unknown one; return whether offsets and span are valid."""
    workspace.has_offsets = 1 if scan.offset_count > 0 else 0
    for r in range(workspace.reading_count):
        workspace.offsets[r] = workspace.cross_offsets[r] = 0.0
        workspace.partners[r] = r
        workspace.offset_variances[r] = _unknown_variance(workspace.tracker, scan)
    channels = scan.gap_count + scan.ring_count + scan.current_count
    valid = scan.offset_count in (0, channels) and 0.0 <= scan.exposure_span <= LONGEST_OFFSET_S
    for i in range(scan.offset_count):
        valid = valid and not abs(scan.exposure_offsets[i]) > LONGEST_OFFSET_S
    return bool(valid)


@in_place
def _unknown_variance(tracker: Any, scan: Any) -> float:
    """Return the variance of an unknown offset [s^2]: uniform over the scan, or over a scan interval."""
    span = scan.exposure_span if scan.exposure_span > 0.0 else tracker.clocks.period
    return float(square(span) / 12.0)


@in_place
def write_voltage_offset(workspace: Any, scan: Any, r: int, channel: int) -> None:
    """Write the offset of a probe's reading; ``channel``: index of its offset in the scan."""
    offset = scan.exposure_offsets[channel]
    if not math.isnan(offset):
        workspace.offsets[r], workspace.offset_variances[r] = offset, 0.0


@in_place
def write_spot_offsets(workspace: Any, scan: Any, r: int, diode: int) -> None:
    """Write the offsets of readings r and r + 1, x and y of a spot, whose ratios and slope are in the workspace."""
    spot, first = workspace.spot, scan.gap_count + scan.ring_count + CONTACTS * diode
    u, v = spot.ratios[0], spot.ratios[1]
    offsets = scan.exposure_offsets
    t_u = 0.5 * ((1.0 - u) * offsets[first] + (1.0 + u) * offsets[first + 2])
    t_v = 0.5 * ((1.0 - v) * offsets[first + 1] + (1.0 + v) * offsets[first + 3])
    if math.isnan(t_u + t_v):
        return
    m = spot.slope
    determinant = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    workspace.offsets[r] = (m[0, 0] * m[1, 1] * t_u - m[0, 1] * m[1, 0] * t_v) / determinant
    workspace.cross_offsets[r] = m[0, 0] * m[0, 1] * (t_v - t_u) / determinant
    workspace.offsets[r + 1] = (m[0, 0] * m[1, 1] * t_v - m[0, 1] * m[1, 0] * t_u) / determinant
    workspace.cross_offsets[r + 1] = m[1, 0] * m[1, 1] * (t_u - t_v) / determinant
    workspace.partners[r], workspace.partners[r + 1] = r + 1, r
    workspace.offset_variances[r] = workspace.offset_variances[r + 1] = 0.0


@in_place
def _move(pose: Any, twist: FloatArray, time: float, moved: Any) -> None:
    """Write the pose after ``time`` [s] of a motion that turns about the target's Z, see ``tracking.write_twist``."""
    copy_pose(pose, moved)
    turn = 0.0
    for i in range(3):
        moved.translation[i] += twist[i] * time
        turn += twist[3 + i] * pose.rotation[i, 2] * time
    turn_about_z(moved.rotation, turn)


@in_place
def _write_rates(workspace: Any, pose: Any, rates: FloatArray, sigmas: FloatArray) -> None:
    """Write the rates of the readings at a pose by the workspace's twist, (m,) [m/s], and their uncertainties."""
    m, jacobian = workspace.reading_count, workspace.jacobian
    for i in range(6):
        workspace.step_sum[i] = 0.0
    predict_readings(workspace.rows, m, pose, workspace.step_sum, rates, jacobian)
    for r in range(m):
        rate = variance = 0.0
        for i in range(6):
            first, derivative = i - i % 3, 0.0  # by motion along or about axis i of the parent
            for k in range(3):
                derivative += jacobian[r, first + k] * pose.rotation[i - first, k]
            rate += derivative * workspace.twist[i]
            variance += square(derivative * workspace.twist_sigmas[i])
        rates[r], sigmas[r] = rate, math.sqrt(variance)


@in_place
def move_to_stamp(workspace: Any) -> bool:
    """Subtract from each reading what it changed between the stamp and its exposure, and add the uncertainty.

    ``workspace.pose``: the start; ``workspace.twist``: that of the target there. Return whether a variance has grown by
    more than TIME_SHARE allows.
    """
    m, longest = workspace.reading_count, 0.0
    for r in range(m):
        if abs(workspace.offsets[r]) > abs(longest):
            longest = workspace.offsets[r]
    # Residuals and weights are free until the solution.
    rates, moved_rates, sigmas = workspace.residuals, workspace.moved_rates, workspace.weights
    _move(workspace.pose, workspace.twist, 0.5 * longest, workspace.moved_pose)
    _write_rates(workspace, workspace.moved_pose, moved_rates, sigmas)
    _write_rates(workspace, workspace.pose, rates, sigmas)
    doubtful = False
    for r in range(m):
        own, cross, partner = workspace.offsets[r], workspace.cross_offsets[r], workspace.partners[r]
        change = (moved_rates[r] - rates[r]) * own / longest if longest != 0.0 else 0.0
        workspace.values[r] -= own * (rates[r] + change) + cross * rates[partner]
        added = square(own * sigmas[r]) + square(cross * sigmas[partner])
        added += workspace.offset_variances[r] * (square(rates[r]) + square(sigmas[r]))
        doubtful = doubtful or added > square(TIME_SHARE) * workspace.variances[r]
        workspace.variances[r] += added
    return doubtful


@in_place
def add_stamp_variance(
    workspace: Any, sigma: float, theta: float, elapsed: float, random: FloatArray, systematic: FloatArray
) -> int:
    """Add the covariance from the standard uncertainty of the stamp, ``sigma`` [s], to ``random`` (ROS order).

    ``theta``: of the pose [rad]; ``elapsed``: time since the tracker's pose [s], NaN: the motion from there is unknown.
    Return the fault TIME where a variance grows by more than TIME_SHARE allows, else 0.
    """
    fault = 0
    if elapsed > 0.0:
        renew_twist(workspace, theta, elapsed)
    for i in range(6):
        added = square(sigma) * (square(workspace.twist[i]) + square(workspace.twist_sigmas[i]))
        if added > square(TIME_SHARE) * (random[i, i] + systematic[i, i]):
            fault = TIME_FAULT
        random[i, i] += square(sigma * workspace.twist_sigmas[i])
        for j in range(6):
            random[i, j] += square(sigma) * workspace.twist[i] * workspace.twist[j]
    return fault


@in_place
def _axis_of(rotation: FloatArray) -> Vector:
    """Return the target's Z axis."""
    return rotation[0, 2], rotation[1, 2], rotation[2, 2]


@in_place
def _largest_shift(
    limit: float, elapsed: float, fastest: float, acceleration: float, moved: float, noise: float
) -> float:
    """Return the largest displacement within ``limit`` [s] after a motion in ``elapsed`` [s]; NaN: unknown."""
    if not limit > 0.0:
        return 0.0
    if not elapsed > 0.0:
        return limit * fastest
    after = limit * (abs(moved) / elapsed + 0.5 * acceleration * (elapsed + limit))
    return min(limit * fastest, after + NOISE_SIGMAS * noise * limit / elapsed)


@in_place
def _largest_bend(span: float, fastest: float, acceleration: float) -> float:
    """Return the largest departure from an even motion within an exposure span [s]."""
    return min(0.5 * span * fastest, 0.125 * square(span) * acceleration) if span > 0.0 else 0.0


@in_place
def write_stamp_shift(workspace: Any, scan: Any, theta: float, elapsed: float, estimate: Any) -> None:
    """Write the largest error of the pose in the workspace by a wrong stamp, and by the time that its readings take.

    ``theta``: of the pose [rad]; ``elapsed``: time since the tracker's pose [s], NaN: the motion from there is unknown;
    ``estimate``: record of dtype ESTIMATE, its ``stamp_shift`` is written: ROS order, axes of the parent [m], [rad].
    """
    limit, span = max(scan.stamp_limit, workspace.tracker.clocks.step), scan.exposure_span
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
        shift = _largest_shift(limit, elapsed, fastest, acceleration, moved, noise)
        estimate.stamp_shift[3 + k] = shift + _largest_bend(span, fastest, acceleration)
        fastest, acceleration = settings.max_velocity, settings.max_acceleration
        noise = math.sqrt(estimate.random[k, k])
        moved = pose.translation[k] - previous.translation[k]
        shift = _largest_shift(limit, elapsed, fastest, acceleration, moved, noise)
        estimate.stamp_shift[k] = shift + _largest_bend(span, fastest, acceleration)
