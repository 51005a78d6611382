# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Dwells: times during which the reference stands still, and the mean scan of each with its standard uncertainty.

While the target rests, a channel scatters by its noise only. Readings far outside that scatter are left out of the
means and reported; a recording with many of them is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor.bags.recording import POSE
from posor.errors import FitError, TrackError
from posor.model.scan import Scans
from posor.numerics.stamps import NS
from posor.sensors.base import READING_KINDS
from pydantic import Field
from scipy.ndimage import median

from posor_calibration.data_checks import MOST_OUTLIERS, ROUNDING, channel_name
from posor_calibration.procedure import Options

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.bags.recording import Recording, Track
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

AVERAGED_FIELDS = (*READING_KINDS, "supply_voltages", "temperatures")
POSE_LEVER = 0.1  # lever [m] by which the rotations of a pose are compared with its translations
OUTLIER_SIGMAS = 10.0  # a reading this many standard deviations from the median of its dwell is an outlier
MAD_TO_SIGMA = 1.4826  # standard deviation of a normal distribution over the median of its absolute deviations
MIN_SCANS_FOR_OUTLIERS = 4  # scans in a dwell below which an outlier cannot be distinguished from the others
NAMED_SCANS = 3

Still = Annotated[float, Field(gt=0.0, description="the reference stands still within this, in its own unit")]
LeastDwell = Annotated[float, Field(ge=0.0, description="shortest dwell that counts [s]")]
Settle = Annotated[float, Field(ge=0.0, description="time left out at the beginning of each dwell [s]")]


@dataclass(frozen=True)
class Dwell:
    """A time during which the reference stood still."""

    begin_ns: int  # first reference stamp
    end_ns: int  # last reference stamp
    mean: FloatArray  # of the reference, (k,)
    deviation: FloatArray  # standard deviation of the reference about the mean, (k,)
    samples: int  # number of reference values


def find_dwells(track: Track, tolerance: float, least_ns: int, *, settle_ns: int = 0) -> list[Dwell]:
    """Return the times of at least ``least_ns`` [ns] during which the reference stood still.

    Each value lies within ``tolerance`` of the mean of its dwell so far. ``settle_ns`` [ns] is left out at its
    beginning. Raises TrackError: a value lacks a quantity, so that it is unknown whether the reference stood still.
    """
    incomplete = np.flatnonzero(np.isnan(track.values).any(axis=1))
    if incomplete.size:
        raise TrackError(
            f"the value at {int(track.stamps_ns[incomplete[0]])} ns is incomplete",
            where=track.source,
            expected="every quantity of the reference, since dwells are searched",
        )
    slices: list[slice] = []
    begin, total = 0, np.zeros(track.values.shape[1])
    for index, value in enumerate(track.values):
        if index > begin and np.max(np.abs(value - total / (index - begin))) > tolerance:
            slices.append(slice(begin, index))
            begin, total = index, np.zeros_like(total)
        total += value
    slices.append(slice(begin, len(track.values)))
    found = []
    for part in slices:
        stamps = track.stamps_ns[part]
        settled = stamps >= stamps[0] + settle_ns
        values = track.values[part][settled]
        if stamps[-1] - stamps[0] >= least_ns and len(values):
            deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1])
            found.append(Dwell(int(stamps[settled][0]), int(stamps[-1]), values.mean(axis=0), deviation, len(values)))
    return found


class RestOptions(Options):
    """Options of a procedure whose reference, or another quantity, rests at dwells."""

    still: Still = 5e-6
    least_dwell: LeastDwell = 0.2
    settle: Settle = 0.0

    def dwells(self, track: Track) -> list[Dwell]:
        """Return the times during which a track stood still as the options ask for; raises as ``find_dwells``."""
        return find_dwells(track, self.still, round(self.least_dwell * NS), settle_ns=round(self.settle * NS))


