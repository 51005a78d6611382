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

An encoder is tracked with constant acceleration and white jerk (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, 6.2.3). The uncertainty of an angle that lies ahead is the root mean
square of the last errors of this prediction, each found when its time has come.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.chain.forward_kinematics import (
    ZERO_COVARIANCE,
    Blocks,
    add_outer_product,
    add_rotated,
    compute_endpoint,
    is_finite,
    joint_angle,
    write_covariance,
    write_nan,
)
from posor.chain.joint_measurements import measurement_fault, read_row, shared_fault
from posor.numerics.compiled import in_place, inlined
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
    from posor.chain.joint_measurements import JointMeasurements, JointRows, RecordArray
    from posor.numerics.array_types import FloatArray, IntArray

HISTORY = 1024  # readings of an encoder that are kept, for transforms that arrive late
SEEN = 64  # angles at transforms that are kept, to name the cause of a disagreement
RADIAL_SLOPE = 5e-5  # standard uncertainty of a place on the plate per turned angle [m/rad]
TILT_SLOPE = 5e-5  # of an angle per turned angle [rad/rad]
MEMORY_S = 0.5  # time after which the random variance of an estimate has doubled, without a transform [s]
JERK_S = 0.01  # correlation time of the jerk [s]
LEAD_MEMORY_S = 0.1  # over which the errors of predicted angles are averaged [s]
GATE = 8.0  # standard deviations by which the change of an encoder may differ from that of its POSOR
STEP_GATE = 60.0  # squared norm of six standard normal numbers, above which a transform is a new beginning
TRUSTED_TURN = 0.01  # over which an encoder must follow its POSOR again after a disagreement [rad]
USED, WAITS, TOO_OLD = 0, -1, -2
"""Results for a transform besides faults of its measurement: used, later than the encoder's readings, before them."""
NO_READING, READING_OLD, NO_TRANSFORM, HELD_TOO_LONG, JUMPED, DISAGREES, OFFSET, NOT_FINITE = range(1, 9)

SETTINGS = np.dtype(
    [
        ("variance", float),  # of a reading [rad^2]
        ("half_backlash", float),  # [rad]
        ("slope", float),  # of the reading's slow errors per turned angle [rad/rad]
        ("max_rate", float),  # [rad/s]
        ("jerk_density", float),  # of the white jerk [rad^2/s^5]
        ("max_offset", float),  # largest angle between encoder and POSOR [rad]
        ("stamp_sigma", float),  # standard uncertainty of the encoder's stamps [s]
        ("holdover_ns", np.int64),  # longest time that a joint is carried on
        ("gap_ns", np.int64),  # time without a transform after which a joint counts as carried on
        ("lead_ns", np.int64),
    ]
)
STATE = np.dtype(
    [
        ("readings", np.int64),  # in the history, without interruption
        ("read_ns", np.int64),  # stamp of the newest
        ("used_ns", np.int64),  # stamp of the last transform; 0: none
        ("used_angle", float),  # of the encoder at that time [rad]
        ("used_low", float),  # least and largest angle of the joint within the play then [rad]
        ("used_high", float),
        ("used_rate", float),  # [rad/s]
        ("seen", np.int64),  # number of transforms
        ("error", float),  # estimated, of the reading at that time [rad]
        ("offset", float),  # encoder minus POSOR at the last one [rad]
        ("jumped", np.int64),  # whether a reading was faster than possible since the last transform
        ("disagrees", np.int64),  # whether the encoder does not follow its POSOR
        ("agreed", float),  # angle over which it followed since [rad]
        ("due", np.int64),  # number of readings whose predicted angle has been compared
        ("compared", np.int64),  # number of comparisons
        ("lead_variance", float),  # of an angle that lies ahead [rad^2]
    ]
)


class Angle(NamedTuple):
    """Angle of a joint by its encoder at one time."""

    angle: float  # [rad]
    low: float  # least and largest angle of the joint within the play [rad]
    high: float
    rate: float  # [rad/s]
    variance: float  # of both angles, beside that of the reading [rad^2]
    same: bool  # whether the reading is that at the last transform, so that it has the same error


