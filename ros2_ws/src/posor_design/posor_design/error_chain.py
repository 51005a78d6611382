# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors at the end of an arm: joint errors, bits of an encoder, and the stretch of links that meet in one line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor.errors import ParameterError
from scipy.optimize import brentq

from posor_design.calculators import POSITIVE, at_least, calculator, require_as_many


@dataclass(frozen=True)
class EndpointError:
    """Error at the end of an arm by errors of its joint angles."""

    worst_case: Annotated[float, "m", "All errors with one sign, the arm straight: sum of the parts."]
    root_sum_square: Annotated[float, "m", "The errors independent, as standard uncertainties."]
    parts: Annotated[tuple[float, ...], "m", "Part of each joint, first joint first."]


@calculator
def endpoint_error(
    link_lengths: Annotated[tuple[float, ...], "m", POSITIVE, at_least(1), "Length of each joint's link, base first."],
    joint_errors: Annotated[tuple[float, ...], "rad", "Error of each joint angle."],
) -> EndpointError:
    """Error at the end of a straight arm by backlash, encoders and other errors of its joint angles.

    Source: thesis 1.3, equation 1.1.
    """
    require_as_many("link_lengths", link_lengths=link_lengths, joint_errors=joint_errors)
    parts = tuple(abs(error) * math.fsum(link_lengths[joint:]) for joint, error in enumerate(joint_errors))
    return EndpointError(math.fsum(parts), math.hypot(*parts), parts)


@dataclass(frozen=True)
class PositionBits:
    """Bits that a position needs."""

    parts: Annotated[float, "1", "Travel over accuracy."]
    bits: Annotated[float, "1", "Logarithm of the parts to the base 2."]


@calculator
def position_bits(
    travel: Annotated[float, "m", POSITIVE, "Travel, such as the reach of an arm."],
    accuracy: Annotated[float, "m", POSITIVE, "Smallest step."],
) -> PositionBits:
    """Bits of a feedback signal that resolves an accuracy over a travel.

    Source: thesis 1.3.
    """
    parts = travel / accuracy
    return PositionBits(parts, math.log2(parts))


@dataclass(frozen=True)
class StraightLinkage:
    """Two links in line that sag at their joint."""

    tension: Annotated[float, "N", "Tension of each link."]
    stretch: Annotated[float, "m", "Stretch of each link."]
    angle: Annotated[float, "rad", "Angle of each link below the line through its supports."]


@calculator
def straight_linkage(
    link_length: Annotated[float, "m", POSITIVE, "Length of each link."],
    area: Annotated[float, "m^2", POSITIVE, "Area of the section of each link."],
    modulus: Annotated[float, "Pa", POSITIVE, "Young's modulus."],
    joint_force: Annotated[float, "N", POSITIVE, "Force across the line that each link carries at the joint."],
) -> StraightLinkage:
    """Tension and stretch of two links in one line, between fixed supports, by a force across their joint.

    Hinges transmit no bending moment, so the links sag until their tension carries the force.

    Source: thesis 2.4, equations 2.1 to 2.4, here without their small angles.
    """
    stiffness = area * modulus

    def excess_force(angle: float) -> float:
        return stiffness * (1.0 / math.cos(angle) - 1.0) * math.sin(angle) - joint_force

    steepest = math.pi / 3.0
    if excess_force(steepest) < 0.0:
        limit = excess_force(steepest) + joint_force
        what = f"{joint_force:g} N stretches the links to more than twice their length"
        raise ParameterError(what, where="joint_force", expected=f"less than {limit:.4g} N")
    angle = float(brentq(excess_force, 0.0, steepest, xtol=1e-15))
    strain = 1.0 / math.cos(angle) - 1.0
    return StraightLinkage(stiffness * strain, link_length * strain, angle)
