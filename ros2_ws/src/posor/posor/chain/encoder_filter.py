# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint between scans: transforms of POSORs carried on by the encoders of the joints.

The estimate of a joint is its pose T at the stamp of its last transform. Since then the target plate has turned about
the nominal axis by the change d of the encoder: ``T' = A(d) T``. The errors of T' are those of T, turned by A(d), and

* along and about each axis RADIAL_SLOPE d and TILT_SLOPE d: the true axis is elsewhere, a bearing has error motions;
* about the joint's axis the stated slope times d; the change of the rate times the uncertainty of the stamps; backlash;
* the error of the reading, white, but the same while the reading does not change. It is the seventh state.

A joint follows its encoder at most half the stated backlash behind (play operator). Where it was within the play before
the first reading is not known, nor whether its load keeps it in contact. So its change is between that of the encoder
and those of both ends of the play: it is taken in the middle, with a rectangular distribution.

A transform is fused with T' by the Kalman gain of the random covariances (error state in the axes of the parent, turn
on the parent's side). All transforms have the same systematic error: it is a consider state (S. F. Schmidt, 1966),
which no gain lowers, so the systematic covariance stays whole. The filter forgets over MEMORY_S.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.chain.encoder_track import (
    GATE,
    HISTORY,
    SEEN,
    Angle,
    EncoderFilter,
    add_reading,
    angle_at,
    extrapolated,
    extrapolated_variances,
    within_play,
)
from posor.chain.error_propagation import ZERO_COVARIANCE, Blocks, add_outer_product, add_rotated, write_covariance
from posor.chain.forward_kinematics import compute_endpoint, is_finite, joint_angle, write_nan
from posor.chain.joint_measurements import measurement_fault, read_joint, shared_fault
from posor.numerics.compiled import in_place
from posor.numerics.matrix import cholesky_factorise, solve_lower_triangular
from posor.numerics.vector import (
    IDENTITY,
    Matrix,
    Vector,
    applied,
    at,
    cross,
    dot,
    matrix,
    minus,
    plus,
    product,
    put,
    rotation_of_pose,
    square,
    store,
    times,
    transposed,
    turned_by,
    within,
    wrapped,
    write_pose,
)

if TYPE_CHECKING:
    from posor.chain.arm_geometry import ArmGeometry
    from posor.chain.beam_acceleration import BeamHistory
    from posor.chain.forward_kinematics import Endpoints
    from posor.chain.joint_measurements import JointMeasurements, JointRows
    from posor.numerics.array_types import FloatArray

RADIAL_SLOPE = 5e-5  # standard uncertainty of a place on the plate per turned angle [m/rad]
TILT_SLOPE = 5e-5  # of an angle per turned angle [rad/rad]
MEMORY_S = 0.5  # time after which the random variance of an estimate has doubled, without a transform [s]
STEP_GATE = 60.0  # squared norm of six standard normal numbers, above which a transform is a new beginning
TRUSTED_TURN = 0.01  # over which an encoder must follow its POSOR again after a disagreement [rad]
USED, WAITS, TOO_OLD = 0, -1, -2
"""Results for a transform besides faults of its measurement: used, later than the encoder's readings, before them."""
NO_READING, READING_OLD, NO_TRANSFORM, HELD_TOO_LONG, JUMPED, DISAGREES, OFFSET, NOT_FINITE = range(1, 9)


class Twists(NamedTuple):
    """Velocity of the endpoint [m/s] and its angular velocity [rad/s], axes of the endpoint."""

    twist: FloatArray  # (6,)
    covariance: FloatArray  # (6, 6)

    @classmethod
    def allocate(cls) -> Twists:
        """Return zeros."""
        return cls(np.zeros(6), np.zeros((6, 6)))


