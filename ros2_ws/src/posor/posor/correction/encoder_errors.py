# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of a joint's encoder: its readings minus the angles of the POSOR, by angle and direction of motion.

Links bend and twist under gravity, and the POSOR of a joint sees the end of the link before it. A joint that passes an
angle forward in one posture of the arm and backward in another seems to have another backlash. So the backlash is that
of least squares within the bins of angle that have both directions, so that errors which depend on the angle cancel,

    difference = (of the bin) + direction backlash / 2 + k gravity

with the directions of gravity in the plates. The rest of

    difference = offset + direction backlash / 2 + slope (angle - mean) + c cos(angle) + s sin(angle) + windup effort
                 + k gravity

is fitted then, with the part of gravity that the other columns do not explain. A part that the motion does not
determine is NaN: backlash without a bin of both directions, a slope over less than LEAST_RANGE, an eccentricity (c, s)
over less than half a turn, windup without efforts that change. Gravity that follows the own angle, as in an arm whose
other joints stand still, counts as slope and eccentricity.

Late readings, the angles of a time d before their stamps, lag by d times the rate. Where the speed changes by more than
LEAST_CHANGE, d is found within the bins too; its effect is taken off if it exceeds LATE_SIGMAS of its standard
uncertainty, whose errors are alike within a bin (K.-Y. Liang, S. L. Zeger, Biometrika 73(1), 1986, with the bins as
clusters). At one speed it counts as backlash.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray, IntArray

LEAST_RANGE = 0.1  # of angles that determine a slope [rad]
SETTLED_TURN = 1e-3  # from a reversal, from which on a direction is known [rad]
LEAST_CHANGE = 0.1  # of the rate beside its direction, as a share of the rate, root mean squares
LATE_SIGMAS = 5.0
LONGEST_GAP_S = 0.05  # between two scans, for a rate
LEAST_GRAVITY = 0.01  # root mean square of a change of the direction of gravity beyond that by the own angle
FORWARD, BACKWARD = 1, -1


class Row(NamedTuple):
    """Encoder minus POSOR in a bin of angle and direction."""

    direction: int  # FORWARD or BACKWARD
    angle: float  # middle of the bin [rad]
    mean: float  # [rad]
    standard_deviation: float  # [rad]
    readings: int  # number


class EncoderErrors(NamedTuple):
    """Errors of one encoder, and their means in bins of angle and direction."""

    readings: int  # number of angles with a known direction
    range_rad: float  # from the least angle to the largest
    offset: float  # [rad]
    backlash: float  # [rad]
    lateness: float  # time before their stamps at which the joint was where the readings say [s]
    lateness_sigma: float  # its standard uncertainty [s]
    slope: float  # [rad/rad]
    eccentricity: float  # amplitude of the error once per turn [rad]
    windup: float  # [rad/(N m)], or [rad/N]
    gravity: float  # root mean square of the part by gravity in changing postures [rad]
    rest: float  # root mean square of what the fit leaves [rad]
    table: list[Row]


def describe_lateness(errors: EncoderErrors, largest: float) -> str:
    """Return how late or early the readings are, if clearly and by more than ``largest`` [s]; else empty."""
    if not abs(errors.lateness) > max(largest, LATE_SIGMAS * errors.lateness_sigma):
        return ""
    return f"its readings are {1e3 * abs(errors.lateness):.3g} ms {'late' if errors.lateness > 0.0 else 'early'}"


def directions(readings: FloatArray, settled: float = SETTLED_TURN) -> IntArray:
    """Return the direction of motion of successive readings [rad], (n,): 0 until ``settled`` from a reversal."""
    found, direction, turn = np.zeros(len(readings), dtype=np.int64), 0, float(readings[0]) if len(readings) else 0.0
    for n, angle in enumerate(readings.tolist()):
        if direction == 0 and abs(angle - turn) >= settled:
            direction = FORWARD if angle > turn else BACKWARD
        if direction and direction * (angle - turn) >= 0.0:  # ``turn`` is the furthest reading in this direction
            moved, turn = True, angle
        else:
            moved = False
            if direction and abs(angle - turn) >= settled:
                direction, turn, moved = -direction, angle, True
        found[n] = direction if moved else 0
    return found


