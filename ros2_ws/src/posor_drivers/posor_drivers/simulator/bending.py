"""How the structural links bend and twist under their own weight and all that they carry.

Each link is a cantilever, clamped to the target side of its joint. Loads and lever arms are those of the straight arm
in its present orientation (first-order theory); the measuring beams are counted with the masses, not by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.beam import Tube, cantilever

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import FloatArray

    from posor_drivers.simulator.poses import Poses
    from posor_drivers.simulator.scenario import Structure


@dataclass(frozen=True)
class Compliance:
    """Displacement [m] and slope [rad] of a link's end for unit loads, and its twist for a unit torque.

    Attributes:
        length: [m].
        load: Deflection and slope for 1 N/m across, all along the link.
        force: The same for 1 N across, at the end.
        moment: The same for 1 N m about an axis across, at the end.
        twist: [rad] for 1 N m about the link's axis, at the end.
        mass_per_length: [kg/m].
        end_mass: [kg].

    """

    length: float
    load: tuple[float, float]
    force: tuple[float, float]
    moment: tuple[float, float]
    twist: float
    mass_per_length: float
    end_mass: float

    @classmethod
    def of(cls, structure: Structure | None, length: float) -> Compliance:
        """Return that of a tube; of None: rigid, without mass."""
        none = (0.0, 0.0)
        if structure is None:
            return cls(length, none, none, none, 0.0, 0.0, 0.0)
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
class Bends:
    """What the end of a link does: displacement [m] and rotation vector [rad], (n, 3) each, axes of its start."""

    translations: FloatArray
    rotations: FloatArray


def bends(
    starts: Sequence[Poses],
    ends: Sequence[FloatArray],
    compliances: Sequence[Compliance],
    payload: float,
    gravity: FloatArray,
) -> list[Bends]:
    """Return how each link bends.

    Args:
        starts: Frame at the start of each link in the base, straight arm.
        ends: Position of each link's end, seen from its start [m], (3,).
        compliances: Of each link.
        payload: At the end of the last link [kg].
        gravity: [m/s^2], (3,), in the base.

    """
    count = len(starts[0])
    force, moment = np.tile(payload * gravity, (count, 1)), np.zeros((count, 3))
    out: list[Bends] = []
    for start, end, link in zip(reversed(starts), reversed(ends), reversed(compliances), strict=True):
        span = start.turned(end)
        # Force and moment about the end of this link, of all that is beyond it and of the mass at it.
        force = force + link.end_mass * gravity
        out.append(_bend(start, span, link, force, moment, gravity))
        # And about its start, where the link before it ends: its own weight comes in half-way.
        weight = link.mass_per_length * link.length * gravity
        moment = moment + np.cross(span, force) + np.cross(0.5 * span, weight)
        force = force + weight
    return out[::-1]


def _bend(
    start: Poses, span: FloatArray, link: Compliance, force: FloatArray, moment: FloatArray, gravity: FloatArray
) -> Bends:
    """Return the bend of one link; all vectors in the base but the result."""
    if link.length == 0.0:
        return Bends(np.zeros(span.shape), np.zeros(span.shape))
    along = span / link.length

    def across(vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - along * np.sum(along * vectors, axis=1, keepdims=True))

    # A moment bends toward (moment x along); a slope toward y is a turn about (along x y).
    pull = across(np.cross(moment, along))
    push = across(force)
    load = across(np.broadcast_to(link.mass_per_length * gravity, span.shape))
    deflection = link.load[0] * load + link.force[0] * push + link.moment[0] * pull
    slope = link.load[1] * load + link.force[1] * push + link.moment[1] * pull
    twist = along * (link.twist * np.sum(along * moment, axis=1, keepdims=True))
    return Bends(start.turned_back(deflection), start.turned_back(np.cross(along, slope) + twist))
