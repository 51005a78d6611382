# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bounds of an endpoint's error: protection levels from what the faults of each joint may do to its pose unseen.

As in receiver autonomous integrity monitoring (RAIM) of satellite navigation. Along and about each axis k,

    PL_k = K sigma_k
           + max over causes |effect_k of the largest undetected fault|
           + sum over joints and causes that are always there |effect_k of the bound|
           + sum over beams |effect_k of the largest expansion| + stamp shift_k,

and infinite where a beam vibrates beyond the limit of ``chain.beam_vibration``.

K is the two-sided normal quantile of the integrity risk. The effects of a joint come with each of its poses
(``estimation.fault_effects``); one faulty cause in the whole arm is covered. Causes of one name that several joints
share add up. The sag of the beams is left out: it changes the levers by less than a thousandth.

Source: R. G. Brown, *A baseline GPS RAIM scheme and a note on the equivalence of three RAIM methods*, Navigation 39(3),
1992; RTCA DO-229 (protection levels); J. Blanch et al., *Baseline advanced RAIM user algorithm and possible
improvements*, IEEE Trans. AES 51(1), 2015 (nominal biases).
"""

from __future__ import annotations

import math
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from posor.chain.error_propagation import add_first_order
from posor.estimation.fault_model import ALWAYS, SECOND, SHARED
from posor.numerics.chi_square import upper_quantile
from posor.numerics.compiled import in_place
from posor.numerics.vector import (
    applied,
    at,
    cross,
    in_double,
    matrix,
    minus,
    plus,
    product,
    put,
    rotation_of_pose,
    square,
    transposed,
    within,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_geometry import ArmGeometry
    from posor.chain.forward_kinematics import Endpoints
    from posor.chain.joint_measurements import JointMeasurements
    from posor.estimation.fault_model import JointCauses
    from posor.numerics.array_types import FloatArray, IntArray
    from posor.numerics.vector import Matrix, Vector

INTEGRITY_RISK = 1e-5
"""Probability, of one scan and axis, that noise and calibration errors alone exceed their part of the level."""
COVERAGE_FACTOR = math.sqrt(upper_quantile(1, INTEGRITY_RISK))
"""K, 4.42: the standard uncertainties of the endpoint in a protection level."""
UNKNOWN = -1  # in place of the joint and the cause that set a level
STAMPS = "stamps"  # in place of the cause, where no fault does as much as the errors of the stamps
Shift: TypeAlias = tuple[float, float, float, float, float, float]  # ROS order
NOT_MOVED: Shift = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SMALLEST = 1e-6  # share of the largest component below which a component of an unbounded effect is rounding


class ArmCauses(NamedTuple):
    """Causes of all j joints for the kernel: K of the arm, C effects of a joint at most."""

    causes: IntArray  # of each effect of a joint, (j, C); UNKNOWN: behind its last
    kinds: IntArray  # (j, C)
    shared: IntArray  # 1 where the joints share the cause, (K,)
    totals: FloatArray  # scratch: largest effect of each cause, (K, 6)
    largest: FloatArray  # scratch: the same of the joint with the largest, (K, 6)
    joints: IntArray  # scratch: that joint, (K, 6)
    own: FloatArray  # scratch: of one joint, (K, 6)
    rotations: FloatArray  # scratch: of the joints' receiving plates, (j, 3, 3)
    positions: FloatArray  # scratch: of the joints, (j, 3) [m]

    @staticmethod
    def of(joints: Sequence[JointCauses]) -> tuple[tuple[str, ...], ArmCauses]:
        """Return the names of all causes, STAMPS behind them, and the causes of the joints of an arm."""
        names = tuple(dict.fromkeys(chain(*(each.names for each in joints))))
        most, count = max((len(each.kinds) for each in joints), default=0), len(names)
        causes, kinds = np.full((len(joints), most), UNKNOWN), np.zeros((len(joints), most), dtype=np.int64)
        for j, each in enumerate(joints):
            causes[j, : len(each.kinds)] = [names.index(each.names[cause]) for cause in each.of_effects]
            kinds[j, : len(each.kinds)] = each.kinds
        shared = np.zeros(count, dtype=np.int64)
        shared[causes[kinds & SHARED != 0]] = 1
        totals, largest, own = np.zeros((3, count, 6))
        set_by = np.zeros((count, 6), dtype=np.int64)
        places = np.zeros((len(joints), 3, 3)), np.zeros((len(joints), 3))
        return (*names, STAMPS), ArmCauses(causes, kinds, shared, totals, largest, set_by, own, *places)


class EndpointBounds(NamedTuple):
    """Protection levels of n endpoints."""

    levels: FloatArray  # along and about X, Y, Z, (n, 6) [m], [rad]; infinite: not bounded; NaN: not known, or no pose
    joints: IntArray  # joint whose fault or stamp sets each level, (n, 6), or UNKNOWN
    causes: IntArray  # cause that sets each level, among those of the arm and behind them STAMPS, (n, 6), or UNKNOWN

    @staticmethod
    def allocate(scans: int) -> EndpointBounds:
        """Return NaN, set by nothing."""
        return EndpointBounds(np.full((scans, 6), np.nan), *np.full((2, scans, 6), UNKNOWN))


@in_place
def bound_endpoints(
    arm: ArmGeometry,
    causes: ArmCauses,
    measurements: JointMeasurements,
    endpoints: Endpoints,
    axes: FloatArray,
    bounds: EndpointBounds,
) -> None:
    """Write the protection levels of endpoints.

    ``measurements``: of the joints, with fault effects and stamp shifts; ``endpoints``: covariances and stamp shifts,
    in the axes of the levels; ``axes``: rotation of these axes in the base, (3, 3).
    """
    for n in range(bounds.levels.shape[0]):
        level, known = bounds.levels[n], not math.isnan(endpoints.poses[n, 0]) and causes.kinds.shape[1] > 0
        for k in range(6):
            bounds.joints[n, k] = bounds.causes[n, k] = UNKNOWN
            level[k] = math.nan
        for j in range(causes.kinds.shape[0]):
            known = known and causes.causes[j, 0] != UNKNOWN and _are_valid(causes, measurements.fault_effects[n, j], j)
        if not known:
            continue
        for k in range(6):
            variance = endpoints.covariances_random[n, k, k] + endpoints.covariances_systematic[n, k, k]
            level[k] = COVERAGE_FACTOR * math.sqrt(max(variance, 0.0)) + endpoints.stamp_shifts[n, k]
            for c in range(causes.totals.shape[0]):
                causes.totals[c, k] = causes.largest[c, k] = 0.0
        end = _place_joints(arm, causes, measurements, n, transposed(matrix(axes, 0)), level)
        _add_faults(causes, measurements, n, end, level)
        for k in range(6):
            worst = _name_fault(causes, bounds, n, k)
            level[k] += worst
            if endpoints.stamp_shifts[n, k] > worst:
                bounds.joints[n, k] = _joint_of_stamps(causes, measurements.stamp_shifts[n], end, k)
                bounds.causes[n, k] = causes.totals.shape[0]


@in_place
def _are_valid(causes: ArmCauses, effects: FloatArray, j: int) -> bool:
    """Return whether the effects of joint j are finite, with cuts from 0 to 1 or infinite."""
    valid = True
    for i in range(effects.shape[0]):
        if causes.causes[j, i] != UNKNOWN:
            cut, total = in_double(effects[i, 6]), 0.0
            for k in range(6):
                total += abs(in_double(effects[i, k]))
            valid = valid and math.isfinite(total) and (0.0 <= cut <= 1.0 or cut == math.inf)
    return valid


@in_place
def _place_joints(
    arm: ArmGeometry, causes: ArmCauses, measurements: JointMeasurements, n: int, rotation: Matrix, level: FloatArray
) -> Vector:
    """Write where the joints are into ``causes``, and add the largest expansions of the beams; return the endpoint.

    ``rotation``: of the base in the axes of the levels, in which all is returned. An expansion does not turn a beam.
    """
    translation = (0.0, 0.0, 0.0)
    for e in range(arm.elements.shape[0]):
        element = arm.elements[e]
        translation = plus(translation, applied(rotation, at(element["translation"], 0)))
        rotation = product(rotation, matrix(element["rotation"], 0))
        j, b = element["joint"], element["beam"]
        if j >= 0:
            pose = measurements.poses[n, j]
            translation = plus(translation, applied(rotation, at(pose, 0)))
            put(causes.positions, j, 0, translation)
            for i in range(3):
                put(causes.rotations[j], i, 0, rotation[i])
            rotation = product(rotation, rotation_of_pose(pose))
        elif b >= 0:
            beam = arm.beams[b]
            shift = applied(rotation, at(beam["expansion"], 0))
            for k in range(3):
                level[k] += abs(shift[k])
            if measurements.vibrations.shape[1] > 0 and measurements.vibrations[n, b]["bounded"] == 0:
                for k in range(6):
                    level[k] = math.inf
            translation = plus(translation, applied(rotation, at(beam["translation"], 0)))
            rotation = product(rotation, matrix(beam["rotation"], 0))
    return translation


@in_place
def _add_faults(causes: ArmCauses, measurements: JointMeasurements, n: int, end: Vector, level: FloatArray) -> None:
    """Write the effects of faults into ``causes``; add those of causes that are always there to ``level``."""
    for j in range(causes.kinds.shape[0]):
        rotation, lever = matrix(causes.rotations[j], 0), minus(end, within(causes.positions, j))
        _add_joint(causes, measurements.fault_effects[n, j], j, rotation, lever, level)


@in_place
def _add_joint(
    causes: ArmCauses, effects: FloatArray, j: int, rotation: Matrix, lever: Vector, level: FloatArray
) -> None:
    """Add the effects of joint j, (C, EFFECT), whose parent has a rotation, on the endpoint a lever away."""
    own, of_effects, kinds = causes.own, causes.causes[j], causes.kinds[j]
    for c in range(own.shape[0]):
        for k in range(6):
            own[c, k] = 0.0
    i = 0
    while i < kinds.shape[0] and of_effects[i] != UNKNOWN:
        cause, cut, moved = of_effects[i], in_double(effects[i, 6]), _moved(effects, i, rotation, lever)
        other_cut, other, step = 1.0, NOT_MOVED, 1
        if i + 1 < kinds.shape[0] and kinds[i + 1] & SECOND:
            other_cut, other, step = in_double(effects[i + 1, 6]), _moved(effects, i + 1, rotation, lever), 2
        for k in range(6):
            size = _largest(moved[k], other[k], cut, other_cut, SMALLEST * _size(moved), SMALLEST * _size(other))
            if kinds[i] & ALWAYS:
                level[k] += size
            elif size > own[cause, k]:
                own[cause, k] = size
        i += step
    _add_totals(causes, j)


@in_place
def _add_totals(causes: ArmCauses, j: int) -> None:
    """Add the largest effects of the causes of joint j, ``causes.own``, to those of the arm."""
    own = causes.own
    for c in range(own.shape[0]):
        for k in range(6):
            if own[c, k] > causes.largest[c, k]:
                causes.largest[c, k], causes.joints[c, k] = own[c, k], j
            if causes.shared[c]:
                causes.totals[c, k] += own[c, k]
            elif own[c, k] > causes.totals[c, k]:
                causes.totals[c, k] = own[c, k]


@in_place
def _name_fault(causes: ArmCauses, bounds: EndpointBounds, n: int, k: int) -> float:
    """Write joint and cause of the largest effect on endpoint n along or about axis k; return the effect."""
    worst = 0.0
    for c in range(causes.totals.shape[0]):
        if causes.totals[c, k] > worst:
            worst = causes.totals[c, k]
            bounds.joints[n, k], bounds.causes[n, k] = causes.joints[c, k], c
    return worst


@in_place
def _joint_of_stamps(causes: ArmCauses, shifts: FloatArray, end: Vector, k: int) -> int:
    """Return the joint whose shift by its stamp, (j, 6), moves the endpoint most along or about axis k, first order."""
    found, most, moved = 0, 0.0, causes.own[0]
    for j in range(shifts.shape[0]):
        for i in range(6):
            moved[i] = 0.0
        add_first_order(matrix(causes.rotations[j], 0), minus(end, within(causes.positions, j)), shifts[j], moved)
        if moved[k] > most:
            found, most = j, moved[k]
    return found


@in_place
def _largest(first: float, second: float, cut: float, other_cut: float, least: float, other_least: float) -> float:
    """Return the largest effect of a hypothesis along an axis from those of its columns; the second may be zero.

    ``least``, ``other_least``: effects of unbounded columns that are rounding errors.
    """
    if not math.isinf(cut) and not math.isinf(other_cut):
        return largest_of_pair(first, second, cut, other_cut)
    bounded = 0.0
    for effect, own_cut, own_least in ((first, cut, least), (second, other_cut, other_least)):
        if not math.isinf(own_cut):
            bounded += abs(effect)
        elif abs(effect) > own_least:
            return math.inf
    return bounded


@in_place
def largest_of_pair(first: float, second: float, first_cut: float, second_cut: float) -> float:
    """Return the largest effect of a hypothesis of two parameters from the effects of its columns along one axis."""
    f, g, c, d = abs(first), abs(second), first_cut, second_cut
    if g == 0.0:
        return f
    if c == 1.0 and d == 1.0:
        return math.sqrt(f * f + g * g)
    if d > 0.0 and c * f * f + square(g / d) <= f * f + g * g / d:
        return math.sqrt(f * f + g * g / d)  # on the first ellipse, inside of the second
    if c > 0.0 and square(f / c) + d * g * g <= f * f / c + g * g:
        return math.sqrt(f * f / c + g * g)
    return (f * math.sqrt(max(1.0 - d, 0.0)) + g * math.sqrt(max(1.0 - c, 0.0))) / math.sqrt(
        1.0 - c * d
    )  # in the corner


@in_place
def _moved(effects: FloatArray, i: int, rotation: Matrix, lever: Vector) -> Shift:
    """Return shift and turn of the endpoint by effect i."""
    shift = applied(rotation, (in_double(effects[i, 0]), in_double(effects[i, 1]), in_double(effects[i, 2])))
    turn = applied(rotation, (in_double(effects[i, 3]), in_double(effects[i, 4]), in_double(effects[i, 5])))
    x, y, z = plus(shift, cross(turn, lever))
    return x, y, z, turn[0], turn[1], turn[2]


@in_place
def _size(moved: Shift) -> float:
    x, y, z, a, b, c = moved
    return abs(x) + abs(y) + abs(z) + abs(a) + abs(b) + abs(c)
