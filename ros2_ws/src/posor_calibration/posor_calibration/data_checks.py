# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of readings and reference before a fit; each refuses unusable data with one sentence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError, TrackError
from posor.sensors.diodes import CONTACT_LETTERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

POSE_AXES = ("x", "y", "z", "about x", "about y", "about z")
MOST_OUTLIERS = 0.1  # share of outliers beyond which data are refused
ROUNDING = 1e-12  # relative rounding error of a mean of equal numbers

STUCK_SCANS = 20  # equal readings in a row that noise does not produce
NOISY_SHARE = 0.2  # share of scans in which a neighbour's reading changes if the converter resolves its noise
STUCK_SIGMAS = 6.0  # travel of a channel below which it shows only noise, in standard uncertainties
STUCK_RUN = 3  # equal readings in a row, at different places, that may show a stuck channel
STUCK_STEPS, STUCK_SHARE = 3.0, 0.1
"""Change that a stuck channel has missed: in steps of the converter, and as a share of the channel's travel."""
SINGULAR = 1e-10  # singular values below this share of the largest one count as zero
SAME_STEP, SMALLEST_STEP = 1e-9, 1e-6
"""Relative to the readings: tolerance of multiples of a converter's step, and the smallest step."""

WRONG_UNITS = {
    1000.0: "it is in millimetres",
    1e6: "it is in micrometres",
    1.0 / 0.0254: "it is in inches",
    1e-3 / 0.0254: "it is in inches taken for millimetres",
    25.4: "it was converted from inches but was in millimetres",
    0.0254: "it was converted from inches but was in metres",
    1e-3: "it was converted from millimetres but was in metres",
    180.0 / math.pi: "it is in degrees",
    math.pi / 180.0: "it was converted from degrees but was in radians",
    2.0: "an interferometer with twice the passes was read as one with a single pass",
    0.5: "an interferometer with a single pass was read as one with twice the passes",
}
"""Mistake that makes a reference travel by this factor too far."""
UNIT_TOLERANCE = 0.1  # relative distance from such a factor
PLAUSIBLE_RATIO = (0.6, 1.7)  # travel of the reference over that computed with the present calibration
SAME_MOTION, OTHER_MOTION = 0.9, 0.5
"""Rank correlation above which two motions are the same, and below which they are different."""

LAG_SHARE, LARGEST_LAG_S, LAGS = 0.2, 5.0, 201
"""Lags that are tried: up to this share of the recording and this time [s], and how many."""
SMALLEST_MISFIT = 1e-6  # misfit over the travel of the reference that may come from rounding
LAG_IMPROVEMENT = 3.0  # factor by which a lag must reduce the misfit to be reported


def check_count(count: int, least: int, what: str, where: str) -> None:
    """Raise FitError if a recording holds fewer than ``least`` of ``what``, for example dwells."""
    if count < least:
        raise FitError(f"{count} {what}", where=where, expected=f"at least {least}")


def channel_name(kind: str, channel: int) -> str:
    """Return the name of a channel of a scan: ``gap voltage 2``, ``current C of diode 1``."""
    if kind == "diode_currents":
        diode, contact = divmod(channel, len(CONTACT_LETTERS))
        return f"current {CONTACT_LETTERS[contact]} of diode {diode + 1}"
    return f"{kind.removesuffix('s').replace('_', ' ')} {channel + 1}"


def check_channels_vary(scans: Scans, kinds: Sequence[str], where: str) -> None:
    """Raise FitError if a channel repeats one reading while its neighbours show noise; ``scans`` not averaged.

    Neighbours are the other channels of the same kind (one of ``READING_KINDS``), or the other contacts of the diode.
    If they stand still too, the converter does not resolve the noise, or the diode is dark.
    """
    for kind in kinds:
        readings = getattr(scans, kind).reshape(len(scans), -1)
        count = readings.shape[1]
        size = len(CONTACT_LETTERS) if kind == "diode_currents" else count
        for channel in range(count):
            first, last = _longest_constant_run(readings[:, channel])
            if last + 1 - first < STUCK_SCANS:
                continue
            begin = channel // size * size
            neighbours = [k for k in range(begin, begin + size) if k != channel]
            changes = np.mean(np.diff(readings[first : last + 1, neighbours], axis=0) != 0.0, axis=0)
            if neighbours and np.median(changes) > NOISY_SHARE:
                raise FitError(
                    f"{channel_name(kind, channel)} is stuck at {readings[first, channel]:.6g} from scan "
                    f"{scans.numbers[first]} to scan {scans.numbers[last]}, while its neighbours vary",
                    where=where,
                    expected="a reading with noise",
                )


