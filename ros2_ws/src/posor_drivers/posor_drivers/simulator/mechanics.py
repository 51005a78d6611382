# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Mechanical imperfections of one joint and its link: backlash, encoder steps, bearing error motion, bending.

A structural link is a cantilever tube clamped to the target side of its joint. Loads and lever arms are those of the
straight arm in its present orientation (first-order theory). The weight of the measuring beams belongs to the end
masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.chain.beam_bending import Tube, cantilever

from posor_drivers.simulator.pose_array import PoseArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.scenario import Bearing, Structure


def apply_backlash(motor: FloatArray, backlash: float) -> FloatArray:
    """Return the joint angle [rad] behind a gear with backlash, for the motor angle over one cycle, (n,) each.

    Play operator: the joint stands still until the motor has crossed the backlash, then follows half of it behind.
    The state at the start is that at the end of the same cycle.
    """
    half = 0.5 * backlash
    joint = np.empty(len(motor))
    last = float(motor[0])
    for _ in range(2):  # the first pass finds the state at the start of the cycle
        for n, angle in enumerate(motor.tolist()):
            last = min(max(last, angle - half), angle + half)
            joint[n] = last
    return joint


def quantise_encoder(motor: FloatArray, resolution: float) -> FloatArray:
    """Return the motor angle rounded to the nearest encoder step [rad]."""
    return np.asarray(resolution * np.round(motor / resolution))


def bearing_error_motions(bearing: Bearing, angles: FloatArray, random: np.random.Generator) -> PoseArray:
    """Return the error motions at joint angles [rad], (n,), in the axes of the bearing's fixed side.

    With k an order of the rotation and phi, psi, chi phases drawn once, summed over the orders:

        x, y      radial_k (cos, sin)(k theta + phi_k)
        z         axial_k cos(k theta + psi_k)
        about X,Y tilt_k (cos, sin)(k theta + chi_k)
    """
    orders = np.array(bearing.orders, dtype=float)
    phases = random.uniform(0.0, 2.0 * np.pi, size=(3, len(orders)))
    radial, axial, tilt = (angles[:, None] * orders + phase for phase in phases)
    x, y = np.cos(radial) @ bearing.radial.array, np.sin(radial) @ bearing.radial.array
    about_x, about_y = np.cos(tilt) @ bearing.tilt.array, np.sin(tilt) @ bearing.tilt.array
    return PoseArray.from_rotation_vectors(
        np.column_stack([x, y, np.cos(axial) @ bearing.axial.array]),
        np.column_stack([about_x, about_y, np.zeros(len(angles))]),
    )


@dataclass(frozen=True)
class LinkCompliance:
    """Deflection [m] and slope [rad] of a link's end for unit loads, and its twist for a unit torque."""

    length: float  # [m]
    load: tuple[float, float] = (0.0, 0.0)  # deflection and slope for 1 N/m across, along the whole link
    force: tuple[float, float] = (0.0, 0.0)  # deflection and slope for 1 N across, at the end
    moment: tuple[float, float] = (0.0, 0.0)  # deflection and slope for 1 N m about an axis across, at the end
    twist: float = 0.0  # [rad] for 1 N m about the link's axis, at the end
    mass_per_length: float = 0.0  # [kg/m]
    end_mass: float = 0.0  # [kg]

    @classmethod
    def from_structure(cls, structure: Structure | None, length: float) -> LinkCompliance:
        """Return the compliance of a tube; without structure the link is rigid and has no mass."""
        if structure is None:
            return cls(length)
        tube = Tube(
            structure.outer_diameter.number,
            structure.inner_diameter.number,
            structure.modulus.number,
            structure.density.number,
        )

        def end(load: float, force: float, moment: float) -> tuple[float, float]:
            bent = cantilever(length, tube.bending_stiffness, load, force, moment)
            return bent.deflection(length), bent.slope(length)

        return cls(
            length,
            end(1.0, 0.0, 0.0),
            end(0.0, 1.0, 0.0),
            end(0.0, 0.0, 1.0),
            length / (structure.shear_modulus.number * 2.0 * tube.second_moment),
            tube.mass_per_length,
            structure.end_mass.number,
        )


@dataclass(frozen=True)
class LinkBend:
    """Motion of a link's end: displacement [m] and rotation vector [rad], (n, 3) each, axes of the link's start."""

    translations: FloatArray
    rotations: FloatArray


def bend_links(
    starts: Sequence[PoseArray],
    ends: Sequence[FloatArray],
    compliances: Sequence[LinkCompliance],
    payload: float,
    gravity: FloatArray,
) -> list[LinkBend]:
    """Return the bend of each link.

    Args:
        starts: Frame at the start of each link in the base, straight arm.
        ends: End of each link in its start frame [m], (3,).
        compliances: Of each link.
        payload: Mass at the end of the last link [kg].
        gravity: [m/s^2], (3,), in the base.

    """
    count = len(starts[0])
    force, moment = np.tile(payload * gravity, (count, 1)), np.zeros((count, 3))
    bends: list[LinkBend] = []
    for start, end, link in zip(reversed(starts), reversed(ends), reversed(compliances), strict=True):
        span = start.rotate(end)
        # Force and moment about the end of this link, of everything beyond it and of the mass at its end.
        force = force + link.end_mass * gravity
        bends.append(_bend_link(start, span, link, force, moment, gravity))
        # The same about its start, where the previous link ends; its own weight acts half-way.
        weight = link.mass_per_length * link.length * gravity
        moment = moment + np.cross(span, force) + np.cross(0.5 * span, weight)
        force = force + weight
    return bends[::-1]


def _bend_link(
    start: PoseArray, span: FloatArray, link: LinkCompliance, force: FloatArray, moment: FloatArray, gravity: FloatArray
) -> LinkBend:
    """Return the bend of one link; all arguments are in the base axes."""
    if link.length == 0.0:
        return LinkBend(np.zeros(span.shape), np.zeros(span.shape))
    along = span / link.length

    def across(vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - along * np.sum(along * vectors, axis=1, keepdims=True))

    # A moment bends towards (moment x along); a slope towards y is a rotation about (along x y).
    pull = across(np.cross(moment, along))
    push = across(force)
    load = across(np.broadcast_to(link.mass_per_length * gravity, span.shape))
    deflection = link.load[0] * load + link.force[0] * push + link.moment[0] * pull
    slope = link.load[1] * load + link.force[1] * push + link.moment[1] * pull
    twist = along * (link.twist * np.sum(along * moment, axis=1, keepdims=True))
    return LinkBend(start.rotate_back(deflection), start.rotate_back(np.cross(along, slope) + twist))
