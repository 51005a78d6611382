"""How the beams accelerate: parabolas through their centres over a window of time that ends with the last scan.

``kept`` holds the window [ns] and which of the scans in ``seen_ns`` (room,) and ``seen`` (room, 3 b) are in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

WINDOW, BEGIN, END = range(3)
KEPT = 3
LEAST_SCANS = 5
"""Fewer scans say more of the readings' noise than of an acceleration."""


@inlined
def has_room(kept: IntArray, seen_ns: IntArray, seen: FloatArray) -> bool:
    """Return whether one more scan can be taken; move the window to the front where that is cheap and makes room."""
    begin, end = kept[BEGIN], kept[END]
    if end < seen_ns.shape[0]:
        return True
    if 2 * begin < end:
        return False
    for n in range(begin, end):
        seen_ns[n - begin] = seen_ns[n]
        for k in range(seen.shape[1]):
            seen[n - begin, k] = seen[n, k]
    kept[BEGIN] = 0
    kept[END] = end - begin
    return True


@inlined
def begin_anew(stamp_ns: int, kept: IntArray, seen_ns: IntArray) -> None:
    """Forget all scans if time has gone back since the last one, or gone on for longer than the window."""
    if kept[END] > kept[BEGIN]:
        on = stamp_ns - seen_ns[kept[END] - 1]
        if on <= 0 or on > kept[WINDOW]:
            kept[BEGIN] = kept[END]


@inlined
def take(stamp_ns: int, centres: FloatArray, kept: IntArray, seen_ns: IntArray, seen: FloatArray) -> None:
    """Take where the beams' centres are [m], (3 b,), axes of the base; there must be room."""
    end = kept[END]
    seen_ns[end] = stamp_ns
    for k in range(centres.shape[0]):
        seen[end, k] = centres[k]
    kept[END] = end + 1
    while stamp_ns - seen_ns[kept[BEGIN]] > kept[WINDOW]:
        kept[BEGIN] += 1


@inlined
def accelerations(kept: IntArray, seen_ns: IntArray, seen: FloatArray, found: FloatArray) -> None:
    """Write each beam's acceleration [m/s^2], (3 b,), axes of the base; zero while scans are too few.

    The parabola is that of least squares. Each centre is weighed with what is left of the square of its time when the
    mean and the slope over all stamps are taken away: the orthogonal polynomial of second degree.
    """
    for k in range(found.shape[0]):
        found[k] = 0.0
    begin, end = kept[BEGIN], kept[END]
    count = end - begin
    if count < LEAST_SCANS:
        return
    last = seen_ns[end - 1]
    mean = 0.0
    for n in range(begin, end):
        mean += (seen_ns[n] - last) * 1e-9
    mean /= count
    second = 0.0
    third = 0.0
    for n in range(begin, end):
        t = (seen_ns[n] - last) * 1e-9 - mean
        second += t * t
        third += t * t * t
    skew = third / second
    offset = second / count
    whole = 0.0
    first = seen[begin]
    for n in range(begin, end):
        t = (seen_ns[n] - last) * 1e-9 - mean
        weight = t * t - skew * t - offset
        whole += weight * weight
        now = seen[n]
        for k in range(found.shape[0]):
            found[k] += weight * (now[k] - first[k])
    for k in range(found.shape[0]):
        found[k] *= 2.0 / whole
