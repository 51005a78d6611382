"""Loads of an arm's joints: moments, bearings, gears, and chains that pistons drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import ParameterError

from posor_design.checks import require_finite, require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import Metre, Newton, NewtonMetre, Number, Pascal, Radian, SquareMetre


@dataclass(frozen=True)
class JointMoment:
    """Load of a joint.

    Attributes:
        force: Sum of the forces.
        moment: Sum of their moments about the joint.

    """

    force: Newton
    moment: NewtonMetre


def joint_moment(distances: tuple[Metre, ...], forces: tuple[Newton, ...]) -> JointMoment:
    """Force and moment at a joint by parallel forces beyond it, such as weights and the payload.

    Args:
        distances: Distances of the forces from the joint, positive away from the base.
        forces: Forces.

    Raises:
        ParameterError: There is no force, there are not as many distances, or a number is not finite.

    Source: thesis 9.4.1 to 9.4.4.

    Example:
        posor design joint-moment --distances '26, 9 in' --forces '200, 50 lbf'

    """
    if not forces or len(forces) != len(distances):
        raise ParameterError(
            f"{len(forces)} forces for {len(distances)} distances", where="forces", expected="a force for each distance"
        )
    for distance, force in zip(distances, forces, strict=True):
        require_finite(distances=distance, forces=force)
    moment = sum(distance * force for distance, force in zip(distances, forces, strict=True))
    return JointMoment(sum(forces), moment)


@dataclass(frozen=True)
class BearingPair:
    """Load of two bearings.

    Attributes:
        radial_force: Radial force on each.

    """

    radial_force: Newton


def bearing_pair(moment: NewtonMetre, spacing: Metre) -> BearingPair:
    """Radial force on each of two bearings that take up a moment.

    Args:
        moment: Moment across the axis of the bearings.
        spacing: Distance between the bearings along their axis.

    Raises:
        ParameterError: An argument is not finite, the moment is negative, or the spacing is not positive.

    Source: thesis 9.4.1.

    Example:
        posor design bearing-pair --moment '3200 lbf in' --spacing '5 in'

    """
    require_non_negative(moment=moment)
    require_positive(spacing=spacing)
    return BearingPair(moment / spacing)


@dataclass(frozen=True)
class GearDrive:
    """A joint driven by a gear.

    Attributes:
        ratio: Turns of the pinion for a turn of the gear.
        pinion_torque: Torque that the motor has to supply.
        tooth_force: Tangential force between pinion and gear.

    """

    ratio: Number
    pinion_torque: NewtonMetre
    tooth_force: Newton


def gear_drive(moment: NewtonMetre, pinion_diameter: Metre, gear_diameter: Metre) -> GearDrive:
    """Ratio, torque and tooth force of a pinion and a gear that hold a moment, without losses.

    Args:
        moment: Moment at the gear.
        pinion_diameter: Pitch diameter of the pinion.
        gear_diameter: Pitch diameter of the gear.

    Raises:
        ParameterError: An argument is not finite, the moment is negative, or a diameter is not positive.

    Source: thesis 9.4.2 to 9.4.4.

    Example:
        posor design gear-drive --moment '12200 lbf in' --pinion-diameter '3.5 in' --gear-diameter '10.5 in'

    """
    require_non_negative(moment=moment)
    require_positive(pinion_diameter=pinion_diameter, gear_diameter=gear_diameter)
    ratio = gear_diameter / pinion_diameter
    return GearDrive(ratio, moment / ratio, 2.0 * moment / gear_diameter)


@dataclass(frozen=True)
class ChainDrive:
    """A joint driven by a chain between two pistons.

    Attributes:
        pressure: Pressure on the piston that pulls.
        travel: Largest angle between the two ends of the stroke.

    """

    pressure: Pascal
    travel: Radian


def chain_drive(moment: NewtonMetre, sprocket_diameter: Metre, piston_area: SquareMetre, stroke: Metre) -> ChainDrive:
    """Pressure and travel of a sprocket whose chain two pistons pull in turn, without losses.

    Args:
        moment: Moment at the sprocket.
        sprocket_diameter: Pitch diameter of the sprocket.
        piston_area: Effective area of a piston.
        stroke: Stroke of a piston.

    Raises:
        ParameterError: An argument is not finite, the moment is negative, or another argument is not positive.

    Source: thesis 9.4.1.

    Example:
        posor design chain-drive --moment '3200 lbf in' --sprocket-diameter '4 in' --piston-area '1 in^2'
        --stroke '8 in'

    """
    require_non_negative(moment=moment)
    require_positive(sprocket_diameter=sprocket_diameter, piston_area=piston_area, stroke=stroke)
    radius = 0.5 * sprocket_diameter
    return ChainDrive(moment / radius / piston_area, stroke / radius)
