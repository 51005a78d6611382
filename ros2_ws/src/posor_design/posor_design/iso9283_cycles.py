# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses and paths of the cycles of a recorded motion: the points from which the figures of ISO 9283 are computed.

A pose is where the reference stands still; dwells at the same place in the same orientation are its cycles. A path
leads from one dwell to the next; a later motion between the same two poses is its next cycle. A cycle of a distance is
a dwell at its second pose and the last dwell at its first pose before it. A deviation is that of the endpoint from the
reference at the same time (pose), or in the same plane across the path (8.2), so the reference may be a command or an
instrument that follows each cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from posor.bags.recording import POSE
from posor.errors import TrackError
from scipy.spatial.transform import Rotation

from posor_design.iso9283 import LEAST_CYCLES, Figures, distance_figures, path_figures, pose_figures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.bags.recording import Track
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

PATH_POINTS = 50  # of a path
PATH_ENDS = 0.05  # part of the length of a path that is left out at either end, where the arm starts and stops


class Motion(NamedTuple):
    """Endpoint and reference at n stamps, in the base."""

    source: str  # of the reference, for error messages
    stamps_ns: IntArray  # (n,)
    positions: FloatArray  # of the endpoint [m], (n, 3)
    references: FloatArray  # (n, 3)
    rotations: Rotation  # of the endpoint, n
    reference_rotations: Rotation | None  # n; None: unknown

    @property
    def orientations(self) -> Rotation:
        """Orientation of the reference, of the endpoint where that is unknown; n."""
        return self.rotations if self.reference_rotations is None else self.reference_rotations

    def between(self, begin_ns: int, end_ns: int) -> BoolArray:
        """Return which stamps are in a time [ns], (n,)."""
        return np.asarray((self.stamps_ns >= begin_ns) & (self.stamps_ns <= end_ns))

    def turn(self, where: BoolArray) -> FloatArray:
        """Return the mean turn from the orientation of the reference to that of the endpoint [rad], (3,); or NaN."""
        if self.reference_rotations is None:
            return np.full(3, np.nan)
        turns = self.rotations[where] * self.reference_rotations[where].inv()
        return np.asarray(turns.as_rotvec().mean(axis=0))


class Sameness(NamedTuple):
    """By how much the dwells of one pose may differ."""

    distance: float  # of the references [m]
    turn: float  # of their orientations [rad]


class _Crossing(NamedTuple):
    """Where a track crosses a plane: number of the segment, place within it from 0 to 1, and position."""

    segment: int
    share: float
    place: FloatArray


@dataclass(frozen=True)
class Cycles:
    """The cycles of a pose or of a path."""

    kind: ClassVar[str]
    name: str
    dwells: tuple[int, ...]  # of each cycle: the number of its dwell, of a path the one that it leaves; from 1
    commanded: FloatArray  # (6,), or of each point of a path (points, 6)
    attained: FloatArray  # (cycles, 6), or (points, cycles, 6)


class PoseCycles(Cycles):
    """The cycles of one pose."""

    kind = "pose"

    def figures(self) -> Figures:
        """Return accuracy and repeatability."""
        return pose_figures(self.attained, self.commanded)


class PathCycles(Cycles):
    """The cycles of one path."""

    kind = "path"

    def figures(self) -> Figures:
        """Return accuracy and repeatability."""
        return path_figures(self.attained, self.commanded)


def motion_of(stamps_ns: IntArray, poses: FloatArray, track: Track, longest_gap_ns: int) -> Motion:
    """Return endpoint and reference at stamps at which both are known.

    ``poses``: of the endpoint, (n, 7). ``track``: points or poses, interpolated over at most ``longest_gap_ns``. Raises
    TrackError: it is known at no stamp.
    """
    references = track.interpolate(stamps_ns, longest_gap_ns)
    known = np.isfinite(references).all(axis=1)
    if not known.any():
        what = "has no value at the time of an endpoint"
        raise TrackError(what, where=track.source, expected="both at the same time")
    return Motion(
        track.source,
        stamps_ns[known],
        poses[known, :3],
        references[known, :3],
        Rotation.from_quat(poses[known, 3:]),
        Rotation.from_quat(references[known, 3:]) if references.shape[1] == POSE else None,
    )


