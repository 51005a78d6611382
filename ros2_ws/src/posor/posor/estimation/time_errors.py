# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings that are exposed at other times than their stamp, and the uncertainty that this adds to a pose.

A multiplexing converter reads the channels of a scan one after another, while the target moves on (thesis 8.3.3: eleven
conversions of 100 us). With the tracker's twist xi and the offset t of a reading's exposure from the stamp, the reading
exceeds the reading at the stamp by ``J xi t``, J its derivative at the pose of ``t / 2``, by linear interpolation
between the pose at the stamp and that at half of the longest offset. The shift is subtracted before the solution, so
the pose is that at the stamp; the uncertainty of xi enters the variance of the reading (JCGM 100, 5.1.2). An unknown
offset is uniformly distributed over the span of the scan and enters the variance with ``span^2 / 12`` (4.3.7).

The ratio ``u = (A - C)/(A + C)`` of two contact currents that are read at times a and c has the offset
``((1 - u) a + (1 + u) c) / 2``. A map mixes both ratios; its slope M turns the offsets of the ratios into
``M diag(t_u, t_v) M^-1``, which acts on the rates of both coordinates of the spot.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.clocks import TIME_SHARE
from posor.estimation.tracking import copy_pose, turn_about_z
from posor.model.reading_rows import predict_readings
from posor.model.scan import CONTACTS
from posor.numerics.compiled import in_place
from posor.numerics.vector import square

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

LONGEST_OFFSET_S = 100.0  # largest offset of an exposure from the stamp that is accepted, of means of slow scans [s]


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
