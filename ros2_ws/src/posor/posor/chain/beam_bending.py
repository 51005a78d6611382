# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Static bending of straight beams (Euler-Bernoulli), exact: polynomials with singularity functions.

A beam along x from 0 to its length bends along y under loads along y:

    E I y'''' = load per length + point forces (as impulses)

Integrated four times, each load gives one term ``c <x - a>^n`` that is zero before ``a``; the two constants of
integration come from the supports. Shear deformation, axial strain and large deflections are left out: for a tube of
30 in length and 2 in diameter shear adds about one percent (derived).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class Tube:
    """A round tube: ``outer_diameter``, ``inner_diameter`` [m], Young's ``modulus`` [Pa], ``density`` [kg/m^3]."""

    outer_diameter: float
    inner_diameter: float
    modulus: float
    density: float

    @property
    def second_moment(self) -> float:
        """Second moment of area about a diameter [m^4]; the polar one is twice this."""
        return math.pi / 64.0 * (self.outer_diameter**4 - self.inner_diameter**4)

    @property
    def bending_stiffness(self) -> float:
        """E I [N m^2]."""
        return self.modulus * self.second_moment

    @property
    def area(self) -> float:
        """Area of the section [m^2]."""
        return math.pi / 4.0 * (self.outer_diameter**2 - self.inner_diameter**2)

    @property
    def mass_per_length(self) -> float:
        """[kg/m]."""
        return self.density * self.area


@dataclass(frozen=True)
class PointForce:
    """A ``force`` [N] along y at a distance ``at`` [m] from the beam's start."""

    at: float
    force: float


@dataclass(frozen=True)
class _Term:
    """``factor * <x - start>^power``: zero before the start."""

    start: float
    power: int
    factor: float

    def at(self, x: float) -> float:
        return self.factor * (x - self.start) ** self.power if x >= self.start else 0.0

    def slope(self) -> _Term:
        return _Term(self.start, self.power - 1, self.factor * self.power)


@dataclass(frozen=True)
class BentBeam:
    """Bent shape of a beam, from ``on_gimbals`` or ``cantilever``."""

    terms: tuple[_Term, ...]

    def deflection(self, x: float) -> float:
        """Return y [m] at a distance x [m] from the beam's start; positive along the loads."""
        return math.fsum(term.at(x) for term in self.terms)

    def slope(self, x: float) -> float:
        """Return dy/dx [rad] at a distance x [m] from the beam's start."""
        return math.fsum(term.slope().at(x) for term in self.terms if term.power > 0)


def on_gimbals(
    length: float,
    bending_stiffness: float,
    load: float,
    forces: Sequence[PointForce],
    gimbals: tuple[float, float],
    load_slope: float = 0.0,
) -> BentBeam:
    """Return the shape of a beam on two hinged supports, measured from the line through the supports.

    This is a measuring beam on its gimbals (thesis 6.2.1), loaded by its own weight and its end plates. ``length``:
    length of the beam [m]; ``bending_stiffness``: E I [N m^2]; ``load``: uniform load per length [N/m]; ``forces``:
    point forces; ``gimbals``: distances of the two supports from the beam's start [m], the nearer first;
    ``load_slope``: increase of the load along the beam [N/m^2].
    """
    near, far = gimbals
    total = (load + 0.5 * load_slope * length) * length + math.fsum(each.force for each in forces)
    moment = load * length * (0.5 * length - near) + math.fsum(each.force * (each.at - near) for each in forces)
    moment += load_slope * length**2 * (length / 3.0 - 0.5 * near)
    at_far = moment / (far - near)
    reactions = [PointForce(near, -(total - at_far)), PointForce(far, -at_far)]
    bent = [
        _Term(0.0, 5, load_slope / 120.0 / bending_stiffness),
        _Term(0.0, 4, load / 24.0 / bending_stiffness),
        *(_Term(each.at, 3, each.force / 6.0 / bending_stiffness) for each in (*forces, *reactions)),
    ]
    at_near, at_far = (math.fsum(term.at(x) for term in bent) for x in gimbals)
    slope = -(at_far - at_near) / (far - near)
    return BentBeam((*bent, _Term(0.0, 1, slope), _Term(0.0, 0, -at_near - slope * near)))


def cantilever(
    length: float, bending_stiffness: float, load: float, tip_force: float = 0.0, tip_moment: float = 0.0
) -> BentBeam:
    """Return the shape of a beam that is clamped at its start, measured from its direction there.

    This is a structural link between two joints. ``length``: length of the beam [m]; ``bending_stiffness``: E I
    [N m^2]; ``load``: uniform load per length [N/m]; ``tip_force``: along y at the end [N]; ``tip_moment``: at the end
    [N m], positive where it makes the slope positive.
    """
    shear = -(load * length + tip_force)
    moment = 0.5 * load * length**2 + tip_force * length + tip_moment
    return BentBeam(
        (
            _Term(0.0, 4, load / 24.0 / bending_stiffness),
            _Term(0.0, 3, shear / 6.0 / bending_stiffness),
            _Term(0.0, 2, moment / 2.0 / bending_stiffness),
        )
    )
