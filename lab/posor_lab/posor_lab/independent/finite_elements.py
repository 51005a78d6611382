# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sag of a beam on two gimbals by finite elements: Euler-Bernoulli elements of the bending in one plane.

Degrees of freedom of a node: deflection w [m], slope w' [rad]. Gravity acts as the consistent loads of a uniform mass,
and as the weight of the plates at their nodes. With a node at every support, plate and end the deflections at the
nodes are those of the theory of beams: shear, axial strain and large deflections are left out, as in the files.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from posor_lab.independent.file_values import si_values

FloatArray = NDArray[np.float64]

_LONGEST = 0.05
"""Greatest share of the beam's length of one element."""
_SAME = 1e-9
"""Places that are nearer to each other than this share of the length are one node."""


def _element_stiffness(stiffness: float, length: float) -> FloatArray:
    """Return the matrix (4, 4) of one element of bending stiffness E I [N m^2]; order w, w' of both ends."""
    s = length
    return np.array(
        [
            [12.0, 6.0 * s, -12.0, 6.0 * s],
            [6.0 * s, 4.0 * s * s, -6.0 * s, 2.0 * s * s],
            [-12.0, -6.0 * s, 12.0, -6.0 * s],
            [6.0 * s, 2.0 * s * s, -6.0 * s, 4.0 * s * s],
        ]
    ) * (stiffness / s**3)


def end_motions(length: float, entry: dict[str, Any]) -> FloatArray:
    """Return deflection [m] and slope [rad] of both ends, (2, 2), under a field of 1 m/s^2 across the beam.

    ``entry``: ``sag`` of a beam in the beams file. The motions count from the line through the gimbals.
    """
    tube = entry["tube"]
    outer, inner = (float(si_values(tube[name], "m")) for name in ("outer_diameter", "inner_diameter"))
    stiffness = float(si_values(tube["modulus"], "Pa")) * math.pi * (outer**4 - inner**4) / 64.0
    mass_per_length = float(si_values(tube["density"], "kg/m^3")) * math.pi * (outer**2 - inner**2) / 4.0
    gimbals = si_values(entry["gimbals"], "m")
    plates = [(float(si_values(p["at"], "m")), float(si_values(p["mass"], "kg"))) for p in entry.get("plates", ())]
    marks = np.unique([0.0, length, *gimbals, *(at for at, _ in plates)])
    marks = marks[np.append(np.diff(marks) > _SAME * length, True)]
    parts = [np.linspace(a, b, 1 + math.ceil((b - a) / (_LONGEST * length)))[:-1] for a, b in pairwise(marks)]
    nodes = np.append(np.concatenate(parts), marks[-1])
    matrix, load = np.zeros((2 * len(nodes), 2 * len(nodes))), np.zeros(2 * len(nodes))
    for i, size in enumerate(np.diff(nodes)):
        of_element = slice(2 * i, 2 * i + 4)
        matrix[of_element, of_element] += _element_stiffness(stiffness, size)
        load[of_element] += mass_per_length * size * np.array([0.5, size / 12.0, 0.5, -size / 12.0])
    for at, mass in plates:
        load[2 * int(np.argmin(np.abs(nodes - at)))] += mass
    held = [2 * int(np.argmin(np.abs(nodes - at))) for at in gimbals]
    free = np.setdiff1d(np.arange(len(load)), held)
    motion = np.zeros(len(load))
    motion[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return np.array([motion[:2], motion[-2:]])


def sag_gains(span: FloatArray, entry: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
    """Return the motions of the plates at start and end for a field of 1 m/s^2 along each axis of the start, (6, 3).

    Rows: translation [m], rotation vector [rad]. ``span``: from start to end [m], (3,). Only the part of the field
    across the beam bends it: the tangent leans toward the field by the slope.
    """
    length = float(np.linalg.norm(span))
    along = span / length
    gains = []
    for deflection, slope in end_motions(length, entry):
        columns = []
        for axis in np.eye(3):
            across = axis - along * (along @ axis)
            columns.append(np.concatenate([deflection * across, slope * np.cross(along, across)]))
        gains.append(np.column_stack(columns))
    return gains[0], gains[1]
