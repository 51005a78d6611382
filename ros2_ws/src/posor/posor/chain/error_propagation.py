# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of joints and beams as errors of the endpoint: covariances, shared terms, and largest errors by stamps.

The covariance of a point is of x, y, z [m], about X, Y, Z [rad], axes of the base, the small turn applied on the base's
side at the point. It is propagated from joint to joint as ``Blocks``: position, position and turn, turn. The random
part (white from scan to scan) and the systematic part (common to all scans, with that of the beams) stay separate.
The effects of a shared term are taken out of the joints' covariances, and added over joints and beams before the sum is
squared: with A_j from a shift of joint j to one of the endpoint, e_jk the effect of term k on the joint and b_k that on
the beams, the systematic covariance is

    sum_j A_j (S_j - sum_k e_jk e_jk') A_j' + beams + sum_k (sum_j A_j e_jk + b_k) (sum_j A_j e_jk + b_k)'

Errors of the stamps have a bound: the sum of the amounts that each joint may add. A joint may be displaced by amounts t
along and p about the axes of its receiving plate. To first order they move the endpoint, at a distance l from the
joint, by t and p x l. Beyond that, the endpoint moves by at most the arc ``a = |t| + |p| |l|`` times the turn of all
joints before and half of its own, because those turn the direction of the arc; and by p times the turn of the joints
before about any axis.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    IDENTITY,
    ZERO_MATRIX,
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
    put,
    rotation_of_pose,
    times,
    transposed,
    within,
)

if TYPE_CHECKING:
    from posor.chain.arm_geometry import ArmGeometry
    from posor.numerics.array_types import FloatArray, IntArray

UpperTriangle: TypeAlias = tuple[float, float, float, float, float, float]  # of a symmetric block, row by row
Blocks: TypeAlias = tuple[UpperTriangle, Matrix, UpperTriangle]
_ZERO_TRIANGLE: UpperTriangle = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO_COVARIANCE: Blocks = (_ZERO_TRIANGLE, ZERO_MATRIX, _ZERO_TRIANGLE)


@in_place
def moved_along(blocks: Blocks, lever: Vector) -> Blocks:
    """Return the covariance of another point of the same body, ``lever`` [m] away.

    A small turn w moves that point by w x lever in addition.
    """
    position, mixed, turn = blocks
    xx, xy, xz, yy, yz, zz = position
    x, y, z = mixed
    a, b, c, d, e, f = turn
    before_x, before_y, before_z = cross(x, lever), cross(y, lever), cross(z, lever)
    by_turn = transposed((cross((a, b, c), lever), cross((b, d, e), lever), cross((c, e, f), lever)))
    x, y, z = plus(x, by_turn[0]), plus(y, by_turn[1]), plus(z, by_turn[2])
    after_x, after_y, after_z = cross(x, lever), cross(y, lever), cross(z, lever)
    position = (
        xx + (before_x[0] + after_x[0]),
        xy + (before_y[0] + after_x[1]),
        xz + (before_z[0] + after_x[2]),
        yy + (before_y[1] + after_y[1]),
        yz + (before_z[1] + after_y[2]),
        zz + (before_z[2] + after_z[2]),
    )
    return position, (x, y, z), turn


@in_place
def add_rotated(blocks: Blocks, rotation: Matrix, own: FloatArray) -> Blocks:
    """Return the sum with the covariance of one more transform.

    ``rotation`` turns the axes of ``own`` (6, 6) to those of the base. Only the upper triangle of ``own`` is read.
    """
    position, mixed, turn = blocks
    position_part = _rotated(
        rotation,
        (own[0, 0], own[0, 1], own[0, 2]),
        (own[0, 1], own[1, 1], own[1, 2]),
        (own[0, 2], own[1, 2], own[2, 2]),
    )
    x, y, z = _rotated(
        rotation,
        (own[0, 3], own[1, 3], own[2, 3]),
        (own[0, 4], own[1, 4], own[2, 4]),
        (own[0, 5], own[1, 5], own[2, 5]),
    )
    turn_part = _rotated(
        rotation,
        (own[3, 3], own[3, 4], own[3, 5]),
        (own[3, 4], own[4, 4], own[4, 5]),
        (own[3, 5], own[4, 5], own[5, 5]),
    )
    mixed = plus(mixed[0], x), plus(mixed[1], y), plus(mixed[2], z)
    return _added(position, position_part), mixed, _added(turn, turn_part)


@in_place
def _rotated(rotation: Matrix, x: Vector, y: Vector, z: Vector) -> Matrix:
    """Return ``rotation @ block @ rotation.T``; x, y, z are the columns of the block."""
    a, b, c = transposed((applied(rotation, x), applied(rotation, y), applied(rotation, z)))
    return applied(rotation, a), applied(rotation, b), applied(rotation, c)


