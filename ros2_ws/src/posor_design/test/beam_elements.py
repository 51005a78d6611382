# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A beam of many two-node Timoshenko elements with lumped mass: independent of the spectral elements under test."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from posor.numerics.array_types import FloatArray

ELEMENTS = 180


@dataclass
class ElementBeam:
    """Deflections and slopes of ELEMENTS + 1 nodes, in turn; ``bending`` E I, ``shear`` of the section, per length."""

    length: float
    bending: float
    shear: float
    mass: float
    inertia: float

    def __post_init__(self) -> None:
        h = self.length / ELEMENTS
        size = 2 * (ELEMENTS + 1)
        phi = 12.0 * self.bending / (self.shear * h**2)
        element = np.array(
            [
                [12.0, 6.0 * h, -12.0, 6.0 * h],
                [6.0 * h, (4.0 + phi) * h**2, -6.0 * h, (2.0 - phi) * h**2],
                [-12.0, -6.0 * h, 12.0, -6.0 * h],
                [6.0 * h, (2.0 - phi) * h**2, -6.0 * h, (4.0 + phi) * h**2],
            ]
        )
        element *= self.bending / (h**3 * (1.0 + phi))
        self.K: FloatArray = np.zeros((size, size))
        self.M: FloatArray = np.zeros((size, size))
        self.held: list[int] = []
        for first in range(0, size - 2, 2):
            self.K[first : first + 4, first : first + 4] += element
            self.M[range(first, first + 4), range(first, first + 4)] += 0.5 * h * np.tile([self.mass, self.inertia], 2)

    def node(self, at: float) -> int:
        """Return the deflection at a node; the slope is the next coordinate."""
        number = at / self.length * ELEMENTS
        assert math.isclose(number, round(number), abs_tol=1e-6)
        return 2 * round(number)

    def add(
        self, at: float, mass: float = 0.0, inertia: float = 0.0, spring: float = 0.0, turning: float = 0.0
    ) -> None:
        node = self.node(at)
        self.M[node, node] += mass
        self.M[node + 1, node + 1] += inertia
        self.K[node, node] += spring
        self.K[node + 1, node + 1] += turning

    def pin(self, *places: float) -> None:
        self.held += [self.node(at) for at in places]

    def clamp(self, at: float) -> None:
        self.held += [self.node(at), self.node(at) + 1]

    @property
    def free(self) -> tuple[FloatArray, ...]:
        kept = np.setdiff1d(np.arange(len(self.K)), self.held)
        return np.ix_(kept, kept)

    def frequencies(self, count: int) -> FloatArray:
        squares = scipy.linalg.eigvalsh(self.K[self.free], self.M[self.free], subset_by_index=(0, count - 1))
        return np.sqrt(squares)

    def response(self, frequency: float) -> FloatArray:
        """Return all coordinates under a uniform specific force of 1 m/s^2 at a frequency [rad/s]."""
        kept = self.free[1][0]
        force = (self.M @ np.tile([1.0, 0.0], ELEMENTS + 1))[kept]
        motion = np.zeros(len(self.K))
        motion[kept] = np.linalg.solve(self.K[self.free] - frequency**2 * self.M[self.free], force)
        return motion
