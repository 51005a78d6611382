# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Pose and covariance of the endpoint in one pass along the arm, with the sag of its beams.

Checked against pinocchio's forward kinematics and Jacobian by ``test/chain/test_endpoint_estimator.py``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.chain.beam_acceleration import append_centres, estimate_accelerations, forget_after_gap, has_free_row
from posor.chain.error_propagation import (
    ZERO_COVARIANCE,
    Blocks,
    add_amounts,
    add_beam_terms,
    add_outer_product,
    add_rotated,
    bound_stamp_shift,
    move_effects,
    moved_along,
    separate_joint_terms,
    write_covariance,
)
from posor.chain.joint_measurements import (
    ENDPOINT_NOT_FINITE,
    measurement_fault,
    read_joint,
    shared_fault,
    stamp_shift_fault,
)
from posor.estimation.fault_model import EFFECT
from posor.model.fault import USABLE_STATES
from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    IDENTITY,
    ZERO_VECTOR,
    Matrix,
    Vector,
    applied,
    at,
    matrix,
    minus,
    plus,
    product,
    put,
    rotation_of_pose,
    row_times,
    times,
    transposed,
    turned_by,
    within,
    write_pose,
)

if TYPE_CHECKING:
    from posor.chain.arm_geometry import ArmGeometry
    from posor.chain.beam_acceleration import BeamHistory
    from posor.chain.joint_measurements import JointMeasurements, JointRows, RecordArray
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

UNUSABLE, HISTORY_FULL, ROWS_MISSING = -1, -2, -3
"""Results of ``estimate_endpoint_of_rows``: there is no endpoint; nothing was done, enlarge the history and repeat;
nothing was done, because rows are missing."""
WORST_USABLE_STATE = int(max(USABLE_STATES))


class Endpoints(NamedTuple):
    """Endpoints of n scans of an arm of j joints; all numbers of a scan are NaN where a joint has a fault."""

    poses: FloatArray  # endpoint in the chain's base frame, (n, 7): x, y, z [m], unit quaternion x, y, z, w
    covariances_random: FloatArray  # (n, 6, 6), as ``Endpoint.covariance_random``
    covariances_systematic: FloatArray  # (n, 6, 6), as ``Endpoint.covariance_systematic``
    angles: FloatArray  # joint angles about the nominal axes [rad], (n, j)
    faults: IntArray  # (n, j): zero, or a key of ``joint_measurements.FAULT_TEXTS``
    shared_effects: FloatArray  # change by one standard uncertainty of each shared term, (n, K, 6)
    # Largest error along and about each axis of the base by errors of the stamps, (n, 6) [m], [rad]
    stamp_shifts: FloatArray

    @classmethod
    def allocate(cls, scans: int, joints: int, terms: int = 0) -> Endpoints:
        """Return NaN for all scans, without faults."""
        return cls(
            np.full((scans, 7), np.nan),
            np.full((scans, 6, 6), np.nan),
            np.full((scans, 6, 6), np.nan),
            np.full((scans, joints), np.nan),
            np.zeros((scans, joints), dtype=np.int64),
            np.full((scans, terms, 6), np.nan),
            np.full((scans, 6), np.nan),
        )

    @property
    def usable(self) -> BoolArray:
        """Which scans have an endpoint, (n,)."""
        usable: BoolArray = np.all(self.faults == 0, axis=1)
        return usable

    def covariances(self) -> FloatArray:
        """Return the sums of both covariances, (n, 6, 6)."""
        return self.covariances_random + self.covariances_systematic

    def relative_to(self, home: FloatArray) -> Endpoints:
        """Return the endpoints in the axes of the pose ``home``, (7,), taken as exact."""
        relative = self.with_own_poses()
        write_relative(home, self, relative)
        return relative

    def with_own_poses(self) -> Endpoints:
        """Return the same with NaN in new arrays of poses and covariances."""
        (scans, joints), terms = self.angles.shape, self.shared_effects.shape[1]
        own = Endpoints.allocate(scans, joints, terms)
        return own._replace(angles=self.angles, faults=self.faults)