class EncoderFilter(NamedTuple):
    """Estimates of j joints, and the readings of their encoders."""

    settings: RecordArray  # (j,) of ``SETTINGS``
    states: RecordArray  # (j,) of ``STATE``
    readings: FloatArray  # new readings [rad], (j,); NaN: none
    stamps_ns: IntArray  # of the history, (j, HISTORY), reading n in column n modulo HISTORY
    # Reading, least and largest angle of the joint [rad]; tracked angle, rate and acceleration, (j, HISTORY, 6)
    history: FloatArray
    tracks: FloatArray  # covariances of the tracked angle, rate and acceleration, (j, 3, 3)
    # At the last transform: plate if the reading has no error, (j, 7), and covariance of both, (j, 7, 7)
    poses: FloatArray
    random: FloatArray
    seen: FloatArray  # angle of the POSOR and of the encoder at transforms [rad], (j, SEEN, 2), as the history
    faults: IntArray  # of the joints in the last prediction, (j,): zero, or why there is no endpoint
    held: IntArray  # which joints have no transform for longer than ``gap_ns``, (j,)
    rates: FloatArray  # now and ahead [rad/s], (2, j)
    rate_variances: FloatArray  # (2, j)
    scratch: FloatArray  # (4, 7, 7)

    @classmethod
    def allocate(cls, joints: int) -> EncoderFilter:
        """Return a filter that has seen nothing; ``settings`` are to be filled."""
        return cls(
            np.zeros(joints, dtype=SETTINGS),
            np.zeros(joints, dtype=STATE),
            np.full(joints, np.nan),
            np.zeros((joints, HISTORY), dtype=np.int64),
            np.zeros((joints, HISTORY, 6)),
            np.zeros((joints, 3, 3)),
            np.zeros((joints, 7)),
            np.zeros((joints, 7, 7)),
            np.zeros((joints, SEEN, 2)),
            np.zeros(joints, dtype=np.int64),
            np.zeros(joints, dtype=np.int64),
            np.zeros((2, joints)),
            np.zeros((2, joints)),
            np.zeros((4, 7, 7)),
        )


class Twists(NamedTuple):
    """Velocity of the endpoint [m/s] and its angular velocity [rad/s], axes of the endpoint."""

    twist: FloatArray  # (6,)
    covariance: FloatArray  # (6, 6)

    @classmethod
    def allocate(cls) -> Twists:
        """Return zeros."""
        return cls(np.zeros(6), np.zeros((6, 6)))


@inlined
def _within(joint: float, angle: float, half: float) -> float:
    """Return the angle of a joint that follows its encoder at most ``half`` behind [rad]."""
    return min(max(joint, angle - half), angle + half)


@inlined
def _extrapolated(row: FloatArray, seconds: float) -> float:
    """Return the angle of a row of the history after a time [s]."""
    return float(row[3] + seconds * (row[4] + 0.5 * seconds * row[5]))


@inlined
def _extrapolated_variances(track: FloatArray, density: float, seconds: float) -> tuple[float, float]:
    """Return the variances of angle and rate after a time [s]."""
    s, q = seconds, density * seconds
    rate = track[1, 1] + 2.0 * s * track[1, 2] + s * s * track[2, 2] + q * s * s / 3.0
    angle = track[0, 0] + s * (
        2.0 * track[0, 1] + s * (track[1, 1] + track[0, 2] + s * (track[1, 2] + 0.25 * s * track[2, 2]))
    )
    return angle + q * s * s * s * s / 20.0, rate


@inlined
def _propagate(track: FloatArray, density: float, s: float) -> None:
    """Advance the covariance of a track by a time [s]."""
    for k in range(3):  # F P
        track[0, k] += s * (track[1, k] + 0.5 * s * track[2, k])
        track[1, k] += s * track[2, k]
    for k in range(3):  # (F P) F'
        track[k, 0] += s * (track[k, 1] + 0.5 * s * track[k, 2])
        track[k, 1] += s * track[k, 2]
    q = density * s
    track[0, 0] += q * s * s * s * s / 20.0
    track[0, 1] += q * s * s * s / 8.0
    track[0, 2] += q * s * s / 6.0
    track[1, 1] += q * s * s / 3.0
    track[1, 2] += q * s / 2.0
    track[2, 2] += q
    track[1, 0], track[2, 0], track[2, 1] = track[0, 1], track[0, 2], track[1, 2]


@inlined
def _begin_track(encoders: EncoderFilter, j: int, angle: float, low: float, high: float) -> None:
    """Begin the history of an encoder with a reading."""
    settings, row, track = encoders.settings[j], encoders.history[j, 0], encoders.tracks[j]
    encoders.states[j]["readings"] = encoders.states[j]["due"] = encoders.states[j]["compared"] = 0
    row[0], row[1], row[2], row[3], row[4], row[5] = angle, low, high, angle, 0.0, 0.0
    for i in range(3):
        for k in range(3):
            track[i, k] = 0.0
    track[0, 0], track[1, 1] = settings["variance"], square(settings["max_rate"])
    track[2, 2] = square(settings["max_rate"] / JERK_S)


