# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of a joint's encoder: its readings minus the angles of the POSOR, by angle and direction of motion.

The backlash is the mean difference of both directions in the bins of angle that have both, so that errors which depend
on the angle cancel. The rest of

    difference = offset + direction backlash / 2 + slope (angle - mean) + c cos(angle) + s sin(angle) + windup effort

is fitted by least squares. A part that the motion does not determine is NaN: backlash without a bin of both directions,
a slope over less than LEAST_RANGE, an eccentricity (c, s) over less than half a turn, windup without efforts that
change.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray, IntArray

LEAST_RANGE = 0.1  # of angles that determine a slope [rad]
SETTLED_TURN = 1e-3  # from a reversal, from which on a direction is known [rad]
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
    slope: float  # [rad/rad]
    eccentricity: float  # amplitude of the error once per turn [rad]
    windup: float  # [rad/(N m)], or [rad/N]
    rest: float  # root mean square of what the fit leaves [rad]
    table: list[Row]


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
    angles: FloatArray, readings: FloatArray, efforts: FloatArray | None = None, bins: int = 36
) -> EncoderErrors:
    """Return the errors of an encoder whose joint has been at ``angles`` of its POSOR [rad], (n,), in order of time.

    ``readings``: [rad], (n,); ``efforts``: of the drive [N m] or [N], (n,); ``bins``: of each direction.
    """
    known = np.isfinite(angles) & np.isfinite(readings)
    angles, readings = angles[known], readings[known]
    direction = directions(readings)
    difference = readings - angles
    difference -= 2.0 * math.pi * np.round(np.median(difference) / (2.0 * math.pi)) if len(difference) else 0.0
    moving = direction != 0
    angles, direction, difference = angles[moving], direction[moving], difference[moving]
    if not len(angles):
        return EncoderErrors(0, 0.0, *(math.nan,) * 6, [])
    span, table = float(np.ptp(angles)), _table(angles, direction, difference, bins)
    backlash = _backlash(table)
    columns = {"offset": np.ones(len(angles))}
    if span >= LEAST_RANGE:
        columns["slope"] = angles - angles.mean()
    if span >= math.pi:
        columns |= {"c": np.cos(angles), "s": np.sin(angles)}
    if efforts is not None and np.ptp(own := efforts[known][moving]) > 0.0:
        columns["windup"] = own - own.mean()
    design = np.column_stack(list(columns.values()))
    alike = difference - 0.5 * np.nan_to_num(backlash) * direction
    values = np.linalg.lstsq(design, alike, rcond=None)[0]
    fitted = dict(zip(columns, map(float, values), strict=True))
    return EncoderErrors(
        len(angles),
        span,
        fitted["offset"],
        backlash,
        fitted.get("slope", math.nan),
        math.hypot(fitted["c"], fitted["s"]) if "c" in fitted else math.nan,
        fitted.get("windup", math.nan),
        float(np.sqrt(np.mean(np.square(alike - design @ values)))),
        table,
    )


def _table(angles: FloatArray, direction: IntArray, difference: FloatArray, bins: int) -> list[Row]:
    edges = np.linspace(angles.min(), angles.max(), bins + 1)
    which = np.clip(np.searchsorted(edges, angles, side="right") - 1, 0, bins - 1)
    rows = []
    for sign in (FORWARD, BACKWARD):
        for b in range(bins):
            if (own := difference[(direction == sign) & (which == b)]).size:
                middle = 0.5 * float(edges[b] + edges[b + 1])
                rows.append(Row(sign, middle, float(own.mean()), float(own.std()), len(own)))
    return rows


def _backlash(table: list[Row]) -> float:
    """Return the mean difference of both directions over the bins that have both; NaN: there is none."""
    forward, backward = ({row.angle: row for row in table if row.direction == sign} for sign in (FORWARD, BACKWARD))
    both = [(forward[angle], backward[angle]) for angle in forward if angle in backward]
    if not both:
        return math.nan
    weights = [1.0 / (1.0 / one.readings + 1.0 / other.readings) for one, other in both]
    return float(np.average([one.mean - other.mean for one, other in both], weights=weights))
