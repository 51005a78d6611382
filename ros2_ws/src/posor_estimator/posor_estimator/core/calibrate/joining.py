"""What scans say while the reference stands still: their means, with the standard uncertainty of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.channels import KINDS
from posor_estimator.core.calibrate.checks import MOST_OUTLIERS
from posor_estimator.core.calibrate.procedure import Options
from posor_estimator.core.calibrate.recording import POSE
from posor_estimator.core.calibrate.sound_readings import sound_parts
from posor_estimator.core.calibrate.track import dwells
from posor_estimator.core.scan import Scans
from posor_estimator.errors import TrackError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibrate.track import Dwell, Track
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

NS = 1_000_000_000
READINGS = ("gap_voltages", "ring_voltages", "diode_currents", "supply_voltages", "temperatures")
"""Fields of ``Scans`` that are averaged."""
ARM = 0.1
"""Length by which turns of a pose are compared with its shifts [m]."""


@dataclass(frozen=True)
class Stops:
    """One mean scan for each dwell, and the reference's value there.

    Attributes:
        scans: The means, one scan for each dwell, stamped with the middle of the scans it was made of.
        counts: How many scans each mean is of, (d,).
        spreads: By field of ``Scans``: standard deviation of one scan about the mean of its dwell, pooled over the
            dwells (JCGM 100, 4.2.4, and H.3.6); the shape of one scan's field. NaN where no dwell holds two scans.
        reference: Mean of the reference, (d, k).
        reference_sigmas: Its standard uncertainty: the instrument's own, and the scatter of the mean (JCGM 100, 4.2.3),
            (d, k).
        warnings: Sentences on what was left out.

    """

    scans: Scans
    counts: IntArray
    spreads: Mapping[str, FloatArray]
    reference: FloatArray
    reference_sigmas: FloatArray
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of dwells."""
        return len(self.counts)

    def chosen(self, which: BoolArray) -> Stops:
        """Return some of the stops."""
        return Stops(
            self.scans.chosen(which),
            self.counts[which],
            self.spreads,
            self.reference[which],
            self.reference_sigmas[which],
            self.warnings,
        )

    def sigmas(self, name: str) -> FloatArray:
        """Return the standard uncertainty of the means of a field, from the scatter of the scans; (d, ...)."""
        spread = self.spreads[name]
        return np.asarray(spread / np.sqrt(self.counts.reshape(-1, *(1,) * spread.ndim)))


def stops(
    scans: Scans, track: Track, still: Sequence[Dwell], *, what: str = "", judged: Sequence[str] = KINDS
) -> Stops:
    """Return the means of the scans within dwells; a dwell without scans is left out, and so are gross errors.

    Args:
        scans: Stamps increasing.
        track: Where the dwells were found.
        still: When the reference stood still.
        what: What to call the scans in complaints.
        judged: Kinds of readings that matter, of which those that do not belong to their dwell are left out.

    Raises:
        TrackError: No dwell holds a scan, or the lit source changes within a dwell.
        FitError: More than a tenth of what a channel read does not belong to the dwells.

    """
    bounds = [
        (int(np.searchsorted(scans.stamps_ns, d.begin_ns)), int(np.searchsorted(scans.stamps_ns, d.end_ns, "right")))
        for d in still
    ]
    used = [(dwell, scans.part(begin, end)) for dwell, (begin, end) in zip(still, bounds, strict=True) if end > begin]
    if not used:
        raise TrackError(
            f"none of its {len(still)} dwells holds a scan", where=track.source, expected="scans of the same time span"
        )
    for dwell, part in used:
        if np.any(part.lit_sources != part.lit_sources[0]):
            raise TrackError(
                f"the lit source changes within the dwell from {dwell.begin_ns} ns to {dwell.end_ns} ns",
                where=what or track.source,
                expected="one lit source for each diode while the reference stands still",
            )
    counts = np.array([len(part) for _, part in used], dtype=np.int64)
    samples = np.array([dwell.samples for dwell, _ in used], dtype=float)
    spreads, values = (np.array([getattr(dwell, name) for dwell, _ in used]) for name in ("spread", "value"))
    parts, odd = sound_parts([part for _, part in used], _motion(spreads, values), judged, what or track.source)
    return Stops(
        scans=_means(parts),
        counts=counts,
        spreads={name: _pooled([getattr(part, name) for part in parts]) for name in READINGS},
        reference=values,
        reference_sigmas=np.hypot(spreads / np.sqrt(samples)[:, None], track.sigmas),
        warnings=(*_uncovered(scans, track), *odd),
    )