@dataclass(frozen=True)
class DwellMeans:
    """One mean scan for each dwell, and the reference there."""

    scans: Scans  # the means, stamped with the middle of the scans of each dwell, (d,)
    counts: IntArray  # scans in each mean, (d,)
    deviations: Mapping[str, FloatArray]
    """By field of ``Scans``: standard deviation of one scan about the mean of its dwell, pooled over the dwells (JCGM
    100, 4.2.4 and H.3.6); shape of one scan's field. NaN where no dwell holds two scans."""
    reference: FloatArray  # mean of the reference, (d, k)
    reference_sigmas: FloatArray  # of the instrument and of the mean's scatter together (JCGM 100, 4.2.3), (d, k)
    warnings: tuple[str, ...] = ()  # what was left out, one sentence each

    def __len__(self) -> int:
        return len(self.counts)

    def select(self, which: BoolArray) -> DwellMeans:
        """Return some of the dwells."""
        return replace(
            self,
            scans=self.scans.select(which),
            counts=self.counts[which],
            reference=self.reference[which],
            reference_sigmas=self.reference_sigmas[which],
        )

    def sigmas(self, name: str) -> FloatArray:
        """Return the standard uncertainty of the means of a field of ``Scans`` by the scatter of scans, (d, ...)."""
        deviation = self.deviations[name]
        return np.asarray(deviation / np.sqrt(self.counts.reshape(-1, *(1,) * deviation.ndim)))


def average_dwells(
    scans: Scans, track: Track, dwells: Sequence[Dwell], *, source: str, kinds: Sequence[str] = READING_KINDS
) -> DwellMeans:
    """Return the mean scan of each dwell that holds scans, without the outliers.

    ``scans`` have increasing stamps; the dwells were found in ``track``; ``source`` names the recording in errors.
    Outliers of ``kinds``, fields of ``Scans``, are left out. Raises TrackError: no dwell holds a scan, or the lit
    source changes within a dwell; FitError: more than a tenth of the readings of a channel are outliers.
    """
    bounds = [
        (int(np.searchsorted(scans.stamps_ns, d.begin_ns)), int(np.searchsorted(scans.stamps_ns, d.end_ns, "right")))
        for d in dwells
    ]
    used = [(dwell, scans.part(begin, end)) for dwell, (begin, end) in zip(dwells, bounds, strict=True) if end > begin]
    if not used:
        raise TrackError(
            f"none of its {len(dwells)} dwells holds a scan", where=track.source, expected="scans of the same time span"
        )
    for dwell, part in used:
        if np.any(part.lit_sources != part.lit_sources[0]):
            raise TrackError(
                f"the lit source changes within the dwell from {dwell.begin_ns} ns to {dwell.end_ns} ns",
                where=source,
                expected="one lit source for each diode while the reference stands still",
            )
    samples = np.array([dwell.samples for dwell, _ in used], dtype=float)
    means, deviations = (np.array([getattr(dwell, name) for dwell, _ in used]) for name in ("mean", "deviation"))
    parts, outliers = mask_outliers([part for _, part in used], _relative_motion(means, deviations), kinds, source)
    return DwellMeans(
        scans=_mean_scans(parts),
        counts=np.array([len(part) for part in parts], dtype=np.int64),
        deviations={name: _pool_deviations([getattr(part, name) for part in parts]) for name in AVERAGED_FIELDS},
        reference=means,
        reference_sigmas=np.hypot(deviations / np.sqrt(samples)[:, None], track.sigmas),
        warnings=(*_describe_coverage(scans, track), *outliers),
    )


def _relative_motion(means: FloatArray, deviations: FloatArray) -> FloatArray:
    """Return how far the reference moved within each dwell, over its whole travel, (d,)."""
    lengths = np.array([1.0] * 3 + [POSE_LEVER] * 4) if means.shape[1] == POSE else np.ones(means.shape[1])
    travel = float(np.linalg.norm(lengths * np.ptp(means, axis=0)))
    return np.asarray(np.linalg.norm(lengths * deviations, axis=1) / travel if travel else np.zeros(len(means)))


def _describe_coverage(scans: Scans, track: Track) -> tuple[str, ...]:
    """Return a warning if many scans lie outside the time span of the reference, else nothing."""
    first, last = int(track.stamps_ns[0]), int(track.stamps_ns[-1])
    outside = int(np.count_nonzero((scans.stamps_ns < first) | (scans.stamps_ns > last)))
    if outside <= MOST_OUTLIERS * len(scans):
        return ()
    end = (last - int(scans.stamps_ns[0])) / NS
    what = f"{outside} of {len(scans)} scans were taken before its first or after its last value"
    return (f"{track.source}: {what}, which is {end:.3g} s after the first scan: they are not used.",)