@in_place
def _added(triangle: UpperTriangle, block: Matrix) -> UpperTriangle:
    a, b, c, d, e, f = triangle
    x, y, z = block
    return a + x[0], b + x[1], c + x[2], d + y[1], e + y[2], f + z[2]


@in_place
def add_outer_product(blocks: Blocks, sign: float, shift: Vector, turn: Vector) -> Blocks:
    """Return the sum with the covariance of one standard deviation along a shift [m] and a turn [rad], axes of base.

    ``sign``: 1, or -1 for the difference.
    """
    position, mixed, turns = blocks
    x, y, z = mixed
    a, b, c = times(sign, shift)
    return (
        _added(position, (times(a, shift), times(b, shift), times(c, shift))),
        (plus(x, times(a, turn)), plus(y, times(b, turn)), plus(z, times(c, turn))),
        _added(turns, (times(sign * turn[0], turn), times(sign * turn[1], turn), times(sign * turn[2], turn))),
    )


@in_place
def move_effects(effects: FloatArray, lever: Vector) -> None:
    """Replace effects on a point (K, 6) by those on another point of the same body, ``lever`` [m] away."""
    for k in range(effects.shape[0]):
        put(effects, k, 0, plus(within(effects, k, 0), cross(within(effects, k, 3), lever)))


@in_place
def separate_joint_terms(
    systematic: Blocks, terms: IntArray, own: FloatArray, parent: Matrix, effects: FloatArray
) -> Blocks:
    """Take the shared terms (T,) of a joint, effects ``own`` (T, 6), out of the sum; add them to ``effects`` (K, 6)."""
    for t in range(terms.shape[0]):
        k = terms[t]
        if k >= 0:
            shift, turn = applied(parent, within(own, t, 0)), applied(parent, within(own, t, 3))
            systematic = add_outer_product(systematic, -1.0, shift, turn)
            _add_effect(effects, k, shift, turn)
    return systematic


@in_place
def add_beam_terms(arm: ArmGeometry, b: int, force: Vector, parent: Matrix, effects: FloatArray) -> None:
    """Add the shared terms of a beam under a specific force [m/s^2] to ``effects`` (K, 6)."""
    for k in range(effects.shape[0]):
        own, sag = arm.beam_effects[k], arm.beam_sags[k, b]
        shift = plus(within(own, b, 0), applied(matrix(sag, 0), force))
        turn = plus(within(own, b, 3), applied(matrix(sag, 3), force))
        _add_effect(effects, k, applied(parent, shift), applied(parent, turn))


@in_place
def _add_effect(effects: FloatArray, k: int, shift: Vector, turn: Vector) -> None:
    put(effects, k, 0, plus(within(effects, k, 0), shift))
    put(effects, k, 3, plus(within(effects, k, 3), turn))


@in_place
def write_covariance(blocks: Blocks, covariance: FloatArray) -> None:
    """Write the covariance as a full matrix, (6, 6)."""
    position, mixed, turn = blocks
    put(covariance, 0, 0, (position[0], position[1], position[2]))
    covariance[1, 1], covariance[1, 2], covariance[2, 2] = position[3], position[4], position[5]
    put(covariance, 3, 3, (turn[0], turn[1], turn[2]))
    covariance[4, 4], covariance[4, 5], covariance[5, 5] = turn[3], turn[4], turn[5]
    put(covariance, 0, 3, mixed[0])
    put(covariance, 1, 3, mixed[1])
    put(covariance, 2, 3, mixed[2])
    for i in range(1, 6):
        for j in range(i):
            covariance[i, j] = covariance[j, i]


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
            turned = _add_joint_shift(rotation, minus(end, translation), shifts[j], turned, bound)
            rotation = product(rotation, rotation_of_pose(poses[j]))
        elif b >= 0:
            translation = plus(translation, applied(rotation, within(beams, b)))
            rotation = product(rotation, rotation_of_pose(beams[b]))


@in_place
def add_first_order(parent: Matrix, lever: Vector, shifts: FloatArray, bound: FloatArray) -> None:
    """Add the largest shifts and turns of an endpoint, a lever away, by those of a joint, (6,), axes of ``parent``."""
    axes = transposed(parent)
    for k in range(3):
        add_amounts(bound, 0, axes[k], shifts[k])
        add_amounts(bound, 0, cross(axes[k], lever), shifts[3 + k])
        add_amounts(bound, 3, axes[k], shifts[3 + k])


@in_place
def _add_joint_shift(parent: Matrix, lever: Vector, shifts: FloatArray, turned: float, bound: FloatArray) -> float:
    """Add what a joint may add; return the turn ``turned`` [rad] of the joints before, with that of this joint."""
    add_first_order(parent, lever, shifts, bound)
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


@in_place
def add_amounts(bound: FloatArray, first: int, effect: Vector, shift: float) -> None:
    """Add the amounts of a shift times its effect; an infinite shift without effect adds nothing."""
    for i in range(3):
        if effect[i] != 0.0:
            bound[first + i] += abs(effect[i]) * shift