@inlined
def _compare_predicted(encoders: EncoderFilter, j: int, stamp_ns: int, angle: float) -> None:
    """Compare a reading with what was predicted ``lead_ns`` before."""
    settings, state = encoders.settings[j], encoders.states[j]
    lead_ns, n, end, found = settings["lead_ns"], state["due"], state["readings"], False
    if end - n >= HISTORY:
        n = end - HISTORY + 1
    while n < end and encoders.stamps_ns[j, n % HISTORY] + lead_ns <= stamp_ns:
        n += 1
        found = True
    if found:
        before_ns = encoders.stamps_ns[j, (n - 1) % HISTORY]
        error = angle - _extrapolated(encoders.history[j, (n - 1) % HISTORY], (stamp_ns - before_ns) * 1e-9)
        state["compared"] += 1
        weight = min(1.0, max((stamp_ns - state["read_ns"]) * 1e-9 / LEAD_MEMORY_S, 1.0 / state["compared"]))
        state["lead_variance"] += weight * (square(error) - state["lead_variance"])
    state["due"] = n


@inlined
def _read(encoders: EncoderFilter, j: int, stamp_ns: int, angle: float) -> None:
    """Add a reading of an encoder; stamps that go back begin anew, a repeated stamp is ignored."""
    settings, state, track = encoders.settings[j], encoders.states[j], encoders.tracks[j]
    count, elapsed = state["readings"], (stamp_ns - state["read_ns"]) * 1e-9
    if count > 0 and elapsed == 0.0:
        return
    half = settings["half_backlash"]
    if count == 0 or elapsed < 0.0:
        if count > 0:
            state["used_ns"] = state["jumped"] = state["disagrees"] = state["seen"] = 0
        _begin_track(encoders, j, angle, angle - half, angle + half)
    else:
        last = encoders.history[j, (count - 1) % HISTORY]
        low, high = _within(last[1], angle, half), _within(last[2], angle, half)
        allowed = settings["max_rate"] * elapsed + GATE * math.sqrt(2.0 * settings["variance"])
        if abs(angle - last[0]) > allowed:
            state["jumped"] = 1
            _begin_track(encoders, j, angle, low, high)
        elif stamp_ns - state["read_ns"] > settings["holdover_ns"]:
            _begin_track(encoders, j, angle, low, high)
        else:
            if settings["lead_ns"] > 0:
                _compare_predicted(encoders, j, stamp_ns, angle)
            _propagate(track, settings["jerk_density"], elapsed)
            total = track[0, 0] + settings["variance"]
            deviation = angle - _extrapolated(last, elapsed)
            row = encoders.history[j, count % HISTORY]
            gains = track[0, 0] / total, track[0, 1] / total, track[0, 2] / total
            row[0], row[1], row[2] = angle, low, high
            row[3] = _extrapolated(last, elapsed) + gains[0] * deviation
            row[4] = last[4] + elapsed * last[5] + gains[1] * deviation
            row[5] = last[5] + gains[2] * deviation
            for i in range(3):
                for k in range(3):
                    track[i, k] -= gains[i] * gains[k] * total
    count = state["readings"]
    encoders.stamps_ns[j, count % HISTORY] = stamp_ns
    state["readings"], state["read_ns"] = count + 1, stamp_ns


@inlined
def _angle_at(encoders: EncoderFilter, j: int, stamp_ns: int) -> Angle:
    """Return the angle at a time between readings, by a cubic with their rates; NaN: before the history."""
    stamps, n, used = encoders.stamps_ns[j], encoders.states[j]["readings"] - 1, encoders.states[j]["used_angle"]
    first = max(0, n - HISTORY + 1)
    while n > first and stamps[n % HISTORY] > stamp_ns:
        n -= 1
    here = encoders.history[j, n % HISTORY]
    if stamps[n % HISTORY] == stamp_ns:
        return Angle(here[0], here[1], here[2], here[4], 0.0, here[0] == used)
    if stamps[n % HISTORY] > stamp_ns:
        return Angle(math.nan, math.nan, math.nan, math.nan, math.nan, False)  # noqa: FBT003  kernels take no keywords
    after = encoders.history[j, (n + 1) % HISTORY]
    step = (stamps[(n + 1) % HISTORY] - stamps[n % HISTORY]) * 1e-9
    s = (stamp_ns - stamps[n % HISTORY]) * 1e-9 / step
    change = after[0] - here[0]
    bend = s * (1.0 - s) * ((1.0 - s) * (step * here[4] - change) + s * (change - step * after[4]))
    angle, rate = here[0] + s * change + bend, here[4] + s * (after[4] - here[4])
    half = encoders.settings[j]["half_backlash"]
    return Angle(angle, _within(here[1], angle, half), _within(here[2], angle, half), rate, 0.0, angle == used)