def _longest_constant_run(readings: FloatArray) -> tuple[int, int]:
    """Return first and last index of the longest run of equal readings (n,)."""
    ends = np.flatnonzero(np.concatenate([[True], np.diff(readings) != 0.0, [True]]))
    longest = int(np.argmax(np.diff(ends)))
    return int(ends[longest]), int(ends[longest + 1]) - 1


def check_channels_move(
    names: Sequence[str], means: FloatArray, sigmas: FloatArray, moved: FloatArray, where: str, sample: str = "dwell"
) -> None:
    """Raise FitError if a channel is not finite, or stands still while the reference moves.

    The readings of a converter also repeat where the motion reverses or hardly affects a channel. A channel is stuck
    only if, by its readings elsewhere, the motion should have changed it. ``means`` (d, c) are the readings of the
    channels ``names`` (c,), with standard uncertainties ``sigmas`` (d, c), NaN where unknown. The readings follow
    ``moved`` (d, k) roughly in proportion: the reference, or other channels. The error names ``where`` and the number
    of the ``sample``.
    """
    places_change = np.any(np.diff(moved, axis=0) != 0.0, axis=1)
    for index, name in enumerate(names):
        readings = means[:, index]
        if not np.isfinite(readings).all():
            number = int(np.argmin(np.isfinite(readings))) + 1
            raise FitError(f"{name} is not finite at {sample} {number}", where=where)
        noise = np.nan_to_num(np.max(sigmas[:, index]), nan=0.0)
        rounding = ROUNDING * float(np.max(np.abs(readings)))
        if np.ptp(readings) <= max(STUCK_SIGMAS * noise, rounding):
            raise FitError(
                f"{name} stays at {readings[0]:.6g} while the reference moves, it is stuck or does not see the motion",
                where=where,
                expected="a reading that changes by more than its noise",
            )
        equal = (np.abs(np.diff(readings)) <= rounding) & places_change
        ends = np.flatnonzero(np.diff(np.concatenate([[False], equal, [False]])))
        runs = [(int(a), int(b)) for a, b in ends.reshape(-1, 2) if b - a >= STUCK_RUN - 1]
        step = _converter_step(readings, rounding) if runs else 0.0
        allowed = max(STUCK_STEPS * step, STUCK_SHARE * float(np.ptp(readings))) if step else 0.0
        for (first, _), change in zip(runs, _expected_changes(readings, moved, runs), strict=True):
            if change > allowed:
                raise FitError(
                    f"{name} is stuck at {readings[first]:.6g} from {sample} {first + 1} on while the reference moves",
                    where=where,
                    expected="a reading that changes",
                )