@in_place
def _carry(
    encoders: EncoderFilter, arm: ArmGeometry, j: int, to: Angle, seconds: float, prior: FloatArray
) -> tuple[Matrix, Vector, Vector, Vector, float]:
    """Return the plate of a joint at an angle if the reading has no error, and the effect of that error.

    That is rotation, translation, shift and turn per angle, and the estimated error of the reading. ``prior``, (7, 7),
    becomes the covariance of the plate and of that error. ``seconds``: from the last transform.
    """
    settings, state, pose = encoders.settings[j], encoders.states[j], encoders.poses[j]
    origin, covariance = arm.joint_origins[j], encoders.random[j]
    axis, place = (origin[0, 2], origin[1, 2], origin[2, 2]), within(arm.joint_positions, j)
    by_reading, low, high = to.angle - state["used_angle"], to.low - state["used_low"], to.high - state["used_high"]
    least, most = min(by_reading, low, high), max(by_reading, low, high)
    change = 0.5 * (most + least)
    turn = turned_by(IDENTITY, times(change, axis))
    arm_of_plate = applied(turn, minus(at(pose, 0), place))
    shift = cross(axis, arm_of_plate)
    kept = math.sqrt(1.0 + max(0.0, seconds) / MEMORY_S)
    grown = times(kept, turn[0]), times(kept, turn[1]), times(kept, turn[2])
    blocks = add_rotated(ZERO_COVARIANCE, grown, covariance)
    slope = square(settings["slope"] * change) + square((to.rate - state["used_rate"]) * settings["stamp_sigma"])
    sigma = math.sqrt(state["used_variance"] + to.variance + slope + square(most - least) / 12.0)
    blocks = add_outer_product(blocks, 1.0, times(sigma, shift), times(sigma, axis))
    blocks = _widened(blocks, square(RADIAL_SLOPE * change), square(TILT_SLOPE * change))
    write_covariance(blocks, prior)
    error, own, mixed, mixed_turn = 0.0, settings["variance"], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if to.same:
        error, own = state["error"], covariance[6, 6]
        mixed, mixed_turn = applied(turn, within(covariance, 6, 0)), applied(turn, within(covariance, 6, 3))
    put(prior, 6, 0, mixed)
    put(prior, 6, 3, mixed_turn)
    prior[6, 6] = own
    return product(turn, rotation_of_pose(pose)), plus(place, arm_of_plate), shift, axis, error


@in_place
def _write_with_error(prior: FloatArray, shift: Vector, axis: Vector, gains: FloatArray, total: FloatArray) -> None:
    """Write the covariance of the plate with the error of its reading, (6, 6), and of both states with it, (7, 6)."""
    effect = (*shift, *axis)
    for k in range(6):
        for i in range(7):
            gains[i, k] = prior[i, k] + prior[6, i] * effect[k]
    for i in range(6):
        for k in range(6):
            total[i, k] = gains[i, k] + effect[i] * gains[6, k]


@in_place
def _widened(blocks: Blocks, place: float, turn: float) -> Blocks:
    """Return the sum with independent variances along [m^2] and about [rad^2] each axis."""
    (a, b, c, d, e, f), mixed, (g, h, i, j, k, m) = blocks
    return (a + place, b, c, d + place, e, f + place), mixed, (g + turn, h, i, j + turn, k, m + turn)


@in_place
def turned(rotation: Matrix, vector: Vector) -> Matrix:
    """Return a rotation turned by a vector [rad] in the axes of the parent."""
    return product(turned_by(IDENTITY, vector), rotation)


@in_place
def _rotation_vector(rotation: Matrix) -> Vector:
    """Return the logarithm of a rotation [rad]; of half a turn some vector of that length."""
    x, y, z = rotation[2][1] - rotation[1][2], rotation[0][2] - rotation[2][0], rotation[1][0] - rotation[0][1]
    sine, cosine = (
        0.5 * math.sqrt(x * x + y * y + z * z),
        0.5 * (rotation[0][0] + rotation[1][1] + rotation[2][2] - 1.0),
    )
    if sine == 0.0:
        return (0.0, 0.0, 0.0 if cosine > 0.0 else math.pi)
    return times(0.5 * math.atan2(sine, cosine) / sine, (x, y, z))