@in_place
def _add_bend(
    systematic: Blocks, arm: ArmGeometry, vibrations: RecordArray, scan: int, b: int, force: Vector, parent: Matrix
) -> Blocks:
    """Return the sum with the covariance of the bend of beam b: of its stiffness, and of an uncertain force."""
    beam = arm.beams[b]
    shift = applied(parent, applied(matrix(beam["sigma_shift_gain"], 0), force))
    turn_vector = applied(parent, applied(matrix(beam["sigma_turn_gain"], 0), force))
    systematic = add_outer_product(systematic, 1.0, shift, turn_vector)
    if vibrations.shape[1] == 0:
        return systematic
    vibration = vibrations[scan, b]
    systematic = _add_force(
        systematic,
        vibration["sigma_mean"],
        transposed(matrix(beam["plate_shift_gain"], 0)),
        transposed(matrix(beam["plate_turn_gain"], 0)),
        parent,
    )
    return _add_force(
        systematic,
        vibration["sigma_difference"],
        transposed(matrix(beam["tilt_plate_shift_gain"], 0)),
        transposed(matrix(beam["tilt_plate_turn_gain"], 0)),
        parent,
    )


@in_place
def _add_force(systematic: Blocks, sigma: float, shifts: Matrix, turns: Matrix, parent: Matrix) -> Blocks:
    """Return the sum with the covariance of sigma [m/s^2] along each axis, which shifts and turns a plate per m/s^2."""
    for k in range(3):
        shift, turn = applied(parent, times(sigma, shifts[k])), applied(parent, times(sigma, turns[k]))
        systematic = add_outer_product(systematic, 1.0, shift, turn)
    return systematic


@in_place
def bent_beam(
    arm: ArmGeometry, history: BeamHistory, vibrations: RecordArray, scan: int, b: int, force: Vector
) -> tuple[Matrix, Vector, Vector]:
    """Return the plate at a beam's end in the plate at its start, and the specific force at its centre [m/s^2].

    ``force``: of gravity and motion, is written into ``history``; the beam follows the measured one where
    ``vibrations`` (n, b) have it.
    """
    beam, tilt = arm.beams[b], ZERO_VECTOR  # increase of the force along the beam
    if vibrations.shape[1] > 0:
        put(history.static_forces, b, 0, force)
        if math.isfinite(vibrations[scan, b]["mean"][0]):
            force, tilt = at(vibrations[scan, b]["mean"], 0), at(vibrations[scan, b]["difference"], 0)
    start_turn = _bend(beam["start_turn_gain"], force, beam["tilt_start_turn_gain"], tilt)
    end_turn = _bend(beam["end_turn_gain"], force, beam["tilt_end_turn_gain"], tilt)
    shift = _bend(beam["shift_gain"], force, beam["tilt_shift_gain"], tilt)
    rotation = turned_by(IDENTITY, times(-1.0, start_turn))
    translation = applied(rotation, plus(at(beam["translation"], 0), shift))
    return turned_by(product(rotation, matrix(beam["rotation"], 0)), end_turn), translation, force


@in_place
def _bend(gain: FloatArray, force: Vector, tilt_gain: FloatArray, tilt: Vector) -> Vector:
    """Return a motion of a plate under a force at the beam's centre and its increase along the beam."""
    return plus(applied(matrix(gain, 0), force), applied(matrix(tilt_gain, 0), tilt))


