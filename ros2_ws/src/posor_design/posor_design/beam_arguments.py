"""Arguments that calculators of beams share: the beam, its plates and its gimbals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from posor.errors import ParameterError

from posor_design.beam_section import make_section
from posor_design.beam_vibration import Attachment, UniformBeam
from posor_design.checks import require_non_negative, require_poisson_ratio, require_positive

if TYPE_CHECKING:
    from collections.abc import Sequence

MOST_MODES = 20
"""Largest number of modes; beam theory fails for higher ones, whose waves are shorter than usual sections are high."""


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
        ParameterError: An argument is not finite or out of its range.

    """
    require_positive(length=length, modulus=modulus, density=density)
    require_poisson_ratio(poisson_ratio=poisson_ratio)
    section = make_section(shape, height, width, wall)
    return UniformBeam.from_section(length, section, modulus, density, poisson_ratio)


def check_modes(modes: int) -> None:
    """Check a number of modes.

    Raises:
        ParameterError: There are fewer than 1 or more than ``MOST_MODES``.

    """
    if not 1 <= modes <= MOST_MODES:
        raise ParameterError(f"{modes} modes", where="modes", expected=f"1 to {MOST_MODES}")


def check_plates_and_gimbals(length: float, gimbals: tuple[float, float], plate_masses: tuple[float, float]) -> None:
    """Check the masses at the ends and the places of the gimbals.

    Raises:
        ParameterError: A mass is negative or not finite, or the gimbals are not two increasing distances on the beam.

    """
    for mass in plate_masses:
        require_non_negative(plate_masses=mass)
    near, far = gimbals
    if not 0.0 <= near < far <= length:
        raise ParameterError(
            f"{near:g} m and {far:g} m", where="gimbals", expected=f"two increasing distances from 0 to {length:g} m"
        )


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
        ParameterError: An argument is not finite or out of its range, or a stiffness is stated for one gimbal only.

    """
    check_plates_and_gimbals(length, gimbals, plate_masses)
    for inertia in plate_inertias:
        require_non_negative(plate_inertias=inertia)
    stiffness = _of_both_gimbals(gimbal_stiffness, "gimbal_stiffness", math.inf)
    turning = _of_both_gimbals(gimbal_turning_stiffness, "gimbal_turning_stiffness", 0.0)
    plates = zip((0.0, length), plate_masses, plate_inertias, strict=True)
    supports = zip(gimbals, stiffness, turning, strict=True)
    return [
        *(Attachment(at, mass=mass, inertia=inertia) for at, mass, inertia in plates),
        *(Attachment(at, stiffness=held, turning_stiffness=turn) for at, held, turn in supports),
    ]


def _of_both_gimbals(values: Sequence[float], name: str, left_out: float) -> Sequence[float]:
    if not values:
        return (left_out, left_out)
    if len(values) != 2:  # noqa: PLR2004
        raise ParameterError(f"{len(values)} values", where=name, expected="a value for each of the two gimbals")
    for value in values:
        require_positive(**{name: value})
    return values
