# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of the encoders of joints: their history, the play of their gears, and the angles that lie ahead.

A joint follows its encoder at most half the stated backlash behind (play operator): of its two ends the history keeps
where the joint is if it was at this end before.

An encoder is tracked with constant acceleration and white jerk (Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, 6.2.3). The uncertainty of an angle that lies ahead is the root mean
square of the last errors of this prediction, each found when its time has come.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.numerics.compiled import in_place
from posor.numerics.vector import square

if TYPE_CHECKING:
    from posor.chain.joint_measurements import RecordArray
    from posor.numerics.array_types import FloatArray, IntArray

HISTORY = 1024  # readings of an encoder that are kept, for transforms that arrive late
SEEN = 64  # angles at transforms that are kept, to name the cause of a disagreement
JERK_S = 0.01  # correlation time of the jerk [s]
LEAD_MEMORY_S = 0.1  # over which the errors of predicted angles are averaged [s]
GATE = 8.0  # standard deviations by which the change of an encoder may differ from that of its POSOR

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
        ("used_variance", float),  # of ``used_angle`` by interpolation [rad^2]
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


@in_place
def within_play(joint: float, angle: float, half: float) -> float:
    """Return the angle of a joint that follows its encoder at most ``half`` behind [rad]."""
    return min(max(joint, angle - half), angle + half)


@in_place
def extrapolated(row: FloatArray, seconds: float) -> float:
    """Return the angle of a row of the history after a time [s]."""
    return float(row[3] + seconds * (row[4] + 0.5 * seconds * row[5]))


@in_place
def extrapolated_variances(track: FloatArray, density: float, seconds: float) -> tuple[float, float]:
    """Return the variances of angle and rate after a time [s]."""
    s, q = seconds, density * seconds
    rate = track[1, 1] + 2.0 * s * track[1, 2] + s * s * track[2, 2] + q * s * s / 3.0
    angle = track[0, 0] + s * (
        2.0 * track[0, 1] + s * (track[1, 1] + track[0, 2] + s * (track[1, 2] + 0.25 * s * track[2, 2]))
    )
    return angle + q * s * s * s * s / 20.0, rate


@in_place
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


@in_place
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


@in_place
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
        error = angle - extrapolated(encoders.history[j, (n - 1) % HISTORY], (stamp_ns - before_ns) * 1e-9)
        state["compared"] += 1
        weight = min(1.0, max((stamp_ns - state["read_ns"]) * 1e-9 / LEAD_MEMORY_S, 1.0 / state["compared"]))
        state["lead_variance"] += weight * (square(error) - state["lead_variance"])
    state["due"] = n


@in_place
def add_reading(encoders: EncoderFilter, j: int, stamp_ns: int, angle: float) -> None:
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
        low, high = within_play(last[1], angle, half), within_play(last[2], angle, half)
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
            deviation = angle - extrapolated(last, elapsed)
            row = encoders.history[j, count % HISTORY]
            gains = track[0, 0] / total, track[0, 1] / total, track[0, 2] / total
            row[0], row[1], row[2] = angle, low, high
            row[3] = extrapolated(last, elapsed) + gains[0] * deviation
            row[4] = last[4] + elapsed * last[5] + gains[1] * deviation
            row[5] = last[5] + gains[2] * deviation
            for i in range(3):
                for k in range(3):
                    track[i, k] -= gains[i] * gains[k] * total
    count = state["readings"]
    encoders.stamps_ns[j, count % HISTORY] = stamp_ns
    state["readings"], state["read_ns"] = count + 1, stamp_ns


@in_place
def angle_at(encoders: EncoderFilter, j: int, stamp_ns: int) -> Angle:
    """Return the angle at a time between readings, by a cubic with their rates; NaN: before the history.

    Tracked rates lag where the motion changes: their mean is then not that of the readings, which bounds the error.
    """
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
    lag = s * (1.0 - s) * (0.5 * step * (here[4] + after[4]) - change)
    angle, rate = here[0] + s * change + bend, here[4] + s * (after[4] - here[4])
    half = encoders.settings[j]["half_backlash"]
    low, high = within_play(here[1], angle, half), within_play(here[2], angle, half)
    return Angle(angle, low, high, rate, square(lag), angle == used)