@in_place
def _use(encoders: EncoderFilter, arm: ArmGeometry, measurements: JointMeasurements, j: int, stamp_ns: int) -> int:
    """Fuse the measurement of a joint with what its encoder predicts; return ``USED``, or why not."""
    state = encoders.states[j]
    pose, random, systematic = (
        measurements.poses[0, j],
        measurements.covariances_random[0, j],
        measurements.covariances_systematic[0, j],
    )
    theta, position = measurements.thetas[0, j], arm.joint_positions[j]
    fault = measurement_fault(pose, random, systematic, theta, position, encoders.scratch[0])
    fault = fault or shared_fault(measurements.shared_effects[0, j], systematic)
    if fault != 0:
        return fault
    if state["readings"] == 0 or stamp_ns > state["read_ns"]:
        return WAITS
    to = angle_at(encoders, j, stamp_ns)
    if math.isnan(to.angle) or stamp_ns <= state["used_ns"]:
        return TOO_OLD
    angle = joint_angle(pose, arm.joint_origins[j], math.nan)
    seen = encoders.seen[j, state["seen"] % SEEN]
    seen[0], seen[1] = angle, to.angle
    state["seen"] += 1
    state["offset"] = wrapped(to.angle - angle)
    if state["used_ns"] != 0 and _fuse(encoders, arm, j, to, stamp_ns, pose, random):
        state["agreed"] += abs(to.angle - state["used_angle"])
        if state["agreed"] >= TRUSTED_TURN:
            state["disagrees"] = 0
    else:
        _begin(encoders, arm, j, pose, random)
    state["used_ns"], state["used_angle"], state["used_rate"] = stamp_ns, to.angle, to.rate
    state["used_low"], state["used_high"], state["used_variance"], state["jumped"] = to.low, to.high, to.variance, 0
    return USED


@in_place
def _begin(encoders: EncoderFilter, arm: ArmGeometry, j: int, pose: FloatArray, random: FloatArray) -> None:
    """Take a measurement as the estimate of a joint: the plate with the error of the reading is known that well."""
    covariance, origin, variance = encoders.random[j], arm.joint_origins[j], encoders.settings[j]["variance"]
    axis = origin[0, 2], origin[1, 2], origin[2, 2]
    shift = cross(axis, minus(at(pose, 0), within(arm.joint_positions, j)))
    blocks = add_rotated(ZERO_COVARIANCE, IDENTITY, random)
    sigma = math.sqrt(variance)
    write_covariance(add_outer_product(blocks, 1.0, times(sigma, shift), times(sigma, axis)), covariance)
    put(covariance, 6, 0, times(-variance, shift))
    put(covariance, 6, 3, times(-variance, axis))
    covariance[6, 6], encoders.states[j]["error"] = variance, 0.0
    for k in range(7):
        encoders.poses[j, k] = pose[k]


@in_place
def _fuse(
    encoders: EncoderFilter, arm: ArmGeometry, j: int, to: Angle, stamp_ns: int, pose: FloatArray, random: FloatArray
) -> bool:
    """Replace the estimate of a joint by its mean with a measurement; false: they differ too much for that."""
    state, deviation = encoders.states[j], encoders.scratch[3, 0]
    total, gains, prior = encoders.scratch[0], encoders.scratch[1], encoders.scratch[2]
    seconds = (stamp_ns - state["used_ns"]) * 1e-9
    rotation, translation, shift, axis, error = _carry(encoders, arm, j, to, seconds, prior)
    rotation, translation = turned(rotation, times(error, axis)), plus(translation, times(error, shift))
    _write_with_error(prior, shift, axis, gains, total)
    for i in range(6):
        for k in range(6):
            total[i, k] += random[i, k]
    away = minus(at(pose, 0), translation)
    turn = _rotation_vector(product(rotation_of_pose(pose), transposed(rotation)))
    about = matrix(total, 3, 3)
    if square(dot(axis, turn)) > square(GATE) * dot(axis, applied(about, axis)):
        state["disagrees"], state["agreed"] = 1, 0.0
        return False
    if not cholesky_factorise(total, 6):
        return False
    store(deviation, 0, away)
    store(deviation, 3, turn)
    solve_lower_triangular(total, 6, deviation)
    norm = 0.0
    for i in range(6):
        norm += square(deviation[i])
    if norm > STEP_GATE:
        return False
    _write_mean(encoders, j)
    state["error"] = error + encoders.scratch[3, 1, 6]
    # The estimate is the plate without the error of the reading.
    rotation = turned(rotation, minus(at(encoders.scratch[3, 1], 3), times(error, axis)))
    translation = plus(translation, minus(at(encoders.scratch[3, 1], 0), times(error, shift)))
    write_pose(rotation, translation, encoders.poses[j])
    return True