@in_place
def compute_endpoint(
    arm: ArmGeometry, history: BeamHistory, measurements: JointMeasurements, endpoints: Endpoints, scan: int
) -> None:
    """Compute pose and covariances of the endpoint of a scan.

    ``history``: ``accelerations`` are read, ``centres`` and ``transforms`` are written.
    """
    poses = measurements.poses[scan]
    random_parts, systematic_parts = measurements.covariances_random[scan], measurements.covariances_systematic[scan]
    # ``unbent`` is the rotation if no beam before sagged: gravity across a beam needs it to first order only.
    rotation = unbent = IDENTITY
    last = translation = (0.0, 0.0, 0.0)
    random = systematic = ZERO_COVARIANCE
    effects, own_effects = endpoints.shared_effects[scan], measurements.shared_effects[scan]
    for k in range(effects.shape[0]):
        for i in range(6):
            effects[k, i] = 0.0
    for n in range(arm.elements.shape[0]):
        element = arm.elements[n]
        fixed = matrix(element["rotation"], 0)
        translation = plus(translation, applied(rotation, at(element["translation"], 0)))
        parent = rotation = product(rotation, fixed)
        unbent = product(unbent, fixed)
        j, b = element["joint"], element["beam"]
        if j >= 0:
            translation = plus(translation, applied(rotation, within(poses, j)))
            turn = rotation_of_pose(poses[j])
            rotation, unbent = product(rotation, turn), product(unbent, turn)
            lever = minus(translation, last)
            random = add_rotated(moved_along(random, lever), parent, random_parts[j])
            systematic = add_rotated(moved_along(systematic, lever), parent, systematic_parts[j])
            move_effects(effects, lever)
            systematic = separate_joint_terms(systematic, arm.joint_terms[j], own_effects[j], parent, effects)
        elif b >= 0:
            beam = arm.beams[b]
            half_span = times(0.5, applied(rotation, at(beam["translation"], 0)))
            centres = history.centres
            centres[3 * b], centres[3 * b + 1], centres[3 * b + 2] = plus(translation, half_span)
            force = row_times(minus(at(arm.gravity, 0), at(history.accelerations, 3 * b)), unbent)
            turn, span, force = bent_beam(arm, history, measurements.vibrations, scan, b, force)
            write_pose(turn, span, history.transforms[b])
            rotation, translation = product(rotation, turn), plus(translation, applied(rotation, span))
            unbent = product(unbent, matrix(beam["rotation"], 0))
            lever = minus(translation, last)
            random = moved_along(random, lever)
            systematic = add_rotated(moved_along(systematic, lever), parent, beam["covariance"])
            systematic = _add_bend(systematic, arm, measurements.vibrations, scan, b, force, parent)
            move_effects(effects, lever)
            add_beam_terms(arm, b, force, parent, effects)
        else:
            lever = minus(translation, last)
            random, systematic = moved_along(random, lever), moved_along(systematic, lever)
            move_effects(effects, lever)
        last = translation
    for k in range(effects.shape[0]):
        systematic = add_outer_product(systematic, 1.0, within(effects, k, 0), within(effects, k, 3))
    write_covariance(random, endpoints.covariances_random[scan])
    write_covariance(systematic, endpoints.covariances_systematic[scan])
    write_pose(rotation, translation, endpoints.poses[scan])


@in_place
def joint_angle(pose: FloatArray, origin: FloatArray, theta: float) -> float:
    """Return the angle of a joint about its nominal axis [rad]: the heading of the target's Y axis about that axis.

    ``pose``: target plate in receiving plate, (7,); ``origin``: rotation of the joint's origin in the receiving plate,
    (3, 3); ``theta``: counted heading about Z of the receiving plate [rad], which gives the number of turns; NaN: not
    counted, the angle is in (-pi, pi].
    """
    turn = rotation_of_pose(pose)
    heading = turn[0][1], turn[1][1], turn[2][1]
    x, y, _ = row_times(heading, matrix(origin, 0))
    if math.isnan(theta):
        return math.atan2(-x, y)
    return theta + math.atan2(y * heading[0] - x * heading[1], y * heading[1] + x * heading[0])


@in_place
def estimate_endpoints(
    arm: ArmGeometry, history: BeamHistory, measurements: JointMeasurements, endpoints: Endpoints, begin: int
) -> int:
    """Write the endpoints of the scans from ``begin`` on.

    A scan with an unusable joint gets NaN and the fault of the joint, and does not enter the history of the beams.
    Return the number of scans when all are done; else the scan for which ``history`` must be enlarged.
    """
    moving = history.window[0]["length_ns"] > 0
    count: int = measurements.stamps_ns.shape[0]
    for n in range(begin, count):
        poses, stamp_ns = measurements.poses[n], measurements.stamps_ns[n]
        random, systematic = measurements.covariances_random[n], measurements.covariances_systematic[n]
        faults, angles, scratch = endpoints.faults[n], endpoints.angles[n], endpoints.covariances_random[n]
        usable = True
        for j in range(faults.shape[0]):
            theta, origin = measurements.thetas[n, j], arm.joint_positions[j]
            faults[j] = measurement_fault(poses[j], random[j], systematic[j], theta, origin, scratch)
            faults[j] = faults[j] or shared_fault(measurements.shared_effects[n, j], systematic[j])
            faults[j] = faults[j] or stamp_shift_fault(measurements.stamp_shifts[n, j])
            usable = usable and faults[j] == 0
        if not usable:
            write_nan(endpoints, n)
            continue
        if moving:
            if not has_free_row(history):
                return n
            forget_after_gap(stamp_ns, history)
            estimate_accelerations(history)
        compute_endpoint(arm, history, measurements, endpoints, n)
        shifts, end = measurements.stamp_shifts[n], within(endpoints.poses, n)
        bound_stamp_shift(arm, history.transforms, poses, shifts, end, endpoints.stamp_shifts[n])
        if not is_finite(endpoints, n):
            write_nan(endpoints, n)
            for j in range(faults.shape[0]):
                faults[j] = ENDPOINT_NOT_FINITE
            continue
        if moving:
            append_centres(stamp_ns, history)
        for j in range(faults.shape[0]):
            angles[j] = joint_angle(poses[j], arm.joint_origins[j], measurements.thetas[n, j])
    return count