def _expected_changes(readings: FloatArray, moved: FloatArray, runs: Sequence[tuple[int, int]]) -> list[float]:
    """Return by how much a channel should have changed within each run, by a linear fit to all samples outside."""
    spread = np.ptp(moved, axis=0)
    scaled = (moved - moved.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    design = np.column_stack([np.ones(len(readings)), scaled])
    normal, right = design.T @ design, design.T @ readings
    changes = []
    for first, last in runs:
        inside = slice(first, last + 1)
        if len(readings) - (last + 1 - first) <= design.shape[1]:
            changes.append(math.inf)
            continue
        outside = normal - design[inside].T @ design[inside], right - design[inside].T @ readings[inside]
        slopes = np.linalg.lstsq(*outside, rcond=SINGULAR)[0]
        changes.append(float(np.ptp(design[inside] @ slopes)))
    return changes


def _converter_step(readings: FloatArray, rounding: float) -> float:
    """Return the greatest common divisor of the differences of readings; zero if there is none of a sensible size."""
    steps = np.diff(np.unique(readings))
    largest, step = float(np.max(np.abs(readings))), 0.0
    for other in steps[steps > rounding]:
        remainder = float(other)
        while remainder > SAME_STEP * largest:
            rest = math.fmod(step, remainder)
            step, remainder = remainder, min(rest, remainder - rest)
    return step if step > SMALLEST_STEP * largest else 0.0


def check_unit(measured: FloatArray, reference: FloatArray, source: str, unit: str) -> None:
    """Raise TrackError if the reference (d,) travels implausibly far; a known wrong unit is named.

    ``measured`` (d,) are the readings converted with the present calibration, in ``unit``.
    """
    from scipy.stats import theilslopes  # noqa: PLC0415  takes half a second to load

    ratio = float(theilslopes(reference, measured)[0])
    if ratio < 0.0:
        raise TrackError(
            f"falls where the readings rise, by {abs(ratio):.3g} of their motion",
            where=source,
            expected="the other sign, see the option direction",
        )
    if PLAUSIBLE_RATIO[0] <= ratio <= PLAUSIBLE_RATIO[1]:
        return
    causes = [cause for factor, cause in WRONG_UNITS.items() if abs(ratio / factor - 1.0) < UNIT_TOLERANCE]
    cause = f", as if {causes[0]}" if causes else ""
    what = f"moves {ratio:.4g} times as far as the present calibration says{cause}"
    raise TrackError(what, where=source, expected=f"values in {unit}")


def check_axis(measured: FloatArray, reference: FloatArray, column: int, names: Sequence[str], source: str) -> None:
    """Raise TrackError if another axis of the reference (d, k) than ``column`` moves with ``measured`` (d,)."""
    correlations = [_rank_correlation(measured, reference[:, k]) for k in range(reference.shape[1])]
    best = int(np.argmax(correlations))
    if best != column and correlations[best] >= SAME_MOTION and correlations[column] < OTHER_MOTION:
        raise TrackError(
            f"axis {names[best]} moves with the readings, axis {names[column]} does not; the axes look swapped",
            where=source,
            expected=f"the motion along {names[column]}",
        )


def _rank_correlation(first: FloatArray, second: FloatArray) -> float:
    """Return the size of the rank correlation of two series, zero if one of them is constant."""
    from scipy.stats import spearmanr  # noqa: PLC0415  takes half a second to load

    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return 0.0
    return abs(float(spearmanr(first, second).statistic))


def check_clock(stamps_ns: IntArray, measured: FloatArray, reference: FloatArray, source: str) -> None:
    """Raise TrackError, with the lag, if the reference (n,) follows the readings with a lag: another clock stamped it.

    ``measured`` (n,) are the readings converted with the present calibration, ``stamps_ns`` [ns] the times of both.
    """
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    largest = min(LAG_SHARE * float(seconds[-1]), LARGEST_LAG_S)
    lags = np.linspace(-largest, largest, LAGS)
    inside: BoolArray = (seconds >= largest) & (seconds <= seconds[-1] - largest)
    if np.count_nonzero(inside) < LAGS // 4:
        return
    design = np.column_stack([np.ones(int(inside.sum())), measured[inside]])
    misfits = []
    for lag in [0.0, *lags]:
        shifted = np.interp(seconds[inside] + lag, seconds, reference)
        misfits.append(float(np.sqrt(np.linalg.lstsq(design, shifted, rcond=None)[1].sum())))
    best = int(np.argmin(misfits[1:]))
    rounding = SMALLEST_MISFIT * float(np.ptp(reference)) * float(np.sqrt(inside.sum()))
    if misfits[0] > rounding and misfits[1 + best] * LAG_IMPROVEMENT < misfits[0]:
        raise TrackError(
            f"moves as the readings do about {abs(lags[best]):.2g} s {'later' if lags[best] > 0.0 else 'earlier'}",
            where=source,
            expected="stamps of the clock that stamps the scans",
        )