@in_place
def _write_mean(encoders: EncoderFilter, j: int) -> None:
    """Write the step of the seven states into ``scratch[3, 1]`` and their covariance, from what ``_fuse`` has left."""
    total, gains, prior = encoders.scratch[0], encoders.scratch[1], encoders.scratch[2]
    deviation, step, covariance = encoders.scratch[3, 0], encoders.scratch[3, 1], encoders.random[j]
    for i in range(7):
        solve_lower_triangular(total, 6, gains[i])
        step[i] = 0.0
        for k in range(6):
            step[i] += gains[i, k] * deviation[k]
        for m in range(i + 1):
            covariance[i, m] = prior[i, m]
            for k in range(6):
                covariance[i, m] -= gains[i, k] * gains[m, k]
            covariance[m, i] = covariance[i, m]


@in_place
def use_transform(
    encoders: EncoderFilter, arm: ArmGeometry, measurements: JointMeasurements, j: int, stamp_ns: int
) -> int:
    """Use the measurement of a joint at a stamp [ns]; return ``USED``, ``WAITS``, ``TOO_OLD`` or the fault found."""
    return _use(encoders, arm, measurements, j, stamp_ns)


@in_place
def use_transform_row(
    encoders: EncoderFilter, arm: ArmGeometry, measurements: JointMeasurements, rows: JointRows, j: int, stamp_ns: int
) -> int:
    """Read the measurement of a joint from its serialised row and use it, see ``use_transform``."""
    read_joint(measurements, rows, j, arm.joint_terms)
    return _use(encoders, arm, measurements, j, stamp_ns)


@in_place
def _fault(encoders: EncoderFilter, j: int, stamp_ns: int) -> int:
    """Return zero, or why a joint cannot be predicted at a stamp."""
    settings, state = encoders.settings[j], encoders.states[j]
    fault = 0
    if state["readings"] == 0:
        fault = NO_READING
    elif stamp_ns - state["read_ns"] > settings["holdover_ns"]:
        fault = READING_OLD
    elif state["used_ns"] == 0:
        fault = NO_TRANSFORM
    elif stamp_ns - state["used_ns"] > settings["holdover_ns"]:
        fault = HELD_TOO_LONG
    elif state["jumped"] != 0:
        fault = JUMPED
    elif state["disagrees"] != 0:
        fault = DISAGREES
    elif abs(state["offset"]) > settings["max_offset"]:
        fault = OFFSET
    return fault


@in_place
def _predict(
    encoders: EncoderFilter, arm: ArmGeometry, measurements: JointMeasurements, j: int, stamp_ns: int, lead_ns: int
) -> None:
    """Write pose and random covariance of a joint at ``lead_ns`` after a stamp, and its rate."""
    settings, state, track = encoders.settings[j], encoders.states[j], encoders.tracks[j]
    row = encoders.history[j, (state["readings"] - 1) % HISTORY]
    ahead = (stamp_ns + lead_ns - state["read_ns"]) * 1e-9
    rate, n = row[4] + ahead * row[5], 1 if lead_ns > 0 else 0
    variance, of_rate = extrapolated_variances(track, settings["jerk_density"], ahead)
    if lead_ns > 0 and state["compared"] > 0:
        of_rate *= max(1.0, state["lead_variance"] / variance)
        found = max(0.0, state["lead_variance"] - 2.0 * settings["variance"])  # those of both readings
        variance = found if stamp_ns == state["read_ns"] else max(found, variance)
    angle, half = extrapolated(row, ahead), settings["half_backlash"]
    if ahead == 0.0:
        angle, variance = row[0], 0.0
    same = row[0] == state["used_angle"]
    to = Angle(angle, within_play(row[1], angle, half), within_play(row[2], angle, half), rate, variance, same)
    encoders.rates[n, j], encoders.rate_variances[n, j] = rate, of_rate
    seconds, prior = (stamp_ns + lead_ns - state["used_ns"]) * 1e-9, encoders.scratch[2]
    rotation, translation, shift, axis, error = _carry(encoders, arm, j, to, seconds, prior)
    _write_with_error(prior, shift, axis, encoders.scratch[1], measurements.covariances_random[0, j])
    translation = plus(translation, times(error, shift))
    write_pose(turned(rotation, times(error, axis)), translation, measurements.poses[0, j])