def pose_cycles(
    motion: Motion, dwells: Sequence[tuple[int, int]], same: Sameness
) -> tuple[list[PoseCycles], list[int]]:
    """Return the poses in the order of their first dwell, and for each dwell the number of its pose, -1: no scan.

    ``dwells``: begin and end [ns] of each. Raises TrackError: a dwell is in motion.
    """
    centres: list[tuple[FloatArray, Rotation]] = []
    points: list[list[tuple[int, FloatArray, FloatArray]]] = []
    numbers = []
    for dwell, (begin, end) in enumerate(dwells, start=1):
        during = motion.between(begin, end)
        if not during.any():
            numbers.append(-1)
            continue
        reference, rotation = motion.references[during].mean(axis=0), motion.orientations[during].mean()
        moved = float(np.linalg.norm(motion.references[during] - reference, axis=1).max())
        turned = float((rotation.inv() * motion.orientations[during]).magnitude().max())
        if moved > same.distance or turned > same.turn:
            what = f"moves by {moved:.3g} m and turns by {turned:.3g} rad from its mean in dwell {dwell}"
            expected = f"at rest within {same.distance:g} m and {same.turn:g} rad"
            raise TrackError(f"{what} ({begin} to {end} ns)", where=motion.source, expected=expected)
        away = [
            float(np.linalg.norm(reference - place)) if (turn.inv() * rotation).magnitude() <= same.turn else np.inf
            for place, turn in centres
        ]
        number = int(np.argmin(away)) if away and min(away) <= same.distance else len(centres)
        if number == len(centres):
            centres.append((reference, rotation))
            points.append([])
        numbers.append(number)
        deviation = (motion.positions[during] - motion.references[during]).mean(axis=0)
        points[number].append((dwell, reference, np.concatenate([deviation, motion.turn(during)])))
    found = []
    for number, own in enumerate(points):
        own_dwells, references, deviations = zip(*own, strict=True)
        commanded = np.concatenate([np.mean(references, axis=0), np.zeros(3)])
        found.append(PoseCycles(f"P{number + 1}", own_dwells, commanded, commanded + np.array(deviations)))
    return found, numbers


def distance_cycles(first: PoseCycles, second: PoseCycles) -> list[tuple[int, int]]:
    """Return the cycles of a distance: the numbers, from 0, of the cycles of its two poses."""
    found = []
    for number, (since, dwell) in enumerate(pairwise((0, *second.dwells))):
        before = [own for own, begin in enumerate(first.dwells) if since < begin < dwell]
        if before:
            found.append((before[-1], number))
    return found


def distance_pairs(poses: Sequence[PoseCycles], same: float) -> dict[tuple[str, str], Figures]:
    """Return the figures of the distance of each two neighbouring poses with at least two cycles, if above ``same``."""
    found = {}
    for first, second in pairwise(poses):
        cycles = distance_cycles(first, second)
        commanded = np.array([first.commanded[:3], second.commanded[:3]])
        if len(cycles) >= LEAST_CYCLES and float(np.linalg.norm(commanded[0] - commanded[1])) > same:
            one, two = np.transpose(cycles)
            found[first.name, second.name] = distance_figures(
                first.attained[one, :3], second.attained[two, :3], commanded
            )
    return found


def path_cycles(
    motion: Motion, dwells: Sequence[tuple[int, int]], numbers: Sequence[int], same: float
) -> list[PathCycles]:
    """Return the paths between two poses that have at least two cycles and are longer than ``same`` [m].

    Points whose plane a cycle does not cross are left out.
    ``dwells``, ``numbers``: see ``pose_cycles``.
    """
    spans: dict[tuple[int, int], dict[int, BoolArray]] = {}
    for dwell, (((before, end), first), ((begin, after), second)) in enumerate(
        pairwise(zip(dwells, numbers, strict=True)), start=1
    ):
        if -1 not in (first, second) and first != second:
            span = motion.between((before + end) // 2, (begin + after) // 2)
            spans.setdefault((first, second), {})[dwell] = span
    found = []
    for (first, second), by_dwell in spans.items():
        cycles = list(by_dwell.values())
        if len(cycles) < LEAST_CYCLES or np.ptp(motion.references[cycles[0]], axis=0).max() <= same:
            continue  # the endpoint turns in place
        points, normals = _planes(motion.references[cycles[0]])
        crossings = [
            [_crossing(motion, cycle, *plane) for cycle in cycles] for plane in zip(points, normals, strict=True)
        ]
        whole = [n for n, own in enumerate(crossings) if all(each is not None for each in own)]
        if whole:
            commanded = np.hstack([points[whole], np.zeros((len(whole), 3))])
            deviations = np.array([crossings[n] for n in whole], dtype=float)
            name = f"P{first + 1} to P{second + 1}"
            found.append(PathCycles(name, tuple(by_dwell), commanded, commanded[:, None] + deviations))
    return found


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
    if motion.reference_rotations is not None:
        there = _between_rotations(motion.rotations[cycle], attained)
        commanded = _between_rotations(motion.reference_rotations[cycle], wanted)
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
