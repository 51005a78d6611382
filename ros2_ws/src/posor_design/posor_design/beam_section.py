# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sections of beams: round tubes, and boxes with walls of one thickness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from posor.chain.beam_bending import Tube
from posor.errors import ParameterError


@dataclass(frozen=True)
class BeamSection:
    """A section of a beam that bends in the plane of its height."""

    height: float  # outer height [m]
    area: float  # [m^2]
    second_moment: float  # second moment of area about the axis across the plane of bending [m^4]
    polar_moment: float  # polar second moment of area [m^4]
    torsion_constant: float  # Saint-Venant's torsion constant [m^4]
    breadth_ratio: float | None = None  # width over height between the centre lines of the walls of a box; None: a tube
    bore_ratio: float = 0.0  # inner over outer diameter of a tube

    def shear_coefficient(self, poisson: float) -> float:
        """Return Timoshenko's shear coefficient (Cowper 1966, hollow circle and thin-walled box)."""
        nu = poisson
        if self.breadth_ratio is None:
            m = self.bore_ratio**2
            ring = (1.0 + m) ** 2
            return 6.0 * (1.0 + nu) * ring / ((7.0 + 6.0 * nu) * ring + (20.0 + 12.0 * nu) * m)
        n = m = self.breadth_ratio  # m: area of the flanges over the area of the webs, n for equal walls
        webs = 12.0 + 72.0 * m + 150.0 * m**2 + 90.0 * m**3
        webs += nu * (11.0 + 66.0 * m + 135.0 * m**2 + 90.0 * m**3)
        flanges = 10.0 * n**2 * ((3.0 + nu) * m + 3.0 * m**2)
        return 10.0 * (1.0 + nu) * (1.0 + 3.0 * m) ** 2 / (webs + flanges)


def make_section(shape: Literal["tube", "box"], height: float, width: float, wall: float) -> BeamSection:
    """Return the section of a tube or a box.

    ``shape``: round tube, or box. ``height``: outer height in the plane of bending; the outer diameter of a tube [m].
    ``width``: outer width of a box; 0 for a tube [m]. ``wall``: thickness of the walls [m]. Raises ParameterError: the
    walls leave no hole, a tube has a width, or a box has none.
    """
    if (width > 0.0) != (shape == "box"):
        expected = "more than 0 for a box" if shape == "box" else "no width for a tube, or shape 'box'"
        raise ParameterError(f"{width:g} m", where="width", expected=expected)
    smaller = height if shape == "tube" else min(height, width)
    if wall >= 0.5 * smaller:
        raise ParameterError(f"{wall:g} m leaves no hole", where="wall", expected=f"less than {0.5 * smaller:g} m")
    if shape == "tube":
        tube = make_tube(height, height - 2.0 * wall, "wall")
        polar = 2.0 * tube.second_moment
        return BeamSection(height, tube.area, tube.second_moment, polar, polar, bore_ratio=tube.inner_diameter / height)
    inner_height, inner_width = height - 2.0 * wall, width - 2.0 * wall
    upright = (width * height**3 - inner_width * inner_height**3) / 12.0
    sideways = (height * width**3 - inner_height * inner_width**3) / 12.0
    h, b = height - wall, width - wall
    return BeamSection(
        height,
        area=height * width - inner_height * inner_width,
        second_moment=upright,
        polar_moment=upright + sideways,
        torsion_constant=2.0 * wall * (b * h) ** 2 / (b + h),  # Bredt
        breadth_ratio=b / h,
    )


def make_tube(outer_diameter: float, inner_diameter: float, inner_name: str) -> Tube:
    """Return the geometry of a tube; modulus and density are 1.

    ``outer_diameter``: [m]. ``inner_diameter``: [m]; 0: a solid round. ``inner_name``: name of the inner diameter, for
    errors. Raises ParameterError: the inner diameter leaves no wall.
    """
    if inner_diameter >= outer_diameter:
        expected = f"less than the outside diameter, {outer_diameter:g} m"
        raise ParameterError(f"{inner_diameter:g} m leaves no wall", where=inner_name, expected=expected)
    return Tube(outer_diameter, inner_diameter, modulus=1.0, density=1.0)