def _mean_scans(parts: Sequence[Scans]) -> Scans:
    """Return one scan for each part: the means of its readings, other fields of its first scan."""
    firsts = Scans.of([part[0] for part in parts])
    means = {name: np.array([_finite_mean(getattr(part, name)) for part in parts]) for name in AVERAGED_FIELDS}
    middles = np.array([int(part.stamps_ns[0] + part.stamps_ns[-1]) // 2 for part in parts], dtype=np.int64)
    return firsts.with_fields(means).with_fields({"stamps_ns": middles})


def _finite_mean(readings: FloatArray) -> FloatArray:
    """Return the mean of the finite readings (n, ...) along n; NaN without a warning where there are none."""
    return np.asarray(np.ma.filled(np.ma.masked_invalid(readings).mean(axis=0), np.nan))


def _pool_deviations(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation within parts (n, ...), pooled by degrees of freedom; exactly 0: equal readings."""
    squares = np.sum([np.nansum(np.square(_deviations(part)), axis=0) for part in parts], axis=0)
    freedoms = np.sum([np.maximum(np.isfinite(part).sum(axis=0) - 1, 0) for part in parts], axis=0)
    return np.asarray(np.where(freedoms > 0, np.sqrt(squares / np.maximum(freedoms, 1)), np.nan))


def _deviations(readings: FloatArray) -> FloatArray:
    """Return readings (n, ...) less their mean; the mean of equal readings would differ from them by rounding."""
    above_least = readings - np.where(np.isfinite(readings), readings, np.inf).min(axis=0)
    return np.asarray(above_least - _finite_mean(above_least))


def mask_outliers(
    parts: Sequence[Scans], motion: FloatArray, kinds: Sequence[str], source: str
) -> tuple[list[Scans], tuple[str, ...]]:
    """Return the scans of each dwell with outliers replaced by NaN, and sentences that name them.

    ``motion`` (d,) is the motion of the reference within each dwell over its whole travel; channels may follow it.
    Raises FitError: more than a tenth of the readings of a channel are outliers.
    """
    warnings: list[str] = []
    lengths = [len(part) for part in parts]
    dwell_of = np.repeat(np.arange(len(parts)), lengths)
    numbers = np.concatenate([part.numbers for part in parts])
    masked = list(parts)
    for kind in kinds:
        shape = getattr(parts[0], kind).shape[1:]
        values = np.concatenate([getattr(part, kind).reshape(len(part), -1) for part in parts])
        for channel in range(values.shape[1]):
            bad = _find_outliers(values[:, channel], dwell_of, motion)
            if bad.any():
                warnings.append(_describe_outliers(bad, numbers, channel_name(kind, channel), source))
                values[bad, channel] = np.nan
        for n, own in enumerate(np.split(values, np.cumsum(lengths)[:-1])):
            masked[n] = masked[n].with_fields({kind: own.reshape(len(own), *shape)})
    return masked, tuple(warnings)


def _find_outliers(readings: FloatArray, dwell_of: IntArray, motion: FloatArray) -> BoolArray:
    """Return which readings (n,) of a channel are outliers or missing; ``dwell_of`` (n,) is the dwell of each."""
    bad = np.zeros(len(readings), dtype=bool)
    finite = np.isfinite(readings)
    if not finite.any():
        return bad  # an absent channel: the procedure knows whether it needs the channel
    counts = np.bincount(dwell_of[finite], minlength=len(motion))
    dwells = np.arange(len(counts))
    off = readings[finite] - np.repeat(median(readings[finite], dwell_of[finite], dwells), counts)
    enough = counts >= MIN_SCANS_FOR_OUTLIERS
    scatters = MAD_TO_SIGMA * median(np.abs(off), dwell_of[finite], dwells)  # any number for an empty dwell
    scattered = scatters[enough & (scatters > 0.0)]
    noise = float(np.median(scattered)) if scattered.size else 0.0
    levels = np.unique(readings[finite])
    step = float(np.min(np.diff(levels))) if len(levels) > 1 else 0.0
    step = max(step, ROUNDING * float(np.max(np.abs(levels))))
    allowed = np.hypot(np.maximum(scatters, max(noise, step)), float(np.ptp(readings[finite])) * motion)
    bad[finite] = np.abs(off) > OUTLIER_SIGMAS * np.repeat(allowed, counts)
    bad |= ~finite
    return np.asarray(bad & enough[dwell_of])


def _describe_outliers(bad: BoolArray, numbers: FloatArray, channel: str, source: str) -> str:
    """Return the sentence that names the outliers of a channel; raise FitError where there are too many."""
    count = int(bad.sum())
    scans = [int(number) for number in numbers[bad]]
    if count > MOST_OUTLIERS * len(bad):
        raise FitError(
            f"{count} of {len(bad)} readings of {channel} disagree with their dwell, the first in scan {scans[0]}",
            where=source,
            expected=f"at most {100 * MOST_OUTLIERS:g} %, and scans and reference stamped by one clock",
        )
    named = ", ".join(map(str, scans[:NAMED_SCANS])) + (", ..." if count > NAMED_SCANS else "")
    return (
        f"{source}: left out {count} of {len(bad)} readings of {channel} that disagree with their dwell (scan {named})."
    )


class DwellOptions(RestOptions):
    """Options of a procedure whose reference moves from dwell to dwell."""

    reference: str = Field(default="", description="topic of the reference; empty: the only one that fits")
    still: Still = 1e-6
    least_dwell: float = Field(
        default=0.2, ge=0.0, description="shortest dwell that counts [s]; 0: each scan at a known reference is one"
    )
    settle: Settle = 0.05
    longest_gap: float = Field(
        default=1.0, gt=0.0, description="no interpolation between reference values further apart than this [s]"
    )


def use_values_once(track: Track, stamps_ns: IntArray, known: BoolArray) -> BoolArray:
    """Return which of the ``known`` scans (n,) are the nearest to a value of the reference, each value counting once.

    Interpolated values share the errors of the values beside them: more scans than values would count these errors as
    independent. ``stamps_ns`` [ns] of the scans, (n,).
    """
    which = np.flatnonzero(known)
    stamps, times = stamps_ns[which], track.stamps_ns
    after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times[before] - stamps) < np.abs(times[after] - stamps), before, after)
    order = np.lexsort((np.abs(times[nearest] - stamps), nearest))
    used = np.zeros(len(known), dtype=bool)
    used[which[order[np.unique(nearest[order], return_index=True)[1]]]] = True
    return used


def scans_with_reference(scans: Scans, track: Track, longest_gap_ns: int) -> tuple[Scans, FloatArray]:
    """Return the scans at whose times the reference is known, and its interpolated values there, (n, k).

    Of scans between two values of the reference those next to them, see ``use_values_once``. Raises TrackError: there
    is no such scan.
    """
    values = track.interpolate(scans.stamps_ns, longest_gap_ns)
    known = use_values_once(track, scans.stamps_ns, np.asarray(np.isfinite(values).all(axis=1)))
    if not known.any():
        raise TrackError(
            f"has no value at the times of the {len(scans)} scans",
            where=track.source,
            expected=f"values at most {longest_gap_ns * 1e-9:g} s apart, of the same time span",
        )
    return scans.select(known), values[known]


def average_recording(
    recording: Recording, track: Track, options: DwellOptions, kinds: Sequence[str] = ("gap_voltages",)
) -> DwellMeans:
    """Return the dwell means of a recording as the options ask for them; ``kinds`` as in ``average_dwells``.

    Raises TrackError: there is no dwell; FitError: too many readings disagree with their dwell.
    """
    if options.least_dwell == 0.0:
        scans, values = scans_with_reference(recording.scans, track, round(options.longest_gap * NS))
        unused = len(recording.scans) - len(scans)
        what = f"{unused} of {len(recording.scans)} scans are not used: no reference, or one that a nearer scan uses."
        return DwellMeans(
            scans=scans,
            counts=np.ones(len(scans), dtype=np.int64),
            deviations={name: np.full(getattr(scans, name).shape[1:], np.nan) for name in AVERAGED_FIELDS},
            reference=values,
            reference_sigmas=np.tile(track.sigmas, (len(scans), 1)),
            warnings=(f"{track.source}: {what}",) if unused else (),
        )
    dwells = options.dwells(track)
    if not dwells:
        raise TrackError(
            f"never stands still within {options.still:g} for {options.least_dwell:g} s",
            where=track.source,
            expected="dwells in which readings can be averaged, or options still and least_dwell that fit them",
        )
    return average_dwells(recording.scans, track, dwells, source=recording.source, kinds=kinds)
