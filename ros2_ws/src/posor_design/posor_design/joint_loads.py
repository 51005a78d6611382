"""Loads of an arm's joints: moments, bearings, gears, and chains that pistons drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from posor_design.calculators import calculator, require_as_many

if TYPE_CHECKING:
    from posor_design.units import (
        NON_NEGATIVE,
        POSITIVE,
        Metre,
        Newton,
        NewtonMetre,
        Number,
        Pascal,
        Radian,
        SquareMetre,
        at_least,
    )


@dataclass(frozen=True)
class JointMoment:
    """Load of a joint."""

    force: Annotated[Newton, "Sum of the forces."]
    moment: Annotated[NewtonMetre, "Sum of their moments about the joint."]


@calculator
def joint_moment(
    distances: Annotated[
        tuple[Metre, ...], at_least(1), "Distances of the forces from the joint, positive away from the base."
    ],
    forces: Annotated[tuple[Newton, ...], "Forces."],
) -> JointMoment:
    """Force and moment at a joint by parallel forces beyond it, such as weights and the payload.

    Source: thesis 9.4.1 to 9.4.4.

    Example:
        posor design joint-moment --distances '26, 9 in' --forces '200, 50 lbf'

    """
    require_as_many("distances", distances=distances, forces=forces)
    moment = sum(distance * force for distance, force in zip(distances, forces, strict=True))
    return JointMoment(sum(forces), moment)


@dataclass(frozen=True)
class BearingPair:
    """Load of two bearings."""

    radial_force: Annotated[Newton, "Radial force on each."]


@calculator
def bearing_pair(
    moment: Annotated[NewtonMetre, NON_NEGATIVE, "Moment across the axis of the bearings."],
    spacing: Annotated[Metre, POSITIVE, "Distance between the bearings along their axis."],
) -> BearingPair:
    """Radial force on each of two bearings that take up a moment.

    Source: thesis 9.4.1.

    Example:
        posor design bearing-pair --moment '3200 lbf in' --spacing '5 in'

    """
    return BearingPair(moment / spacing)


@dataclass(frozen=True)
class GearDrive:
    """A joint driven by a gear."""

    ratio: Annotated[Number, "Turns of the pinion for a turn of the gear."]
    pinion_torque: Annotated[NewtonMetre, "Torque that the motor has to supply."]
    tooth_force: Annotated[Newton, "Tangential force between pinion and gear."]


@calculator
def gear_drive(
    moment: Annotated[NewtonMetre, NON_NEGATIVE, "Moment at the gear."],
    pinion_diameter: Annotated[Metre, POSITIVE, "Pitch diameter of the pinion."],
    gear_diameter: Annotated[Metre, POSITIVE, "Pitch diameter of the gear."],
) -> GearDrive:
    """Ratio, torque and tooth force of a pinion and a gear that hold a moment, without losses.

    Source: thesis 9.4.2 to 9.4.4.

    Example:
        posor design gear-drive --moment '12200 lbf in' --pinion-diameter '3.5 in' --gear-diameter '10.5 in'

    """
    ratio = gear_diameter / pinion_diameter
    return GearDrive(ratio, moment / ratio, 2.0 * moment / gear_diameter)


@dataclass(frozen=True)
class ChainDrive:
    """A joint driven by a chain between two pistons."""

    pressure: Annotated[Pascal, "Pressure on the piston that pulls."]
    travel: Annotated[Radian, "Largest angle between the two ends of the stroke."]


@calculator
def chain_drive(
    moment: Annotated[NewtonMetre, NON_NEGATIVE, "Moment at the sprocket."],
    sprocket_diameter: Annotated[Metre, POSITIVE, "Pitch diameter of the sprocket."],
    piston_area: Annotated[SquareMetre, POSITIVE, "Effective area of a piston."],
    stroke: Annotated[Metre, POSITIVE, "Stroke of a piston."],
) -> ChainDrive:
    """Pressure and travel of a sprocket whose chain two pistons pull in turn, without losses.

    Source: thesis 9.4.1.

    Example:
        posor design chain-drive --moment '3200 lbf in' --sprocket-diameter '4 in' --piston-area '1 in^2'
        --stroke '8 in'

    """
    radius = 0.5 * sprocket_diameter
    return ChainDrive(moment / radius / piston_area, stroke / radius)
