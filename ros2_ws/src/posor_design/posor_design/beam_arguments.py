"""Beams, their plates and their gimbals, from the arguments that calculators of beams share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from posor.errors import ParameterError

from posor_design.beam_section import make_section
from posor_design.beam_vibration import Attachment, UniformBeam

if TYPE_CHECKING:
    from collections.abc import Sequence


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

    Raises:
        ParameterError: The walls leave no hole, or the width does not suit the shape.

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


def check_gimbals(length: float, gimbals: tuple[float, float]) -> None:
    """Check the places of the gimbals.

    Raises:
        ParameterError: The gimbals are not two increasing distances on the beam.

    """
    near, far = gimbals
    if not near < far <= length:
        expected = f"two increasing distances from 0 to {length:g} m"
        raise ParameterError(f"{near:g} m and {far:g} m", where="gimbals", expected=expected)


def make_attachments(
    length: float,
    gimbals: tuple[float, float],
    plate_masses: tuple[float, float],
    plate_inertias: tuple[float, float],
    gimbal_stiffness: Sequence[float],
    gimbal_turning_stiffness: Sequence[float],
) -> list[Attachment]:
    """Return plates and gimbals.

    Raises:
        ParameterError: The gimbals are not two increasing distances on the beam.

    """
    check_gimbals(length, gimbals)
    plates = zip((0.0, length), plate_masses, plate_inertias, strict=True)
    stiffness, turning = gimbal_stiffness or (math.inf, math.inf), gimbal_turning_stiffness or (0.0, 0.0)
    supports = zip(gimbals, stiffness, turning, strict=True)
    return [
        *(Attachment(at, mass=mass, inertia=inertia) for at, mass, inertia in plates),
        *(Attachment(at, stiffness=held, turning_stiffness=turn) for at, held, turn in supports),
    ]
