"""What scans say while the reference stands still: their means, with the standard uncertainty of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.procedure import Options
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
LEAST_SCANS = 2
"""Scans within a dwell from which its spread can be told."""


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

    """

    scans: Scans
    counts: IntArray
    spreads: Mapping[str, FloatArray]
    reference: FloatArray
    reference_sigmas: FloatArray

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
        )

    def sigmas(self, name: str) -> FloatArray:
        """Return the standard uncertainty of the means of a field, from the scatter of the scans; (d, ...)."""
        spread = self.spreads[name]
        return np.asarray(spread / np.sqrt(self.counts.reshape(-1, *(1,) * spread.ndim)))


def stops(scans: Scans, track: Track, still: Sequence[Dwell], *, what: str = "") -> Stops:
    """Return the means of the scans within dwells; a dwell without scans is left out.

    Args:
        scans: Stamps increasing.
        track: Where the dwells were found.
        still: When the reference stood still.
        what: What to call the scans in complaints.

    Raises:
        TrackError: No dwell holds a scan, or the lit source changes within a dwell.

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
    scatter = np.array([dwell.spread for dwell, _ in used]) / np.sqrt(samples)[:, None]
    return Stops(
        scans=_means([part for _, part in used]),
        counts=counts,
        spreads={name: _pooled([getattr(part, name) for _, part in used]) for name in READINGS},
        reference=np.array([dwell.value for dwell, _ in used]),
        reference_sigmas=np.hypot(scatter, track.sigmas),
    )


def _means(parts: Sequence[Scans]) -> Scans:
    """Return one scan for each part: the mean of its readings; what is no number is taken from its first scan."""
    firsts = Scans.of([part[0] for part in parts])
    means = {name: np.array([getattr(part, name).mean(axis=0) for part in parts]) for name in READINGS}
    middles = np.array([int(part.stamps_ns[0] + part.stamps_ns[-1]) // 2 for part in parts], dtype=np.int64)
    return firsts.with_fields(means).with_fields({"stamps_ns": middles})


def _pooled(parts: Sequence[FloatArray]) -> FloatArray:
    """Return the standard deviation within parts (n, ...), pooled over them by their degrees of freedom."""
    fit = [part for part in parts if len(part) >= LEAST_SCANS]
    if not fit:
        return np.full(parts[0].shape[1:], np.nan)
    squares = np.sum([np.sum(np.square(part - part.mean(axis=0)), axis=0) for part in fit], axis=0)
    return np.asarray(np.sqrt(squares / sum(len(part) - 1 for part in fit)))


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


def stops_of(recording: Recording, track: Track, options: StopOptions) -> Stops:
    """Return the stops of a recording as the options ask for them.

    Raises:
        TrackError: There is none.

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
    return stops(recording.scans, track, found, what=recording.source)