@inlined
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
    sigma = math.sqrt(to.variance + slope + square(most - least) / 12.0)
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


@inlined
def _write_with_error(prior: FloatArray, shift: Vector, axis: Vector, gains: FloatArray, total: FloatArray) -> None:
    """Write the covariance of the plate with the error of its reading, (6, 6), and of both states with it, (7, 6)."""
    effect = (*shift, *axis)
    for k in range(6):
        for i in range(7):
            gains[i, k] = prior[i, k] + prior[6, i] * effect[k]
    for i in range(6):
        for k in range(6):
            total[i, k] = gains[i, k] + effect[i] * gains[6, k]


@inlined
def _widened(blocks: Blocks, place: float, turn: float) -> Blocks:
    """Return the sum with independent variances along [m^2] and about [rad^2] each axis."""
    (a, b, c, d, e, f), mixed, (g, h, i, j, k, m) = blocks
    return (a + place, b, c, d + place, e, f + place), mixed, (g + turn, h, i, j + turn, k, m + turn)


@inlined
def turned(rotation: Matrix, vector: Vector) -> Matrix:
    """Return a rotation turned by a vector [rad] in the axes of the parent."""
    return product(turned_by(IDENTITY, vector), rotation)


@inlined
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


@inlined
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
    to = _angle_at(encoders, j, stamp_ns)
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
    state["used_low"], state["used_high"], state["jumped"] = to.low, to.high, 0
    return USED


@inlined
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


@inlined
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


@inlined
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
    random, systematic = measurements.covariances_random[0, j], measurements.covariances_systematic[0, j]
    measurements.thetas[0, j] = read_row(
        rows.layouts, j, rows.numbers[j], measurements.poses[0, j], random, systematic, measurements.stamp_shifts[0, j]
    )
    shared, first = measurements.shared_effects[0, j], rows.layouts[j]["shared"]
    for t in range(shared.shape[0]):
        for i in range(6):
            shared[t, i] = rows.numbers[j, first + 6 * t + i] if arm.joint_terms[j, t] >= 0 else 0.0
    return _use(encoders, arm, measurements, j, stamp_ns)


@inlined
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


@inlined
def _predict(
    encoders: EncoderFilter, arm: ArmGeometry, measurements: JointMeasurements, j: int, stamp_ns: int, lead_ns: int
) -> None:
    """Write pose and random covariance of a joint at ``lead_ns`` after a stamp, and its rate."""
    settings, state, track = encoders.settings[j], encoders.states[j], encoders.tracks[j]
    row = encoders.history[j, (state["readings"] - 1) % HISTORY]
    ahead = (stamp_ns + lead_ns - state["read_ns"]) * 1e-9
    rate, n = row[4] + ahead * row[5], 1 if lead_ns > 0 else 0
    variance, of_rate = _extrapolated_variances(track, settings["jerk_density"], ahead)
    if lead_ns > 0 and state["compared"] > 0:
        of_rate *= max(1.0, state["lead_variance"] / variance)
        found = max(0.0, state["lead_variance"] - 2.0 * settings["variance"])  # those of both readings
        variance = found if stamp_ns == state["read_ns"] else max(found, variance)
    angle, half = _extrapolated(row, ahead), settings["half_backlash"]
    if ahead == 0.0:
        angle, variance = row[0], 0.0
    same = row[0] == state["used_angle"]
    to = Angle(angle, _within(row[1], angle, half), _within(row[2], angle, half), rate, variance, same)
    encoders.rates[n, j], encoders.rate_variances[n, j] = rate, of_rate
    seconds, prior = (stamp_ns + lead_ns - state["used_ns"]) * 1e-9, encoders.scratch[2]
    rotation, translation, shift, axis, error = _carry(encoders, arm, j, to, seconds, prior)
    _write_with_error(prior, shift, axis, encoders.scratch[1], measurements.covariances_random[0, j])
    translation = plus(translation, times(error, shift))
    write_pose(turned(rotation, times(error, axis)), translation, measurements.poses[0, j])


@inlined
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


@inlined
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
            _read(encoders, j, stamp_ns, encoders.readings[j])
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
