# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Loads of an arm's joints: moments, bearings, gears, and chains that pistons drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from posor_design.calculators import NON_NEGATIVE, POSITIVE, at_least, calculator, require_as_many


@dataclass(frozen=True)
class JointMoment:
    """Load of a joint."""

    force: Annotated[float, "N", "Sum of the forces."]
    moment: Annotated[float, "N m", "Sum of their moments about the joint."]


@calculator
def joint_moment(
    distances: Annotated[tuple[float, ...], "m", at_least(1), "Distances from the joint, positive away from the base."],
    forces: Annotated[tuple[float, ...], "N", "Forces."],
) -> JointMoment:
    """Force and moment at a joint by parallel forces beyond it, such as weights and the payload.

    Source: thesis 9.4.1 to 9.4.4.
    """
    require_as_many("distances", distances=distances, forces=forces)
    moment = sum(distance * force for distance, force in zip(distances, forces, strict=True))
    return JointMoment(sum(forces), moment)


@dataclass(frozen=True)
class BearingPair:
    """Load of two bearings."""

    radial_force: Annotated[float, "N", "Radial force on each."]


@calculator
def bearing_pair(
    moment: Annotated[float, "N m", NON_NEGATIVE, "Moment across the axis of the bearings."],
    spacing: Annotated[float, "m", POSITIVE, "Distance between the bearings along their axis."],
) -> BearingPair:
    """Radial force on each of two bearings that take up a moment.

    Source: thesis 9.4.1.
    """
    return BearingPair(moment / spacing)


@dataclass(frozen=True)
class GearDrive:
    """A joint driven by a gear."""

    ratio: Annotated[float, "1", "Turns of the pinion for a turn of the gear."]
    pinion_torque: Annotated[float, "N m", "Torque that the motor has to supply."]
    tooth_force: Annotated[float, "N", "Tangential force between pinion and gear."]


@calculator
def gear_drive(
    moment: Annotated[float, "N m", NON_NEGATIVE, "Moment at the gear."],
    pinion_diameter: Annotated[float, "m", POSITIVE, "Pitch diameter of the pinion."],
    gear_diameter: Annotated[float, "m", POSITIVE, "Pitch diameter of the gear."],
) -> GearDrive:
    """Ratio, torque and tooth force of a pinion and a gear that hold a moment, without losses.

    Source: thesis 9.4.2 to 9.4.4.
    """
    ratio = gear_diameter / pinion_diameter
    return GearDrive(ratio, moment / ratio, 2.0 * moment / gear_diameter)


@dataclass(frozen=True)
class ChainDrive:
    """A joint driven by a chain between two pistons."""

    pressure: Annotated[float, "Pa", "Pressure on the piston that pulls."]
    travel: Annotated[float, "rad", "Largest angle between the two ends of the stroke."]


@calculator
def chain_drive(
    moment: Annotated[float, "N m", NON_NEGATIVE, "Moment at the sprocket."],
    sprocket_diameter: Annotated[float, "m", POSITIVE, "Pitch diameter of the sprocket."],
    piston_area: Annotated[float, "m^2", POSITIVE, "Effective area of a piston."],
    stroke: Annotated[float, "m", POSITIVE, "Stroke of a piston."],
) -> ChainDrive:
    """Pressure and travel of a sprocket whose chain two pistons pull in turn, without losses.

    Source: thesis 9.4.1.
    """
    radius = 0.5 * sprocket_diameter
    return ChainDrive(moment / radius / piston_area, stroke / radius)
