# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Acceleration of the beams: parabolas through their centres over a time window that ends with the last scan.

The result belongs to the middle of the window. It is valid for motions that are slow compared with the window.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from posor.chain.joint_measurements import RecordArray
    from posor.numerics.array_types import FloatArray, IntArray

WINDOW = np.dtype([("length_ns", np.int64), ("begin", np.int64), ("end", np.int64)])
"""Length of the window [ns], and its scans: rows ``begin`` to ``end`` (exclusive) of a ``BeamHistory``."""
MINIMUM_SCANS = 5  # with fewer scans the noise of the readings dominates the acceleration
INITIAL_CAPACITY = 256  # scans that a new history can hold


class BeamHistory(NamedTuple):
    """Where b beams have been in the last scans, and their accelerations.

    A stamp that goes back, or that is later than the last one by more than the window, empties the history.
    """

    window: RecordArray  # (1,) of ``WINDOW``
    stamps_ns: IntArray  # times of past scans, (capacity,)
    past_centres: FloatArray  # centres of the beams then [m], (capacity, 3 b), axes of the base
    centres: FloatArray  # centres in the present scan [m], (3 b,)
    accelerations: FloatArray  # [m/s^2], (3 b,), axes of the base
    # Plates at the beams' ends in the plates at their starts in the present scan, (b, 7), as poses
    transforms: FloatArray
    static_forces: FloatArray  # gravity less acceleration in the axes of the beams' starts [m/s^2], (b, 3), where used

    @classmethod
    def allocate(cls, window_s: float, beams: int) -> BeamHistory:
        """Return an empty history; ``window_s`` zero: accelerations are not estimated."""
        capacity = INITIAL_CAPACITY if window_s else 0
        return cls(
            np.array([(round(window_s * 1e9), 0, 0)], dtype=WINDOW),
            np.zeros(capacity, dtype=np.int64),
            np.zeros((capacity, 3 * beams)),
            np.empty(3 * beams),
            np.zeros(3 * beams),
            np.full((beams, 7), np.nan),
            np.full((beams, 3), np.nan),
        )

    def enlarged(self) -> BeamHistory:
        """Return the same history with twice the capacity; all other arrays are shared."""
        return self._replace(
            stamps_ns=np.concatenate([self.stamps_ns, np.zeros_like(self.stamps_ns)]),
            past_centres=np.concatenate([self.past_centres, np.zeros_like(self.past_centres)]),
        )


@in_place
def has_free_row(history: BeamHistory) -> bool:
    """Return whether one more scan fits; move the window to the front if that halves the occupied rows at least."""
    window, stamps_ns, past = history.window[0], history.stamps_ns, history.past_centres
    begin, end = window["begin"], window["end"]
    if end < stamps_ns.shape[0]:
        return True
    if 2 * begin < end:
        return False
    for n in range(begin, end):
        stamps_ns[n - begin] = stamps_ns[n]
        for k in range(past.shape[1]):
            past[n - begin, k] = past[n, k]
    window["begin"] = 0
    window["end"] = end - begin
    return True


@in_place
def forget_after_gap(stamp_ns: int, history: BeamHistory) -> None:
    """Forget all scans if time went back since the last one, or advanced by more than the window."""
    window = history.window[0]
    if window["end"] > window["begin"]:
        step = stamp_ns - history.stamps_ns[window["end"] - 1]
        if step <= 0 or step > window["length_ns"]:
            window["begin"] = window["end"]


@in_place
def append_centres(stamp_ns: int, history: BeamHistory) -> None:
    """Store the present centres; ``has_free_row`` must have returned true."""
    window, end = history.window[0], history.window[0]["end"]
    history.stamps_ns[end] = stamp_ns
    for k in range(history.centres.shape[0]):
        history.past_centres[end, k] = history.centres[k]
    window["end"] = end + 1
    while stamp_ns - history.stamps_ns[window["begin"]] > window["length_ns"]:
        window["begin"] += 1


@in_place
def estimate_accelerations(history: BeamHistory) -> None:
    """Write ``accelerations``: curvature of the least-squares parabola; zero where the scans do not determine it.

    That takes ``MINIMUM_SCANS`` scans over half of the window: over less, noise would pass for acceleration.

    Each centre has as its weight the orthogonal polynomial of second degree: the square of its time without the mean
    and the slope over all stamps.
    """
    stamps_ns, past, accelerations = history.stamps_ns, history.past_centres, history.accelerations
    for k in range(accelerations.shape[0]):
        accelerations[k] = 0.0
    begin, end = history.window[0]["begin"], history.window[0]["end"]
    count = end - begin
    if count < MINIMUM_SCANS:
        return
    last = stamps_ns[end - 1]
    if 2 * (last - stamps_ns[begin]) < history.window[0]["length_ns"]:
        return
    mean = 0.0
    for n in range(begin, end):
        mean += (stamps_ns[n] - last) * 1e-9
    mean /= count
    second = 0.0
    third = 0.0
    for n in range(begin, end):
        t = (stamps_ns[n] - last) * 1e-9 - mean
        second += t * t
        third += t * t * t
    skew = third / second
    offset = second / count
    norm = 0.0
    first = past[begin]
    for n in range(begin, end):
        t = (stamps_ns[n] - last) * 1e-9 - mean
        weight = t * t - skew * t - offset
        norm += weight * weight
        centres = past[n]
        for k in range(accelerations.shape[0]):
            accelerations[k] += weight * (centres[k] - first[k])
    for k in range(accelerations.shape[0]):
        accelerations[k] *= 2.0 / norm