def _motion(spreads: FloatArray, values: FloatArray) -> FloatArray:
    """Return how far the reference moved within each dwell over how far it went in all, (d,)."""
    lengths = np.array([1.0] * 3 + [ARM] * 4) if values.shape[1] == POSE else np.ones(values.shape[1])
    travel = float(np.linalg.norm(lengths * np.ptp(values, axis=0)))
    return np.asarray(np.linalg.norm(lengths * spreads, axis=1) / travel if travel else np.zeros(len(spreads)))


def _uncovered(scans: Scans, track: Track) -> tuple[str, ...]:
    """Return the sentence that says that the reference was recorded for part of the time only, none where it was not.

    Stops that the scans alone cover count for nothing.
    """
    first, last = int(track.stamps_ns[0]), int(track.stamps_ns[-1])
    outside = int(np.count_nonzero((scans.stamps_ns < first) | (scans.stamps_ns > last)))
    if outside <= MOST_OUTLIERS * len(scans):
        return ()
    end = (last - int(scans.stamps_ns[0])) / NS
    what = f"{outside} of {len(scans)} scans were taken before its first or after its last value"
    return (f"{track.source}: {what}, which is {end:.3g} s after the first scan: they count for nothing.",)


def _means(parts: Sequence[Scans]) -> Scans:
    """Return one scan for each part: the mean of its readings; what is no number is taken from its first scan."""
    firsts = Scans.of([part[0] for part in parts])
    means = {name: np.array([_mean(getattr(part, name)) for part in parts]) for name in READINGS}
    middles = np.array([int(part.stamps_ns[0] + part.stamps_ns[-1]) // 2 for part in parts], dtype=np.int64)
    return firsts.with_fields(means).with_fields({"stamps_ns": middles})


def _mean(part: FloatArray) -> FloatArray:
    """Return the mean of what is known of readings (n, ...); NaN where nothing is."""
    known = np.isfinite(part)
    count = known.sum(axis=0)
    return np.asarray(np.where(count > 0, np.where(known, part, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan))


def _pooled(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation within parts (n, ...), pooled over them by their degrees of freedom."""
    squares = np.sum([np.nansum(np.square(part - _mean(part)), axis=0) for part in parts], axis=0)
    freedoms = np.sum([np.maximum(np.isfinite(part).sum(axis=0) - 1, 0) for part in parts], axis=0)
    return np.asarray(np.where(freedoms > 0, np.sqrt(squares / np.maximum(freedoms, 1)), np.nan))


def while_known(scans: Scans, track: Track, longest_gap_ns: int) -> tuple[Scans, FloatArray]:
    """Return the scans at whose times the reference is known, and its values there, (n, k).

    Args:
        scans: The scans.
        track: The reference, joined by straight lines between its values.
        longest_gap_ns: Values further apart than this are not joined [ns].

    Raises:
        TrackError: There is no such scan.

    """
    values = track.at(scans.stamps_ns, longest_gap_ns)
    known = np.asarray(np.isfinite(values).all(axis=1))
    if not known.any():
        raise TrackError(
            f"says nothing at the times of the {len(scans)} scans",
            where=track.source,
            expected=f"values at most {longest_gap_ns * 1e-9:g} s apart, of the same time span",
        )
    return scans.chosen(known), values[known]


class StopOptions(Options):
    """Options of a procedure whose reference goes from stop to stop."""

    reference: str = Field(default="", description="topic of the reference; empty: the only one that fits")
    still: float = Field(
        default=1e-6, gt=0.0, description="the reference stands still while it stays this close, in its own unit"
    )
    least: float = Field(
        default=0.2, ge=0.0, description="shortest stop that counts [s]; 0: each scan at a known reference is one"
    )
    settle: float = Field(default=0.05, ge=0.0, description="beginning of each stop that is left out [s]")
    longest_gap: float = Field(
        default=1.0, gt=0.0, description="reference values further apart than this are not joined by a line [s]"
    )


def stops_of(
    recording: Recording, track: Track, options: StopOptions, judged: Sequence[str] = ("gap_voltages",)
) -> Stops:
    """Return the stops of a recording as the options ask for them; ``judged`` as of ``stops``.

    Raises:
        TrackError: There is none.
        FitError: The readings do not belong to the stops.

    """
    if options.least == 0.0:
        scans, values = while_known(recording.scans, track, round(options.longest_gap * NS))
        count = len(scans)
        return Stops(
            scans=scans,
            counts=np.ones(count, dtype=np.int64),
            spreads={name: np.full(getattr(scans, name).shape[1:], np.nan) for name in READINGS},
            reference=values,
            reference_sigmas=np.tile(track.sigmas, (count, 1)),
        )
    found = dwells(track, options.still, round(options.least * NS), settle_ns=round(options.settle * NS))
    if not found:
        raise TrackError(
            f"never stands still within {options.still:g} for {options.least:g} s",
            where=track.source,
            expected="stops at which the readings can be averaged, or options still and least that fit its stops",
        )
    return stops(recording.scans, track, found, what=recording.source, judged=judged)