@in_place
def _write_twist(
    encoders: EncoderFilter,
    arm: ArmGeometry,
    history: BeamHistory,
    poses: FloatArray,
    end: FloatArray,
    n: int,
    out: Twists,
) -> None:
    """Write the twist of an endpoint at ``end``, (7,), from the rates n of the joints, whose poses are (j, 7)."""
    rotation, translation, point = IDENTITY, (0.0, 0.0, 0.0), at(end, 0)
    velocity = spin = (0.0, 0.0, 0.0)
    blocks = ZERO_COVARIANCE
    for k in range(arm.elements.shape[0]):
        element = arm.elements[k]
        translation = plus(translation, applied(rotation, at(element["translation"], 0)))
        rotation = product(rotation, matrix(element["rotation"], 0))
        j, b = element["joint"], element["beam"]
        if j >= 0:
            origin = arm.joint_origins[j]
            axis = applied(rotation, (origin[0, 2], origin[1, 2], origin[2, 2]))
            place = plus(translation, applied(rotation, within(arm.joint_positions, j)))
            across = cross(axis, minus(point, place))
            velocity = plus(velocity, times(encoders.rates[n, j], across))
            spin = plus(spin, times(encoders.rates[n, j], axis))
            sigma = math.sqrt(encoders.rate_variances[n, j])
            blocks = add_outer_product(blocks, 1.0, times(sigma, across), times(sigma, axis))
            translation = plus(translation, applied(rotation, within(poses, j)))
            rotation = product(rotation, rotation_of_pose(poses[j]))
        elif b >= 0:
            translation = plus(translation, applied(rotation, within(history.transforms, b)))
            rotation = product(rotation, rotation_of_pose(history.transforms[b]))
    back = transposed(rotation_of_pose(end))
    store(out.twist, 0, applied(back, velocity))
    store(out.twist, 3, applied(back, spin))
    write_covariance(blocks, encoders.scratch[0])
    write_covariance(add_rotated(ZERO_COVARIANCE, back, encoders.scratch[0]), out.covariance)


@in_place
def _predict_endpoint(
    encoders: EncoderFilter,
    arm: ArmGeometry,
    history: BeamHistory,
    measurements: JointMeasurements,
    endpoints: Endpoints,
    twists: Twists,
    stamp_ns: int,
    lead_ns: int,
) -> None:
    """Write endpoint and twist at ``lead_ns`` after a stamp; NaN, and a fault of each joint, if they are not finite."""
    for j in range(encoders.faults.shape[0]):
        _predict(encoders, arm, measurements, j, stamp_ns, lead_ns)
    compute_endpoint(arm, history, measurements, endpoints, 0)
    _write_twist(encoders, arm, history, measurements.poses[0], endpoints.poses[0], 1 if lead_ns > 0 else 0, twists)
    if not is_finite(endpoints, 0):
        for j in range(encoders.faults.shape[0]):
            encoders.faults[j] = NOT_FINITE


@in_place
def predict_endpoints(
    encoders: EncoderFilter,
    arm: ArmGeometry,
    history: BeamHistory,
    present: JointMeasurements,
    present_endpoints: Endpoints,
    present_twists: Twists,
    ahead: JointMeasurements,
    ahead_endpoints: Endpoints,
    ahead_twists: Twists,
    stamp_ns: int,
) -> bool:
    """Take the new readings of encoders, and predict the endpoint at their stamp [ns] and ``lead_ns`` later.

    Return whether there is one. Else every number of the endpoints is NaN, and ``faults`` say why.
    """
    usable = True
    for j in range(encoders.faults.shape[0]):
        if not math.isnan(encoders.readings[j]):
            add_reading(encoders, j, stamp_ns, encoders.readings[j])
        encoders.faults[j] = _fault(encoders, j, stamp_ns)
        encoders.held[j] = stamp_ns - encoders.states[j]["used_ns"] > encoders.settings[j]["gap_ns"]
        usable &= encoders.faults[j] == 0
    if usable:
        lead_ns = encoders.settings[0]["lead_ns"]
        _predict_endpoint(encoders, arm, history, present, present_endpoints, present_twists, stamp_ns, 0)
        if lead_ns > 0:
            _predict_endpoint(encoders, arm, history, ahead, ahead_endpoints, ahead_twists, stamp_ns, lead_ns)
        usable = encoders.faults[0] != NOT_FINITE
    if not usable:
        write_nan(present_endpoints, 0)
        write_nan(ahead_endpoints, 0)
    return usable
