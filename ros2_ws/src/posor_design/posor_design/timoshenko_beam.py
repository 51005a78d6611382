# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Vibration of uniform Timoshenko beams by spectral elements.

Deflection and turn of the section are polynomials of high degree between the points where something is attached. The
energies are integrated exactly, so frequencies converge exponentially with the degree, without shear locking.
Source: Timoshenko beam; Canuto, Hussaini, Quarteroni and Zang, Spectral Methods (2006), chapter 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy.linalg
from numpy.polynomial import Legendre, legendre

from posor_design.beam_section import make_section

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

LEAST_DEGREE = 12
DEGREES_PER_HALF_WAVE = 2
LARGEST_ERROR = 1e-4
"""Largest relative difference of a natural frequency from the Rayleigh quotient of its shape; rounding causes it."""


@dataclass(frozen=True)
class UniformBeam:
    """A beam along x: all but the ``length`` [m] per length."""

    length: float  # [m]
    bending_stiffness: float  # E I [N m^2]
    shear_stiffness: float  # shear coefficient times G A [N]
    mass: float  # [kg/m]
    rotary_inertia: float  # rotary inertia of the sections about the axis across the plane of bending [kg m]


def make_beam(
    shape: Literal["tube", "box"],
    height: float,
    wall: float,
    width: float,
    length: float,
    modulus: float,
    density: float,
    poisson_ratio: float,
) -> UniformBeam:
    """Return the beam of a section and a material.

    Raises ParameterError: the walls leave no hole, or the width does not suit the shape.
    """
    section = make_section(shape, height, width, wall)
    shear_modulus = modulus / (2.0 * (1.0 + poisson_ratio))
    return UniformBeam(
        length,
        bending_stiffness=modulus * section.second_moment,
        shear_stiffness=section.shear_coefficient(poisson_ratio) * section.area * shear_modulus,
        mass=density * section.area,
        rotary_inertia=density * section.second_moment,
    )


@dataclass(frozen=True)
class Attachment:
    """What is fixed to the beam at a point: a plate, a support, or both."""

    at: float  # distance from the beam's start [m]
    mass: float = 0.0  # [kg]
    inertia: float = 0.0  # about the axis across the plane of bending [kg m^2]
    stiffness: float = 0.0  # against deflection [N/m]; infinite: the deflection is held
    turning_stiffness: float = 0.0  # against a turn of the section [N m/rad]; infinite: the turn is held


