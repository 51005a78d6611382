# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Figures of ISO 9283 once more, from the table of points that ``posor iso9283`` writes, with other formulas and sums.

Written from the public description of the standard alone; it shares no code with ``posor_design.iso9283``. Run it as a
script: ``python iso9283_by_hand.py points.csv``.
"""

from __future__ import annotations

import csv
import json
import sys
from itertools import groupby, pairwise
from math import fsum, hypot, sqrt
from pathlib import Path

LEAST_DISTANCE = 1e-3  # [m]; nearer poses are at one place
LEAST_CYCLES = 2


def mean(numbers: list[float]) -> float:
    """Return the mean by an exact sum."""
    return fsum(numbers) / len(numbers)


def deviation(numbers: list[float]) -> float:
    """Return the standard deviation of a sample."""
    middle = mean(numbers)
    return sqrt(fsum((each - middle) ** 2 for each in numbers) / (len(numbers) - 1))


def spread(points: list[list[float]]) -> float:
    """Return mean distance from the barycentre and three standard deviations of it."""
    centre = [mean([point[k] for point in points]) for k in range(3)]
    distances = [hypot(*(point[k] - centre[k] for k in range(3))) for point in points]
    return mean(distances) + 3.0 * deviation(distances)


def of_points(commanded: list[float], attained: list[list[float]]) -> dict[str, float]:
    """Return accuracy and repeatability at one point of the command."""
    away = [mean([point[k] for point in attained]) - commanded[k] for k in range(6)]
    found = {"A_p": hypot(*away[:3]), "R_l": spread(attained)}
    found |= {f"A_{name}": away[k] for k, name in enumerate("xyzabc")}
    return found | {f"R_{name}": 3.0 * deviation([point[k] for point in attained]) for k, name in enumerate("xyzabc")}


def between(one: list[float], two: list[float]) -> list[float]:
    """Return the distance of two points along each axis."""
    return [one[k] - two[k] for k in range(3)]


def in_turn(points: dict[int, list[float]], next_points: dict[int, list[float]]) -> list[list[float]]:
    """Return the distance of each two dwells of which no other dwell of the two poses is between."""
    found, last = [], None
    for dwell in sorted({*points, *next_points}):
        if dwell in points:
            last = points[dwell]
        elif last is not None:
            found.append(between(last, next_points[dwell]))
            last = None
    return found


def figures_of(path: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Return the figures of all poses, distances and paths of a table of points."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found: dict[str, dict[str, dict[str, float]]] = {"poses": {}, "distances": {}, "paths": {}}
    poses: list[tuple[str, list[float], dict[int, list[float]]]] = []  # name, command, points by dwell
    for (what, name), own in groupby(rows, key=lambda row: (row["what"], row["name"])):
        at: list[dict[str, float]] = []
        for _, cycles in groupby(own, key=lambda row: row["point"]):
            by_dwell = {int(row["dwell"]): [float(row[axis]) for axis in "xyzabc"] for row in cycles}
            commanded = by_dwell.pop(0)
            at.append(of_points(commanded, list(by_dwell.values())))
            if what == "pose":
                poses.append((name, commanded, by_dwell))
        if what == "pose":
            point = at[0]
            found["poses"][name] = {f"AP_{axis}": point[f"A_{axis}"] for axis in "pxyzabc"}
            found["poses"][name] |= {f"RP_{axis}": point[f"R_{axis}"] for axis in "labc"}
        else:
            largest = {key: max(abs(point[key]) for point in at) for key in at[0]}
            found["paths"][name] = {f"AT_{axis}": largest[f"A_{axis}"] for axis in "pabc"}
            found["paths"][name] |= {"RT_p": largest["R_l"], **{f"RT_{axis}": largest[f"R_{axis}"] for axis in "abc"}}
    for (first, one, points), (second, two, next_points) in pairwise(poses):
        rooms = [between(one, two), *in_turn(points, next_points)]
        wanted, *seen = ([hypot(*room), *map(abs, room)] for room in rooms)
        if len(seen) < LEAST_CYCLES or wanted[0] <= LEAST_DISTANCE:
            continue
        found["distances"][f"{first} to {second}"] = {
            **{f"AD{n}": mean([s[k] for s in seen]) - wanted[k] for k, n in enumerate(("", "_x", "_y", "_z"))},
            **{f"RD{n}": 3.0 * deviation([s[k] for s in seen]) for k, n in enumerate(("", "_x", "_y", "_z"))},
        }
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(figures_of(Path(sys.argv[1])), indent=2) + "\n")
