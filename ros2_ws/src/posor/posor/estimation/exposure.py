# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Times of the readings and of their stamp, and the uncertainty that they add to a pose.

A multiplexing converter reads the channels of a scan one after another, while the target moves on (thesis 8.3.3: eleven
conversions of 100 us). With the tracker's twist xi and the offset t of a reading's exposure from the stamp, the reading
exceeds the reading at the stamp by ``J xi t``, J its derivative. The shift is subtracted before the solution, so the
pose is that at the stamp; the uncertainty of xi enters the variance of the reading (JCGM 100, 5.1.2). An unknown offset
is uniformly distributed over the span of the scan and enters the variance with ``span^2 / 12`` (4.3.7).

The ratio ``u = (A - C)/(A + C)`` of two contact currents that are read at times a and c has the offset
``((1 - u) a + (1 + u) c) / 2``. A map mixes both ratios; its slope M turns the offsets of the ratios into
``M diag(t_u, t_v) M^-1``, which acts on the rates of both coordinates of the spot.

A stamp with the standard uncertainty s displaces the pose along its motion: the random covariance grows by
``s^2 (xi xi' + diag(sigma_xi^2))``.

A stamp that is wrong by at most L displaces the pose too. Let r be the mean rate along or about an axis over the last
interval d, A the largest acceleration and V the largest velocity that the calibration states. The rate is within
``A d / 2`` of r at the present pose, and changes by at most ``A L`` within L, so the displacement is at most

    min(L V, L (|r| + A (d + L) / 2) + n),

without a stated acceleration or a previous pose L V, without motion limits infinite. The noise n of the rate is
``NOISE_SIGMAS s L / d`` for a pose with the random standard deviation s, so that the bound holds beside the coverage
factor of the protection level.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.tracking import rate_is_known, uniform_sigma
from posor.model.fault import Fault
from posor.model.reading_rows import predict_readings
from posor.model.scan import CONTACTS
from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import cross, minus, square, wrapped

if TYPE_CHECKING:
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray
    from posor.numerics.vector import Vector

INVALID_EXPOSURE = -105  # code of the estimate: offsets, span, or uncertainty or limit of the stamp are invalid
LONGEST_OFFSET_S = 1.0  # largest offset of an exposure from the stamp that is accepted [s]
TIME_SHARE = 0.5  # TIME is set where the part from time exceeds this share of the rest of the standard uncertainty
TIME_FAULT = int(Fault.TIME)
NOISE_SIGMAS = 5.0 * math.sqrt(2.0)  # of the difference of two poses


@inlined
def _exposures_are_valid(scan: Any) -> bool:
    """Return whether all that a scan states about time is valid: offsets, span, uncertainty and limit of the stamp."""
    channels = scan.gap_count + scan.ring_count + scan.current_count
    valid = scan.offset_count in (0, channels) and 0.0 <= scan.exposure_span <= LONGEST_OFFSET_S
    for i in range(scan.offset_count):
        valid = valid and not abs(scan.exposure_offsets[i]) > LONGEST_OFFSET_S
    return bool(valid and 0.0 <= scan.stamp_uncertainty < math.inf and 0.0 <= scan.stamp_limit < math.inf)


@inlined
def begin_exposures(model: Model, scan: Any) -> bool:
    """Set all offsets to zero with the variance of an unknown one; return whether the scan's times are valid."""
    workspace = model.workspace[0]
    workspace.has_offsets = 1 if scan.offset_count > 0 else 0
    if workspace.has_offsets:
        for r in range(workspace.reading_count):
            workspace.offsets[r] = workspace.cross_offsets[r] = 0.0
            workspace.partners[r] = r
            workspace.offset_variances[r] = _unknown_variance(workspace.tracker, scan)
    return _exposures_are_valid(scan)


@inlined
def _unknown_variance(tracker: Any, scan: Any) -> float:
    """Return the variance of an unknown offset [s^2]: uniform over the scan, or over a scan interval."""
    span = scan.exposure_span if scan.exposure_span > 0.0 else tracker.clocks.period
    return float(square(span) / 12.0)


@inlined
def write_voltage_offset(workspace: Any, scan: Any, r: int, channel: int) -> None:
    """Write the offset of a probe's reading; ``channel``: index of its offset in the scan."""
    offset = scan.exposure_offsets[channel]
    if not math.isnan(offset):
        workspace.offsets[r], workspace.offset_variances[r] = offset, 0.0


@inlined
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


@inlined
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
def move_to_stamp(workspace: Any) -> bool:
    """Subtract from each reading what it changed between the stamp and its exposure, and add the uncertainty.

    ``workspace.pose``: the start; ``workspace.twist``: that of the target there. Return whether a variance has grown by
    more than TIME_SHARE allows.
    """
    rotation, m = workspace.pose.rotation, workspace.reading_count
    # Residuals and weights are free until the solution.
    jacobian, rates, sigmas = workspace.jacobian, workspace.residuals, workspace.weights
    for i in range(6):
        workspace.step_sum[i] = 0.0
    predict_readings(workspace.rows, m, workspace.pose, workspace.step_sum, rates, jacobian)
    for r in range(m):
        rate = variance = 0.0
        for i in range(6):
            first, derivative = i - i % 3, 0.0  # by motion along or about axis i of the parent
            for k in range(3):
                derivative += jacobian[r, first + k] * rotation[i - first, k]
            rate += derivative * workspace.twist[i]
            variance += square(derivative * workspace.twist_sigmas[i])
        rates[r], sigmas[r] = rate, math.sqrt(variance)
    doubtful = False
    for r in range(m):
        own, cross, partner = workspace.offsets[r], workspace.cross_offsets[r], workspace.partners[r]
        workspace.values[r] -= own * rates[r] + cross * rates[partner]
        added = square(own * sigmas[r]) + square(cross * sigmas[partner])
        added += workspace.offset_variances[r] * (square(rates[r]) + square(sigmas[r]))
        doubtful = doubtful or added > square(TIME_SHARE) * workspace.variances[r]
        workspace.variances[r] += added
    return doubtful


@inlined
def _renew_twist(workspace: Any, theta: float, elapsed: float) -> None:
    """Write the twist over the last interval; its change from that before is part of the uncertainty."""
    previous, pose = workspace.tracker.pose, workspace.pose
    turn = wrapped(theta - workspace.tracker.theta)
    for i in range(6):
        moved = turn * pose.rotation[i - 3, 2] if i >= 3 else pose.translation[i] - previous.translation[i]  # noqa: PLR2004  translation first
        change = moved / elapsed - workspace.twist[i]
        workspace.twist[i] += change
        workspace.twist_sigmas[i] = max(abs(change), workspace.twist_sigmas[i])


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
        _renew_twist(workspace, theta, elapsed)
    for i in range(6):
        added = square(sigma) * (square(workspace.twist[i]) + square(workspace.twist_sigmas[i]))
        if added > square(TIME_SHARE) * (random[i, i] + systematic[i, i]):
            fault = TIME_FAULT
        random[i, i] += square(sigma * workspace.twist_sigmas[i])
        for j in range(6):
            random[i, j] += square(sigma) * workspace.twist[i] * workspace.twist[j]
    return fault


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