@in_place
def estimate_endpoint_of_rows(
    arm: ArmGeometry,
    history: BeamHistory,
    measurements: JointMeasurements,
    endpoints: Endpoints,
    rows: JointRows,
    stamp_ns: int,
) -> int:
    """Read the joints of one scan from serialised rows into ``measurements`` and write its endpoint.

    ``stamp_ns``: of the scan. Return the worst state of the joints, ``UNUSABLE``, ``HISTORY_FULL`` or ``ROWS_MISSING``.
    Faults are zero where a state is the reason.
    """
    if rows.missing[0] > 0:
        rows.missing[0] = 0
        return ROWS_MISSING
    measurements.stamps_ns[0] = stamp_ns
    worst = 0
    for j in range(rows.numbers.shape[0]):
        worst = max(worst, int(rows.octets[j, rows.layouts[j]["state"]]))
        endpoints.faults[0, j] = 0
    if worst > WORST_USABLE_STATE:
        write_nan(endpoints, 0)
        return UNUSABLE
    for j in range(rows.numbers.shape[0]):
        read_joint(measurements, rows, j, arm.joint_terms)
        effects, first = measurements.fault_effects[0, j], rows.layouts[j]["effects"]
        for c in range(effects.shape[0]):
            for i in range(EFFECT):
                stated = c < rows.layouts[j]["effect_count"]
                effects[c, i] = rows.singles[j, first + EFFECT * c + i] if stated else math.nan
    if estimate_endpoints(arm, history, measurements, endpoints, 0) == 0:
        return HISTORY_FULL
    return UNUSABLE if math.isnan(endpoints.poses[0, 0]) else worst


@in_place
def is_finite(endpoints: Endpoints, n: int) -> bool:
    """Return whether pose and variances of a scan's endpoint are finite; no covariance exceeds the variances."""
    total = 0.0
    for i in range(7):
        total += abs(endpoints.poses[n, i])
    for i in range(6):
        total += abs(endpoints.covariances_random[n, i, i]) + abs(endpoints.covariances_systematic[n, i, i])
    return math.isfinite(total)


@in_place
def write_nan(endpoints: Endpoints, n: int) -> None:
    """Write NaN into all numbers of a scan that has no endpoint."""
    for i in range(7):
        endpoints.poses[n, i] = math.nan
    for i in range(6):
        endpoints.stamp_shifts[n, i] = math.nan
        for k in range(6):
            endpoints.covariances_random[n, i, k] = endpoints.covariances_systematic[n, i, k] = math.nan
        for t in range(endpoints.shared_effects.shape[1]):
            endpoints.shared_effects[n, t, i] = math.nan
    for j in range(endpoints.angles.shape[1]):
        endpoints.angles[n, j] = math.nan


@in_place
def write_relative(home: FloatArray, endpoints: Endpoints, relative: Endpoints) -> None:
    """Write poses, covariances and stamp shifts in the axes of the pose ``home``, (7,), which is taken as exact.

    A stamp shift, an amount along each axis of the base, is bounded along each axis at home by the sum of its parts.
    """
    back = transposed(rotation_of_pose(home))
    for n in range(endpoints.poses.shape[0]):
        translation = applied(back, minus(within(endpoints.poses, n), at(home, 0)))
        write_pose(product(back, rotation_of_pose(endpoints.poses[n])), translation, relative.poses[n])
        random = add_rotated(ZERO_COVARIANCE, back, endpoints.covariances_random[n])
        systematic = add_rotated(ZERO_COVARIANCE, back, endpoints.covariances_systematic[n])
        write_covariance(random, relative.covariances_random[n])
        write_covariance(systematic, relative.covariances_systematic[n])
        for k in range(endpoints.shared_effects.shape[1]):
            put(relative.shared_effects[n], k, 0, applied(back, within(endpoints.shared_effects[n], k, 0)))
            put(relative.shared_effects[n], k, 3, applied(back, within(endpoints.shared_effects[n], k, 3)))
        shifts, own = relative.stamp_shifts[n], endpoints.stamp_shifts[n]
        for first in (0, 3):
            for k in range(3):
                shifts[first + k] = 0.0
            for k in range(3):
                add_amounts(shifts, first, (back[0][k], back[1][k], back[2][k]), own[first + k])
