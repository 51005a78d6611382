# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses and paths of the cycles of a recorded motion: the points from which the figures of ISO 9283 are computed.

A pose is where the reference stands still; dwells at the same reference are its cycles. A path leads from one dwell to
the next; a later motion between the same two poses is its next cycle. A deviation is that of the endpoint from the
reference at the same time (pose), or in the same plane across the path (8.2), so the reference may be a command or an
instrument that follows each cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.bags.recording import POSE
from scipy.spatial.transform import Rotation

from posor_design.iso9283 import LEAST_CYCLES, Figures, distance_figures, path_figures, pose_figures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

PATH_POINTS = 50  # of a path
SETTLING_SIGMAS = 5.0  # motion within a dwell that is named, in standard errors
LEAST_SCANS = 10  # in a third of such a dwell
PATH_ENDS = 0.05  # part of the length of a path that is left out at either end, where the arm starts and stops


class Motion(NamedTuple):
    """Endpoint and reference at n stamps, in the base."""

    stamps_ns: IntArray  # (n,)
    positions: FloatArray  # of the endpoint [m], (n, 3)
    references: FloatArray  # (n, 3)
    rotations: tuple[Rotation, Rotation] | None  # of the endpoint and of the reference, n each; None: unknown

    def turn(self, where: BoolArray) -> FloatArray:
        """Return the mean turn from the orientation of the reference to that of the endpoint [rad], (3,); or NaN."""
        if self.rotations is None:
            return np.full(3, np.nan)
        attained, wanted = self.rotations
        return np.asarray((attained[where] * wanted[where].inv()).as_rotvec().mean(axis=0))


class _Crossing(NamedTuple):
    """Where a track crosses a plane: number of the segment, place within it from 0 to 1, and position."""

    segment: int
    share: float
    place: FloatArray


@dataclass(frozen=True)
class PoseCycles:
    """The cycles of one pose."""

    name: str
    commanded: FloatArray  # (6,)
    attained: FloatArray  # (cycles, 6)

    def figures(self) -> Figures:
        """Return accuracy and repeatability."""
        return pose_figures(self.attained, self.commanded)


@dataclass(frozen=True)
class PathCycles:
    """The cycles of one path."""

    name: str
    commanded: FloatArray  # (points, 6)
    attained: FloatArray  # (points, cycles, 6)

    def figures(self) -> Figures:
        """Return accuracy and repeatability."""
        return path_figures(self.attained, self.commanded)


def motion_of(stamps_ns: IntArray, poses: FloatArray, references: FloatArray) -> Motion:
    """Return endpoint and reference at stamps at which both are known.

    ``poses``: of the endpoint, (n, 7). ``references``: at the same stamps, positions (n, 3) or poses (n, 7), NaN where
    unknown.
    """
    known = np.isfinite(references).all(axis=1)
    rotations = None
    if references.shape[1] == POSE and known.any():
        rotations = Rotation.from_quat(poses[known, 3:]), Rotation.from_quat(references[known, 3:])
    return Motion(stamps_ns[known], poses[known, :3], references[known, :3], rotations)


def pose_cycles(motion: Motion, dwells: Sequence[tuple[int, int]], same: float) -> tuple[list[PoseCycles], list[int]]:
    """Return the poses in the order of their first dwell, and for each dwell the number of its pose, -1: no scan.

    ``dwells``: begin and end [ns] of each. ``same``: dwells whose references differ by at most this are one pose [m].
    """
    centres: list[FloatArray] = []
    points: list[list[tuple[FloatArray, FloatArray]]] = []
    numbers = []
    for begin, end in dwells:
        during = _between(motion, begin, end)
        if not during.any():
            numbers.append(-1)
            continue
        reference = motion.references[during].mean(axis=0)
        away = [float(np.linalg.norm(reference - centre)) for centre in centres]
        number = int(np.argmin(away)) if away and min(away) <= same else len(centres)
        if number == len(centres):
            centres.append(reference)
            points.append([])
        numbers.append(number)
        deviation = (motion.positions[during] - motion.references[during]).mean(axis=0)
        points[number].append((reference, np.concatenate([deviation, motion.turn(during)])))
    found = []
    for number, own in enumerate(points):
        commanded = np.concatenate([np.mean([reference for reference, _ in own], axis=0), np.zeros(3)])
        found.append(PoseCycles(f"P{number + 1}", commanded, commanded + np.array([deviation for _, deviation in own])))
    return found, numbers


