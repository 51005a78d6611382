# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sag of a beam on two gimbals by finite elements: Euler-Bernoulli elements of the bending in one plane.

Degrees of freedom of a node: deflection w [m], slope w' [rad]. Gravity acts as the consistent loads of a uniform mass,
and as the weight of the plates at their nodes. With a node at every support, plate and end the deflections at the nodes
are those of the theory of beams: shear, axial strain and large deflections are left out, as in the files. In vibration
the mass is consistent, and that of the plates is in their nodes.
"""

from __future__ import annotations

import math
from functools import cached_property
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


def _element_mass(mass: float, length: float) -> FloatArray:
    """Return the consistent mass (4, 4) of one element of mass per length [kg/m]; order w, w' of both ends."""
    s = length
    return np.array(
        [
            [156.0, 22.0 * s, 54.0, -13.0 * s],
            [22.0 * s, 4.0 * s * s, 13.0 * s, -3.0 * s * s],
            [54.0, 13.0 * s, 156.0, -22.0 * s],
            [-13.0 * s, -3.0 * s * s, -22.0 * s, 4.0 * s * s],
        ]
    ) * (mass * s / 420.0)


class GimballedBeam:
    """A beam on its gimbals: stiffness, mass, and what is free to move; order w, w' of each node."""

    def __init__(self, length: float, entry: dict[str, Any]) -> None:
        """``entry``: ``sag`` of a beam in the beams file."""
        tube = entry["tube"]
        outer, inner = (float(si_values(tube[name], "m")) for name in ("outer_diameter", "inner_diameter"))
        stiffness = float(si_values(tube["modulus"], "Pa")) * math.pi * (outer**4 - inner**4) / 64.0
        mass_per_length = float(si_values(tube["density"], "kg/m^3")) * math.pi * (outer**2 - inner**2) / 4.0
        gimbals = si_values(entry["gimbals"], "m")
        plates = [(float(si_values(p["at"], "m")), float(si_values(p["mass"], "kg"))) for p in entry.get("plates", ())]
        marks = np.unique([0.0, length, *gimbals, *(at for at, _ in plates)])
        marks = marks[np.append(np.diff(marks) > _SAME * length, True)]
        parts = [np.linspace(a, b, 1 + math.ceil((b - a) / (_LONGEST * length)))[:-1] for a, b in pairwise(marks)]
        self.nodes = np.append(np.concatenate(parts), marks[-1])
        count = 2 * len(self.nodes)
        self.stiffness, self.mass = np.zeros((count, count)), np.zeros((count, count))
        for i, size in enumerate(np.diff(self.nodes)):
            of_element = slice(2 * i, 2 * i + 4)
            self.stiffness[of_element, of_element] += _element_stiffness(stiffness, size)
            self.mass[of_element, of_element] += _element_mass(mass_per_length, size)
        for at, mass in plates:
            node = 2 * int(np.argmin(np.abs(self.nodes - at)))
            self.mass[node, node] += mass
        held = [2 * int(np.argmin(np.abs(self.nodes - at))) for at in gimbals]
        self._free = np.setdiff1d(np.arange(count), held)
        rigid = np.zeros((count, 2))
        rigid[::2, 0], rigid[::2, 1], rigid[1::2, 1] = 1.0, self.nodes / length - 0.5, 1.0 / length
        self._loads = self.mass @ rigid

    @cached_property
    def first_frequency(self) -> float:
        """Lowest natural frequency [Hz]."""
        free = np.ix_(self._free, self._free)
        squares = np.linalg.eigvals(np.linalg.solve(self.stiffness[free], self.mass[free])).real
        return float(1.0 / np.sqrt(squares.max()) / (2.0 * math.pi))

    def end_motions(self, frequency: float = 0.0, damping: float = 0.0) -> NDArray[np.complex128]:
        """Return deflection [m] and slope [rad] of both ends in steady vibration, (2, 2, 2): load, end, motion.

        Loads: a field of 1 m/s^2 across the beam; a field that grows by 1 m/s^2 along the beam, from -0.5 m/s^2.
        ``damping``: share of the critical one in the first mode; the dashpots are in proportion to the stiffness. The
        motions count from the line through the gimbals.
        """
        free, angular = np.ix_(self._free, self._free), 2.0 * math.pi * frequency
        lag = 2j * damping * frequency / self.first_frequency if damping else 0.0
        dynamic = (1.0 + lag) * self.stiffness[free] - angular**2 * self.mass[free]
        motion = np.zeros(self._loads.shape, dtype=complex)
        motion[self._free] = np.linalg.solve(dynamic, self._loads[self._free])
        return np.stack([motion[:2], motion[-2:]]).transpose(2, 0, 1)


def end_motions(length: float, entry: dict[str, Any]) -> FloatArray:
    """Return deflection [m] and slope [rad] of both ends, (2, 2), under a field of 1 m/s^2 across the beam.

    ``entry``: ``sag`` of a beam in the beams file. The motions count from the line through the gimbals.
    """
    return np.asarray(GimballedBeam(length, entry).end_motions()[0].real)


def vibration_gains(
    span: FloatArray, entry: dict[str, Any], damping: float, frequencies: FloatArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the motions of the plates in steady vibration, (m, 6, 6), as ``TrueLink.vibration_gains``."""
    length = float(np.linalg.norm(span))
    beam, along = GimballedBeam(length, entry), span / length
    across = np.eye(3) - np.outer(along, along)
    turned = np.cross(along, across).T
    motions = np.array([beam.end_motions(each, damping) for each in frequencies])  # (m, load, end, motion)
    gains = np.zeros((2, len(frequencies), 6, 6), dtype=complex)
    for end in range(2):
        for load in range(2):
            columns = slice(3 * load, 3 * load + 3)
            gains[end, :, :3, columns] = motions[:, load, end, 0, None, None] * across
            gains[end, :, 3:, columns] = motions[:, load, end, 1, None, None] * turned
    return gains[0], gains[1]


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
