"""Errors at the end of an arm: joint errors, bits of an encoder, and the stretch of links that meet in one line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from scipy.optimize import brentq

from posor_design.checks import require_finite, require_positive

if TYPE_CHECKING:
    from posor_design.units import Metre, Newton, Number, Pascal, Radian, SquareMetre


@dataclass(frozen=True)
class EndpointError:
    """Error at the end of an arm by errors of its joint angles.

    Attributes:
        worst_case: All errors with one sign, the arm straight: sum of the parts.
        root_sum_square: The errors independent, as standard uncertainties.
        parts: Part of each joint, first joint first.

    """

    worst_case: Metre
    root_sum_square: Metre
    parts: tuple[Metre, ...]


def endpoint_error(link_lengths: tuple[Metre, ...], joint_errors: tuple[Radian, ...]) -> EndpointError:
    """Error at the end of a straight arm by backlash, encoders and other errors of its joint angles.

    Args:
        link_lengths: Length of the link after each joint, base first.
        joint_errors: Error of each joint angle.

    Raises:
        ParameterError: There is no joint, there are not as many errors as links, or a number is not finite or negative.

    Source: thesis 1.3, equation 1.1.

    Example:
        posor design endpoint-error --link-lengths '30, 30 in' --joint-errors '15, 15 arcsec'

    """
    if not link_lengths or len(joint_errors) != len(link_lengths):
        raise ParameterError(
            f"{len(joint_errors)} errors for {len(link_lengths)} links",
            where="joint_errors",
            expected="an error for each link",
        )
    for length, error in zip(link_lengths, joint_errors, strict=True):
        require_positive(link_lengths=length)
        require_finite(joint_errors=error)
    parts = tuple(abs(error) * math.fsum(link_lengths[joint:]) for joint, error in enumerate(joint_errors))
    return EndpointError(math.fsum(parts), math.hypot(*parts), parts)


@dataclass(frozen=True)
class PositionBits:
    """Bits that a position needs.

    Attributes:
        parts: Travel over accuracy.
        bits: Logarithm of the parts to the base 2.

    """

    parts: Number
    bits: Number


def position_bits(travel: Metre, accuracy: Metre) -> PositionBits:
    """Bits of a feedback signal that resolves an accuracy over a travel.

    Args:
        travel: Travel, such as the reach of an arm.
        accuracy: Smallest step.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 1.3.

    Example:
        posor design position-bits --travel '60 in' --accuracy '1 mil'

    """
    require_positive(travel=travel, accuracy=accuracy)
    parts = travel / accuracy
    return PositionBits(parts, math.log2(parts))


@dataclass(frozen=True)
class StraightLinkage:
    """Two links in line that sag at their joint.

    Attributes:
        tension: Tension of each link.
        stretch: Stretch of each link.
        angle: Angle of each link below the line through its supports.

    """

    tension: Newton
    stretch: Metre
    angle: Radian


def straight_linkage(link_length: Metre, area: SquareMetre, modulus: Pascal, joint_force: Newton) -> StraightLinkage:
    """Tension and stretch of two links in one line, between fixed supports, by a force across their joint.

    Hinges transmit no bending moment, so the links sag until their tension carries the force.

    Args:
        link_length: Length of each link.
        area: Area of the section of each link.
        modulus: Young's modulus.
        joint_force: Force across the line that each link carries at the joint.

    Raises:
        ParameterError: An argument is not finite or not positive, or the links would have to stand upright.

    Source: thesis 2.4, equations 2.1 to 2.4, here without their small angles.

    Example:
        posor design straight-linkage --link-length '30 in' --area '.7363 in^2' --modulus '29e6 psi'
        --joint-force '7.625 lbf'

    """
    require_positive(link_length=link_length, area=area, modulus=modulus, joint_force=joint_force)
    stiffness = area * modulus

    def excess_force(angle: float) -> float:
        return stiffness * (1.0 / math.cos(angle) - 1.0) * math.sin(angle) - joint_force

    steepest = math.pi / 3.0
    if excess_force(steepest) < 0.0:
        limit = excess_force(steepest) + joint_force
        raise ParameterError(
            f"{joint_force:g} N stretches the links to more than twice their length",
            where="joint_force",
            expected=f"less than {limit:.4g} N",
        )
    angle = float(brentq(excess_force, 0.0, steepest, xtol=1e-15))
    strain = 1.0 / math.cos(angle) - 1.0
    return StraightLinkage(stiffness * strain, link_length * strain, angle)