class BeamModel:
    """Stiffness and mass of a supported beam with n nodes; coordinates: n deflections [m], then n turns [rad]."""

    def __init__(self, beam: UniformBeam, attachments: Sequence[Attachment], half_waves: int) -> None:
        """Create the model.

        ``attachments``: plates and supports; the supports allow no motion of the beam as a rigid body. ``half_waves``:
        largest number of half waves along the beam that the model has to resolve.
        """
        degree = LEAST_DEGREE + DEGREES_PER_HALF_WAVE * half_waves
        element = _ReferenceElement(degree)
        ends = np.unique([0.0, beam.length, *(each.at for each in attachments)])
        count = degree * (len(ends) - 1) + 1
        self.positions: FloatArray = np.empty(count)  # of the nodes along the beam [m], (n,)
        self.stiffness: FloatArray = np.zeros((2 * count, 2 * count))  # (2 n, 2 n)
        self.mass: FloatArray = np.zeros((2 * count, 2 * count))  # (2 n, 2 n)
        for number, (start, end) in enumerate(pairwise(ends)):
            nodes = degree * number + np.arange(degree + 1)
            self.positions[nodes] = 0.5 * (start + end) + 0.5 * (end - start) * element.nodes
            place = np.ix_(np.concatenate([nodes, count + nodes]), np.concatenate([nodes, count + nodes]))
            stiffness, mass = element.matrices(beam, 0.5 * (end - start))
            self.stiffness[place] += stiffness
            self.mass[place] += mass
        held = []
        for each in attachments:
            node = self.node(each.at)
            self.mass[node, node] += each.mass
            self.mass[count + node, count + node] += each.inertia
            for row, stiffness_here in ((node, each.stiffness), (count + node, each.turning_stiffness)):
                if math.isinf(stiffness_here):
                    held.append(row)
                else:
                    self.stiffness[row, row] += stiffness_here
        self._free = np.setdiff1d(np.arange(2 * count), held)

    def node(self, at: float) -> int:
        """Return the node at an end of the beam or at an attachment."""
        return int(np.argmin(np.abs(self.positions - at)))

    def modes(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the lowest natural frequencies [rad/s], (count,), and their shapes, (count, 2 n).

        Raises LinAlgError: the stiffness is singular, or so nearly that rounding decides a frequency.
        """
        free = np.ix_(self._free, self._free)
        size = len(self._free)
        # The inverse problem: its largest values are the lowest frequencies, and only the stiffness has to be definite.
        values, vectors = scipy.linalg.eigh(
            self.mass[free], self.stiffness[free], subset_by_index=(size - count, size - 1)
        )
        shapes = np.zeros((count, len(self.stiffness)))
        shapes[:, self._free] = vectors.T[::-1]
        frequencies = 1.0 / np.sqrt(values[::-1])
        quotients = _squares(shapes, self.stiffness) / _squares(shapes, self.mass)
        if not np.allclose(np.sqrt(quotients), frequencies, rtol=LARGEST_ERROR, atol=0.0):
            message = "the stiffness is nearly singular"
            raise np.linalg.LinAlgError(message)
        return frequencies, shapes

    def response(self, frequency: float, loss_factor: float) -> Any:
        """Return the amplitudes of the motion relative to the supports under a uniform specific force of 1 m/s^2.

        ``frequency``: of the force [rad/s]. ``loss_factor``: imaginary over real part of the stiffness. Returns the
        complex amplitudes, (2 n,); the force is real.
        """
        free = np.ix_(self._free, self._free)
        uniform = np.repeat([1.0, 0.0], len(self.positions))
        dynamic = (1.0 + 1j * loss_factor) * self.stiffness[free] - frequency**2 * self.mass[free]
        amplitudes = np.zeros(len(uniform), dtype=complex)
        amplitudes[self._free] = np.linalg.solve(dynamic, (self.mass @ uniform)[self._free])
        return amplitudes


def _squares(shapes: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return ``x @ matrix @ x`` of each shape x, (count,)."""
    return np.asarray(np.sum(shapes @ matrix * shapes, axis=1))


class _ReferenceElement:
    """Lagrange polynomials on the Gauss-Lobatto nodes of -1 to 1, integrated exactly by Gauss points."""

    def __init__(self, degree: int) -> None:
        self.nodes: FloatArray = np.concatenate([[-1.0], np.sort(Legendre.basis(degree).deriv().roots().real), [1.0]])
        points, self._weights = legendre.leggauss(degree + 1)
        coefficients = np.linalg.inv(legendre.legvander(self.nodes, degree))
        self._values = legendre.legvander(points, degree) @ coefficients
        self._slopes = legendre.legval(points, legendre.legder(coefficients)).T

    def matrices(self, beam: UniformBeam, half_length: float) -> tuple[FloatArray, FloatArray]:
        """Return stiffness and mass of an element, both (2 n, 2 n): n deflections, then n turns."""
        values, slopes = self._values, self._slopes / half_length
        weights = half_length * self._weights[:, None]
        size = len(self.nodes)
        no_slope = np.zeros_like(values)
        shear = np.hstack([slopes, -values])
        bending = np.hstack([no_slope, slopes])
        stiffness = beam.shear_stiffness * shear.T @ (weights * shear)
        stiffness += beam.bending_stiffness * bending.T @ (weights * bending)
        mass = np.zeros((2 * size, 2 * size))
        consistent = values.T @ (weights * values)
        mass[:size, :size] = beam.mass * consistent
        mass[size:, size:] = beam.rotary_inertia * consistent
        return stiffness, mass
