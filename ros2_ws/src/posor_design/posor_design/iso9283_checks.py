# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What makes figures of ISO 9283 wrong although all points are valid: settling, late stamps, rare readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.bags.recording import Track
    from posor.numerics.array_types import FloatArray

    from posor_design.iso9283_cycles import Motion, PoseCycles

SETTLING_SIGMAS = 5.0  # motion within a dwell that is named, in standard errors
LEAST_SCANS = 10  # in a third of such a dwell
NEIGHBOURS = 2  # of a reading, between which its path is not straight


def settling_of(motion: Motion, dwells: Sequence[tuple[int, int]]) -> FloatArray:
    """Return how far the endpoint moves against the reference within each dwell [m]: from the first to the last third.

    0: less than SETTLING_SIGMAS standard errors of the difference, or too few scans to tell.
    """
    found = np.zeros(len(dwells))
    for number, (begin, end) in enumerate(dwells):
        during = motion.between(begin, end)
        deviations = (motion.positions - motion.references)[during]
        third = len(deviations) // 3
        if third < LEAST_SCANS:
            continue
        first, last = deviations[:third], deviations[-third:]
        moved = np.abs(last.mean(axis=0) - first.mean(axis=0))
        quieter = np.minimum(first.std(axis=0, ddof=1), last.std(axis=0, ddof=1))  # it may move at either end
        errors = quieter * np.sqrt(2.0 / third)  # of the difference
        found[number] = np.linalg.norm(np.where(moved > SETTLING_SIGMAS * errors, moved, 0.0))
    return found


def count_elsewhere(poses: Sequence[PoseCycles], same: float) -> int:
    """Return how many dwells have an endpoint that is nearer to another pose than to its own, by more than ``same``."""
    places = np.array([pose.commanded[:3] for pose in poses])
    found = 0
    for number, pose in enumerate(poses):
        away = np.linalg.norm(pose.attained[:, None, :3] - places, axis=2)
        found += int(np.count_nonzero(away.min(axis=1) + same < away[:, number]))
    return found


def interpolation_error(motion: Motion, track: Track, dwells: Sequence[tuple[int, int]]) -> float:
    """Return how far the path may be from the straight line between two readings of it at the stamps of the motion [m].

    The line between the neighbours of a reading is four times as far from a curve as that between two neighbours.
    What the readings scatter about such a line in the dwells is taken off.
    """
    stamps, places = track.stamps_ns, track.values[:, :3]
    if len(stamps) <= NEIGHBOURS:
        return 0.0
    chords, first = places[2:] - places[:-2], places[1:-1] - places[:-2]
    lengths = np.linalg.norm(chords, axis=1)
    along = (first * chords).sum(axis=1) / np.where(lengths > 0.0, lengths, np.inf)
    across = np.sqrt(np.maximum((first**2).sum(axis=1) - along**2, 0.0))
    off = np.pad(across, 1, mode="edge") / 4.0
    right = np.clip(np.searchsorted(stamps, motion.stamps_ns), 1, len(stamps) - 1)
    within = (motion.stamps_ns - stamps[right - 1]) / (stamps[right] - stamps[right - 1])
    errors = np.minimum(off[right - 1], off[right]) * 4.0 * within * (1.0 - within)  # a parabola
    still = np.any([motion.between(begin, end) for begin, end in dwells], axis=0)
    return float(max(0.0, errors[~still].max(initial=0.0) - errors[still].max(initial=0.0)))
