# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Largest error of the endpoint by errors of the joints' stamps: the sum of the amounts that each joint may add.

A joint may be displaced by amounts t along and p about the axes of its receiving plate. To first order they move the
endpoint, at a distance l from the joint, by t and p x l. Beyond that, the endpoint moves by at most the arc
``a = |t| + |p| |l|`` times the turn of all joints before and half of its own, because those turn the direction of the
arc; and by p times the turn of the joints before about any axis.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import (
    IDENTITY,
    Matrix,
    Vector,
    applied,
    at,
    cross,
    dot,
    matrix,
    minus,
    plus,
    product,
    rotation_of_pose,
    transposed,
    within,
)

if TYPE_CHECKING:
    from posor.chain.arm_geometry import ArmGeometry
    from posor.numerics.array_types import FloatArray


@in_place
def bound_stamp_shift(
    arm: ArmGeometry, beams: FloatArray, poses: FloatArray, shifts: FloatArray, end: Vector, bound: FloatArray
) -> None:
    """Write the largest error of an endpoint along and about each axis of the base into ``bound``, (6,) [m], [rad].

    ``beams``: plates at the beams' ends in the plates at their starts, (b, 7); ``poses``: of the joints, (j, 7);
    ``shifts``: their largest errors by errors of their stamps, (j, 6); ``end``: the endpoint [m], axes of the base.
    """
    stated = False
    for k in range(6):
        bound[k] = 0.0
        for j in range(shifts.shape[0]):
            stated |= shifts[j, k] > 0.0
    if not stated:
        return
    rotation, translation, turned = IDENTITY, (0.0, 0.0, 0.0), 0.0
    for n in range(arm.elements.shape[0]):
        element = arm.elements[n]
        translation = plus(translation, applied(rotation, at(element["translation"], 0)))
        rotation = product(rotation, matrix(element["rotation"], 0))
        j, b = element["joint"], element["beam"]
        if j >= 0:
            translation = plus(translation, applied(rotation, within(poses, j)))
            turned = _add_joint(rotation, minus(end, translation), shifts[j], turned, bound)
            rotation = product(rotation, rotation_of_pose(poses[j]))
        elif b >= 0:
            translation = plus(translation, applied(rotation, within(beams, b)))
            rotation = product(rotation, rotation_of_pose(beams[b]))


@inlined
def _add_joint(parent: Matrix, lever: Vector, shifts: FloatArray, turned: float, bound: FloatArray) -> float:
    """Add what a joint may add; return the turn ``turned`` [rad] of the joints before, with that of this joint."""
    axes = transposed(parent)
    for k in range(3):
        add_amounts(bound, 0, axes[k], shifts[k])
        add_amounts(bound, 0, cross(axes[k], lever), shifts[3 + k])
        add_amounts(bound, 3, axes[k], shifts[3 + k])
    shift, turn = at(shifts, 0), at(shifts, 3)
    angle = math.sqrt(dot(turn, turn))
    arc = math.sqrt(dot(shift, shift))
    if angle > 0.0:
        arc += angle * math.sqrt(dot(lever, lever))
    turning = turned + 0.5 * angle
    for k in range(3):
        if arc > 0.0 and turning > 0.0:
            bound[k] += arc * turning
        if angle > 0.0 and turned > 0.0:
            bound[3 + k] += angle * turned
    return turned + angle


@inlined
def add_amounts(bound: FloatArray, first: int, effect: Vector, shift: float) -> None:
    """Add the amounts of a shift times its effect; an infinite shift without effect adds nothing."""
    for i in range(3):
        if effect[i] != 0.0:
            bound[first + i] += abs(effect[i]) * shift
