"""Bounds of an endpoint's error: protection levels from what the faults of each joint may do to its pose unseen.

As in receiver autonomous integrity monitoring (RAIM) of satellite navigation. Along and about each axis k,

    PL_k = K sigma_k
           + max over causes |effect_k of the largest undetected fault|
           + sum over joints and causes that are always there |effect_k of the bound|
           + sum over beams |effect_k of the largest expansion| + stamp shift_k.

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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.estimation.fault_effects import in_double, largest_of_pair
from posor.estimation.fault_hypotheses import ALWAYS, SECOND, SHARED
from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import applied, at, cross, matrix, minus, plus, product, rotation_of_pose, transposed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_geometry import ArmGeometry
    from posor.chain.forward_kinematics import Endpoints
    from posor.chain.joint_measurements import JointMeasurements
    from posor.estimation.fault_hypotheses import JointCauses
    from posor.numerics.array_types import FloatArray, IntArray
    from posor.numerics.vector import Matrix, Vector

INTEGRITY_RISK = 1e-5
"""Probability, of one scan and axis, that noise and calibration errors alone exceed their part of the level."""
COVERAGE_FACTOR = 4.417173413469022
"""K: the standard uncertainties of the endpoint in a protection level, two-sided normal quantile of the risk."""
UNKNOWN = -1  # in place of the joint and the cause that set a level
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

    @staticmethod
    def of(joints: Sequence[JointCauses]) -> tuple[tuple[str, ...], ArmCauses]:
        """Return the names of all causes, and the causes of the joints of an arm."""
        names = tuple(dict.fromkeys(chain(*(each.names for each in joints))))
        most, count = max((len(each.kinds) for each in joints), default=0), len(names)
        causes, kinds = np.full((len(joints), most), UNKNOWN), np.zeros((len(joints), most), dtype=np.int64)
        for j, each in enumerate(joints):
            causes[j, : len(each.kinds)] = [names.index(each.names[cause]) for cause in each.of_effects]
            kinds[j, : len(each.kinds)] = each.kinds
        shared = np.zeros(count, dtype=np.int64)
        shared[causes[kinds & SHARED != 0]] = 1
        totals, largest, own = np.zeros((3, count, 6))
        return names, ArmCauses(causes, kinds, shared, totals, largest, np.zeros((count, 6), dtype=np.int64), own)


class EndpointBounds(NamedTuple):
    """Protection levels of n endpoints."""

    levels: FloatArray  # along and about X, Y, Z, (n, 6) [m], [rad]; infinite: not bounded; NaN: not known, or no pose
    joints: IntArray  # joint whose fault sets each level, (n, 6), or UNKNOWN
    causes: IntArray  # cause that sets each level, among those of the arm, (n, 6), or UNKNOWN

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

    ``measurements``: of the joints, with the fault effects; ``endpoints``: covariances and stamp shifts, in the axes of
    the levels; ``axes``: rotation of these axes in the base, (3, 3).
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
        rotation = transposed(matrix(axes, 0))
        end = _add_expansions(arm, measurements, n, rotation, level)
        _add_faults(arm, causes, measurements, n, rotation, end, level)
        for k in range(6):
            worst = 0.0
            for c in range(causes.totals.shape[0]):
                if causes.totals[c, k] > worst:
                    worst = causes.totals[c, k]
                    bounds.joints[n, k], bounds.causes[n, k] = causes.joints[c, k], c
            level[k] += worst


@inlined
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


@inlined
def _add_expansions(
    arm: ArmGeometry, measurements: JointMeasurements, n: int, rotation: Matrix, level: FloatArray
) -> Vector:
    """Add the amounts by which expansions of the beams may move the endpoint, which they do not turn; return it.

    ``rotation``: of the base in the axes of the levels, in which the endpoint is returned.
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
            rotation = product(rotation, rotation_of_pose(pose))
        elif b >= 0:
            beam = arm.beams[b]
            shift = applied(rotation, at(beam["expansion"], 0))
            for k in range(3):
                level[k] += abs(shift[k])
            translation = plus(translation, applied(rotation, at(beam["translation"], 0)))
            rotation = product(rotation, matrix(beam["rotation"], 0))
    return translation


@inlined
def _add_faults(
    arm: ArmGeometry,
    causes: ArmCauses,
    measurements: JointMeasurements,
    n: int,
    rotation: Matrix,
    end: Vector,
    level: FloatArray,
) -> None:
    """Write the effects of faults into ``causes``; add those of causes that are always there to ``level``.

    ``rotation``: of the base in the axes of the levels, ``end``: the endpoint in them.
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
            _add_joint(causes, measurements.fault_effects[n, j], j, rotation, minus(end, translation), level)
            rotation = product(rotation, rotation_of_pose(pose))
        elif b >= 0:
            beam = arm.beams[b]
            translation = plus(translation, applied(rotation, at(beam["translation"], 0)))
            rotation = product(rotation, matrix(beam["rotation"], 0))


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
        cause, cut, paired = of_effects[i], in_double(effects[i, 6]), i + 1 < kinds.shape[0] and kinds[i + 1] & SECOND
        shift, turn = _moved(effects, i, rotation, lever)
        next_shift, next_turn, next_cut = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0
        if paired:
            next_shift, next_turn = _moved(effects, i + 1, rotation, lever)
            next_cut = in_double(effects[i + 1, 6])
        least = SMALLEST * (_size(shift) + _size(turn))
        next_least = SMALLEST * (_size(next_shift) + _size(next_turn))
        for k in range(6):
            first = shift[k] if k < 3 else turn[k - 3]
            second = next_shift[k] if k < 3 else next_turn[k - 3]
            if cut == math.inf:
                first = math.inf if abs(first) > least else 0.0
            if next_cut == math.inf:
                second = math.inf if abs(second) > next_least else 0.0
            if first == math.inf or second == math.inf:
                size = math.inf
            elif not paired or cut == math.inf or next_cut == math.inf:
                size = abs(first) + abs(second)  # one of them is zero
            else:
                size = largest_of_pair(first, second, cut, next_cut)
            if kinds[i] & ALWAYS:
                level[k] += size
            elif size > own[cause, k]:
                own[cause, k] = size
        i += 2 if paired else 1
    for c in range(own.shape[0]):
        for k in range(6):
            if own[c, k] > causes.largest[c, k]:
                causes.largest[c, k], causes.joints[c, k] = own[c, k], j
            if causes.shared[c]:
                causes.totals[c, k] += own[c, k]
            elif own[c, k] > causes.totals[c, k]:
                causes.totals[c, k] = own[c, k]


@inlined
def _moved(effects: FloatArray, i: int, rotation: Matrix, lever: Vector) -> tuple[Vector, Vector]:
    """Return shift and turn of the endpoint by effect i."""
    shift = applied(rotation, (in_double(effects[i, 0]), in_double(effects[i, 1]), in_double(effects[i, 2])))
    turn = applied(rotation, (in_double(effects[i, 3]), in_double(effects[i, 4]), in_double(effects[i, 5])))
    return plus(shift, cross(turn, lever)), turn


@inlined
def _size(v: Vector) -> float:
    return abs(v[0]) + abs(v[1]) + abs(v[2])
