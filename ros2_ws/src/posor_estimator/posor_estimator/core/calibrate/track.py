"""A reference measurement along time: what an interferometer, a CMM or gauge blocks said, and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.errors import TrackError

if TYPE_CHECKING:
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Track:
    """Values along time.

    Attributes:
        stamps_ns: Strictly increasing [ns], (n,).
        values: (n, k); which quantities, and their units, is the procedure's to know. NaN where the reference has one
            quantity but lacks another.
        sigmas: Standard uncertainty of each of the k quantities.
        source: What to call it in complaints: bag and topic.

    """

    stamps_ns: IntArray
    values: FloatArray
    sigmas: FloatArray
    source: str

    def __post_init__(self) -> None:
        """Refuse a track that cannot be interpolated."""
        if not len(self.stamps_ns):
            raise TrackError("holds no values", where=self.source)
        back = np.flatnonzero(np.diff(self.stamps_ns) <= 0)
        if back.size:
            raise TrackError(
                f"stamp {int(self.stamps_ns[back[0] + 1])} ns follows {int(self.stamps_ns[back[0]])} ns",
                where=self.source,
                expected="stamps that increase",
            )
        bad = np.flatnonzero(np.isinf(self.values).any(axis=1) | np.isnan(self.values).all(axis=1))
        if bad.size:
            raise TrackError(
                f"the value at {int(self.stamps_ns[bad[0]])} ns is not finite", where=self.source, expected="numbers"
            )

    def at(self, stamps_ns: IntArray, longest_gap_ns: int) -> FloatArray:
        """Return the values at given times, linearly between neighbours, (m, k).

        Args:
            stamps_ns: Times [ns], (m,).
            longest_gap_ns: Neighbours further apart than this are not joined by a line.

        Returns:
            The values; NaN where a time lies outside the track, in a gap, or beside a value that is not there: nothing
            is extrapolated.

        """
        after = np.searchsorted(self.stamps_ns, stamps_ns)
        exact = np.isin(stamps_ns, self.stamps_ns)
        right = np.clip(after, 0, len(self.stamps_ns) - 1)
        left = np.clip(after - 1, 0, len(self.stamps_ns) - 1)
        left = np.where(exact, right, left)
        span = self.stamps_ns[right] - self.stamps_ns[left]
        share = np.where(span > 0, (stamps_ns - self.stamps_ns[left]) / np.maximum(span, 1), 0.0)
        values = self.values[left] + share[:, None] * (self.values[right] - self.values[left])
        outside = (after == 0) | (after == len(self.stamps_ns))
        values[~exact & (outside | (span > longest_gap_ns))] = np.nan
        return values


@dataclass(frozen=True)
class Dwell:
    """A time during which the reference stood still.

    Attributes:
        begin_ns: First stamp of it.
        end_ns: Last stamp of it.
        value: Mean of the reference, (k,).
        spread: Standard deviation of the reference about that mean, (k,).
        samples: Number of reference values in it.

    """

    begin_ns: int
    end_ns: int
    value: FloatArray
    spread: FloatArray
    samples: int

    def holds(self, stamps_ns: IntArray) -> BoolArray:
        """Return which times lie within the dwell, (m,) of truth values."""
        return np.asarray((stamps_ns >= self.begin_ns) & (stamps_ns <= self.end_ns))


def dwells(track: Track, still: float, least_ns: int, *, settle_ns: int = 0) -> list[Dwell]:
    """Return the times during which the reference stood still.

    Args:
        track: The reference.
        still: Largest distance of a value from the mean of its dwell so far; in the unit of the values.
        least_ns: Shorter stops are none [ns].
        settle_ns: How much of each dwell's beginning is left out, for what has to come to rest [ns].

    Raises:
        TrackError: Some value lacks a quantity: whether it stood still is not known.

    """
    lacking = np.flatnonzero(np.isnan(track.values).any(axis=1))
    if lacking.size:
        raise TrackError(
            f"the value at {int(track.stamps_ns[lacking[0]])} ns is not whole",
            where=track.source,
            expected="every quantity, where dwells are looked for",
        )
    found: list[Dwell] = []
    begin, total = 0, np.zeros(track.values.shape[1])
    for index, value in enumerate(track.values):
        if index > begin and np.max(np.abs(value - total / (index - begin))) > still:
            _keep(found, track, slice(begin, index), least_ns, settle_ns)
            begin, total = index, np.zeros_like(total)
        total += value
    _keep(found, track, slice(begin, len(track.values)), least_ns, settle_ns)
    return found


def _keep(found: list[Dwell], track: Track, part: slice, least_ns: int, settle_ns: int) -> None:
    stamps = track.stamps_ns[part]
    if stamps[-1] - stamps[0] < least_ns:
        return
    settled = stamps >= stamps[0] + settle_ns
    values = track.values[part][settled]
    if len(values):
        found.append(
            Dwell(
                int(stamps[settled][0]),
                int(stamps[-1]),
                values.mean(axis=0),
                values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1]),
                len(values),
            )
        )