def encoder_errors(
    angles: FloatArray,
    readings: FloatArray,
    times_s: FloatArray,
    efforts: FloatArray | None = None,
    bins: int = 36,
    gravity: FloatArray | None = None,
) -> EncoderErrors:
    """Return the errors of an encoder whose joint has been at ``angles`` of its POSOR [rad], (n,).

    ``readings``: [rad], (n,); ``times_s``: of both, increasing [s], (n,); ``efforts``: of the drive [N m] or [N], (n,);
    ``bins``: of each direction; ``gravity``: components of the unit vector along gravity in plates of the arm, (n, k).
    """
    gravity = np.empty((len(angles), 0)) if gravity is None else gravity
    known = np.isfinite(angles) & np.isfinite(readings) & np.isfinite(gravity).all(axis=1)
    angles, readings, gravity, times_s = angles[known], readings[known], gravity[known], times_s[known]
    direction = directions(readings)
    difference = readings - angles
    difference -= 2.0 * math.pi * np.round(np.median(difference) / (2.0 * math.pi)) if len(difference) else 0.0
    rates = _rates(times_s, angles)
    moving = (direction != 0) & np.isfinite(rates)
    angles, direction, difference, gravity, rates = (
        each[moving] for each in (angles, direction, difference, gravity, rates)
    )
    if not len(angles):
        return EncoderErrors(0, 0.0, *(math.nan,) * 9, [])
    span, edges = float(np.ptp(angles)), np.linspace(angles.min(), angles.max(), bins + 1)
    which = np.clip(np.searchsorted(edges, angles, side="right") - 1, 0, bins - 1)
    table = _table(edges, which, direction, difference)
    columns = {"offset": np.ones(len(angles))}
    if span >= LEAST_RANGE:
        columns["slope"] = angles - angles.mean()
    if span >= math.pi:
        columns |= {"c": np.cos(angles), "s": np.sin(angles)}
    if efforts is not None and np.ptp(own := efforts[known][moving]) > 0.0:
        columns["windup"] = own - own.mean()
    own_design = np.column_stack(list(columns.values()))
    gravity = _beyond(gravity, own_design)
    lag = _lag(which, direction, difference, rates, np.column_stack([angles, gravity]))
    alike = difference - 0.5 * np.nan_to_num(lag.backlash) * direction + (lag.lateness if lag.is_late else 0.0) * rates
    design = np.column_stack([own_design, gravity])
    values = np.linalg.lstsq(design, alike, rcond=None)[0]
    fitted = dict(zip(columns, map(float, values), strict=False))
    bent = gravity @ values[len(columns) :]
    return EncoderErrors(
        len(angles),
        span,
        fitted["offset"],
        lag.backlash,
        lag.lateness,
        lag.sigma,
        fitted.get("slope", math.nan),
        math.hypot(fitted["c"], fitted["s"]) if "c" in fitted else math.nan,
        fitted.get("windup", math.nan),
        float(np.sqrt(np.mean(np.square(bent)))) if gravity.size else math.nan,
        float(np.sqrt(np.mean(np.square(alike - design @ values)))),
        table,
    )


def _beyond(gravity: FloatArray, own: FloatArray) -> FloatArray:
    """Return what the columns ``own`` (n, m) do not explain of combinations of columns (n, k), where that is much."""
    left = gravity - own @ np.linalg.lstsq(own, gravity, rcond=None)[0]
    _, sizes, directions = np.linalg.svd(left, full_matrices=False)
    return np.asarray(left @ directions[sizes >= LEAST_GRAVITY * math.sqrt(len(gravity))].T)


def _table(edges: FloatArray, which: IntArray, direction: IntArray, difference: FloatArray) -> list[Row]:
    rows = []
    for sign in (FORWARD, BACKWARD):
        for b in range(len(edges) - 1):
            if (own := difference[(direction == sign) & (which == b)]).size:
                middle = 0.5 * float(edges[b] + edges[b + 1])
                rows.append(Row(sign, middle, float(own.mean()), float(own.std()), len(own)))
    return rows


def _rates(times_s: FloatArray, angles: FloatArray) -> FloatArray:
    """Return the rates of increasing times [rad/s], (n,); NaN beside a gap."""
    if len(angles) < 2:  # noqa: PLR2004  a rate lies between two
        return np.full(len(angles), math.nan)
    rates, is_gap = np.gradient(np.unwrap(angles), times_s), np.diff(times_s) > LONGEST_GAP_S
    return np.where(np.append(is_gap, False) | np.insert(is_gap, 0, False), math.nan, rates)


class _Lag(NamedTuple):
    """What differs between the directions within the bins."""

    backlash: float  # [rad]
    lateness: float  # [s]
    sigma: float  # standard uncertainty of the lateness [s]

    @property
    def is_late(self) -> bool:
        """Whether the backlash is that of a fit with the lateness."""
        return abs(self.lateness) > LATE_SIGMAS * self.sigma


def _lag(which: IntArray, direction: IntArray, difference: FloatArray, rates: FloatArray, others: FloatArray) -> _Lag:
    """Return backlash and lateness within the bins, beside other columns (n, k).

    Both are NaN where no bin has both directions, the lateness also where the rate does not change enough.
    """
    columns = np.column_stack([difference, -rates, 0.5 * direction, others])
    sums = np.array([np.bincount(which, column) for column in columns.T])
    columns -= (sums / np.maximum(np.bincount(which), 1)).T[which]
    within, lag, design = columns[:, 0], columns[:, 1], columns[:, 2:]
    if not np.any(design[:, 0]):
        return _Lag(math.nan, math.nan, math.nan)
    backlash = float(np.linalg.lstsq(design, within, rcond=None)[0][0])
    alone = lag - design @ np.linalg.lstsq(design, lag, rcond=None)[0]
    if np.linalg.norm(alone) < LEAST_CHANGE * np.linalg.norm(rates):
        return _Lag(backlash, math.nan, math.nan)
    both = np.column_stack([lag, design])
    lateness, beside, *_ = values = np.linalg.lstsq(both, within, rcond=None)[0]
    of_bins = np.bincount(which, alone * (within - both @ values))
    sigma = float(np.linalg.norm(of_bins) / np.sum(np.square(alone)))
    found = _Lag(float(beside), float(lateness), sigma)
    return found if found.is_late else found._replace(backlash=backlash)