def settling_of(motion: Motion, dwells: Sequence[tuple[int, int]]) -> FloatArray:
    """Return how far the endpoint moves against the reference within each dwell [m]: from the first to the last third.

    0: less than SETTLING_SIGMAS standard errors of the difference, or too few scans to tell.
    """
    found = np.zeros(len(dwells))
    for number, (begin, end) in enumerate(dwells):
        during = _between(motion, begin, end)
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


def distance_pairs(poses: Sequence[PoseCycles]) -> dict[tuple[str, str], Figures]:
    """Return the figures of the distance of each two neighbouring poses with the same number of cycles."""
    return {
        (first.name, second.name): distance_figures(
            first.attained[:, :3], second.attained[:, :3], np.array([first.commanded[:3], second.commanded[:3]])
        )
        for first, second in pairwise(poses)
        if len(first.attained) == len(second.attained) >= LEAST_CYCLES
    }


def path_cycles(motion: Motion, dwells: Sequence[tuple[int, int]], numbers: Sequence[int]) -> list[PathCycles]:
    """Return the paths between two poses that have at least two cycles.

    Points whose plane a cycle does not cross are left out.
    ``dwells``, ``numbers``: see ``pose_cycles``.
    """
    spans: dict[tuple[int, int], list[BoolArray]] = {}
    for ((before, end), first), ((begin, after), second) in pairwise(zip(dwells, numbers, strict=True)):
        if -1 not in (first, second) and first != second:
            spans.setdefault((first, second), []).append(_between(motion, (before + end) // 2, (begin + after) // 2))
    found = []
    for (first, second), cycles in spans.items():
        if len(cycles) < LEAST_CYCLES:
            continue
        points, normals = _planes(motion.references[cycles[0]])
        crossings = [
            [_crossing(motion, cycle, *plane) for cycle in cycles] for plane in zip(points, normals, strict=True)
        ]
        whole = [n for n, own in enumerate(crossings) if all(each is not None for each in own)]
        if whole:
            commanded = np.hstack([points[whole], np.zeros((len(whole), 3))])
            deviations = np.array([crossings[n] for n in whole], dtype=float)
            name = f"P{first + 1} to P{second + 1}"
            found.append(PathCycles(name, commanded, commanded[:, None] + deviations))
    return found


def _between(motion: Motion, begin: int, end: int) -> BoolArray:
    return np.asarray((motion.stamps_ns >= begin) & (motion.stamps_ns <= end))


def _planes(reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points evenly spaced along a path (n, 3), and its directions there."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(reference, axis=0), axis=1))])
    moving = np.concatenate([[True], np.diff(along) > 0.0])
    at = along[-1] * np.linspace(PATH_ENDS, 1.0 - PATH_ENDS, PATH_POINTS)
    step = 0.5 * (at[1] - at[0])

    def points(places: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(places, along[moving], column[moving]) for column in reference.T])

    directions = points(at + step) - points(at - step)
    return points(at), directions / np.linalg.norm(directions, axis=1)[:, None]


def _crossing(motion: Motion, cycle: BoolArray, point: FloatArray, normal: FloatArray) -> FloatArray | None:
    """Return the deviation of the endpoint from the reference where both cross a plane, (6,); None: not both do."""
    attained = _cross(motion.positions[cycle], point, normal)
    wanted = _cross(motion.references[cycle], point, normal)
    if attained is None or wanted is None:
        return None
    turn = np.full(3, np.nan)
    if motion.rotations is not None:
        sides = zip(motion.rotations, (attained, wanted), strict=True)
        there, commanded = (_between_rotations(rotations[cycle], each) for rotations, each in sides)
        turn = (there * commanded.inv()).as_rotvec()
    return np.concatenate([attained.place - wanted.place, turn])


def _cross(track: FloatArray, point: FloatArray, normal: FloatArray) -> _Crossing | None:
    """Return where a track (n, 3) crosses a plane next to its point; None: nowhere."""
    heights = (track - point) @ normal
    segments = np.flatnonzero((heights[:-1] < 0.0) != (heights[1:] < 0.0))
    if not segments.size:
        return None
    shares = heights[segments] / (heights[segments] - heights[segments + 1])
    places = track[segments] + shares[:, None] * (track[segments + 1] - track[segments])
    nearest = int(np.argmin(np.linalg.norm(places - point, axis=1)))
    return _Crossing(int(segments[nearest]), float(shares[nearest]), places[nearest])


def _between_rotations(rotations: Rotation, crossing: _Crossing) -> Rotation:
    first, second = rotations[crossing.segment], rotations[crossing.segment + 1]
    return first * Rotation.from_rotvec(crossing.share * (first.inv() * second).as_rotvec())
