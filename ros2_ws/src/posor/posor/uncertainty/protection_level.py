# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Protection levels of poses of one joint and of an arm's endpoint, offline: the bounds that ``chain_node`` publishes.

The definition is that of ``chain.fault_bounds``. An undetected fault of one cause leaves the error within the level
except with at most the integrity risk. A fault beyond its minimal detectable size passes a scan with at most the
probability of a missed detection.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.chain.arm_geometry import BEAM, ELEMENT, NO_INDEX, ArmGeometry
from posor.chain.endpoint_estimator import EndpointEstimator
from posor.chain.forward_kinematics import Endpoints
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import model_covariances, scan_at
from posor.uncertainty.reliability import joint_reliability

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.fault_bounds import EndpointBounds
    from posor.chain.kinematic_chain import Chain
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.reliability import Reliability

_NO_FORCE = np.zeros(3)


def joint_protection_levels(posor: Posor, estimates: Estimates) -> EndpointBounds:
    """Return the protection levels of the poses of one joint, along and about the axes of the receiving plate.

    Args:
        posor: The estimator of the estimates.
        estimates: Its estimates with ``fault_effects``.

    Returns:
        The levels; ``causes`` index ``posor.hypotheses.causes``; behind their last: errors of the stamps.

    Raises:
        ParameterError: The estimates have no fault effects.

    """
    if estimates.fault_effects.shape[1] == 0:
        what = "the estimates have no fault effects"
        raise ParameterError(what, where="joint_protection_levels", expected="estimate_all(..., fault_effects=True)")
    elements = [(index, NO_INDEX, np.eye(3), np.zeros(3)) for index in (0, NO_INDEX)]
    terms = np.zeros((1, 0), dtype=np.int64), np.zeros((0, 0, 6)), np.zeros((0, 0, 6, 3))
    geometry = ArmGeometry(
        np.array(elements, ELEMENT), np.zeros(0, BEAM), np.eye(3)[None], np.zeros((1, 3)), _NO_FORCE, *terms
    )
    estimator = EndpointEstimator(geometry, ("joint",))
    estimator.use_causes([posor.hypotheses.joint_causes()])
    endpoints = Endpoints.allocate(len(estimates), 1)._replace(
        poses=estimates.poses,
        covariances_random=estimates.covariances_random,
        covariances_systematic=estimates.covariances_systematic,
        stamp_shifts=estimates.stamp_shifts,
    )
    poses, effects, shifts = estimates.poses, estimates.fault_effects, estimates.stamp_shifts
    return estimator.bound_all(endpoints, poses[:, None], effects[:, None], shifts[:, None])


@dataclass(frozen=True)
class ArmReliability:
    """Reliability of all joints of an arm in one posture, and what it means for the endpoint."""

    angles: Mapping[str, float]  # of the joints [rad], by name
    joints: Mapping[str, Reliability]  # reliability of each joint
    # Largest undetected change of the endpoint by each cause of each joint, in metres and radians along and about the
    # axes of the base, (6,); infinite: not bounded
    effects: Mapping[str, Mapping[str, FloatArray]]
    expansions: FloatArray  # largest change by the temperature of the measuring beams, (6,), likewise
    protection_level: FloatArray  # of the endpoint, (6,)
    set_by: tuple[tuple[str, str], ...]  # joint and fault that set the level along and about each axis


def arm_reliability(
    chain: Chain, calibrations: Mapping[str, Calibration], angles: Mapping[str, float]
) -> ArmReliability:
    """Return the reliability of an arm at rest.

    ``chain``: the arm, with uncertainty and temperature of its beams. ``calibrations``: of the POSORs, by joint.
    ``angles``: of the joints [rad], by name. Raises ChainError: a POSOR has no valid pose at its angle. Raises
    ParameterError: a sensor has no forward model, or is out of range at its angle. Raises FitError: the readings of a
    joint do not determine all six freedoms.
    """
    poses = {joint.name: chain.nominal_joint(joint.name, angles[joint.name]) for joint in chain.joints}
    random, systematic, shared = model_covariances(calibrations, chain, angles)
    joints = {}
    for name, pose in poses.items():
        posor = Posor(calibrations[name])
        joints[name] = joint_reliability(posor, scan_at(posor, pose), pose)
    estimator = chain.estimator()
    estimator.use_terms([tuple(shared[name]) for name in poses])
    causes = [each.hypotheses.joint_causes() for each in joints.values()]
    estimator.use_causes(causes)
    packed = np.array([[pin.SE3ToXYZQUAT(pose) for pose in poses.values()]])
    terms = max(map(len, shared.values()), default=0)
    by_term = np.zeros((1, len(poses), terms, 6))
    for j, name in enumerate(poses):
        for t, effect in enumerate(shared[name].values()):
            by_term[0, j, t] = effect
    parts = [np.array([[each[name] for name in poses]]) for each in (random, systematic)]
    endpoints = estimator.estimate_all(packed, parts[0], parts[1], np.zeros(1, dtype=np.int64), shared_effects=by_term)
    effects = np.full((1, *estimator.fault_effects.shape), 0.0, dtype=np.float32)
    for j, each in enumerate(joints.values()):
        effects[0, j, : len(each.effects)] = each.effects
    whole = estimator.bound_all(endpoints, packed, effects)
    # Alone: one cause of one joint at a time, then none; without any uncertainty.
    cases = [(j, number, cause) for j, own in enumerate(causes) for number, cause in enumerate(own.names)]
    alone = np.zeros((len(cases) + 1, *effects.shape[1:]), dtype=np.float32)
    alone[..., 6] = 1.0
    for n, (j, number, _) in enumerate(cases):
        selected = np.flatnonzero(np.array(causes[j].of_effects) == number)
        alone[n, j, selected] = effects[0, j, selected]
    exact = Endpoints.allocate(len(alone), len(poses))
    for numbers in (exact.poses, exact.covariances_random, exact.covariances_systematic, exact.stamp_shifts):
        numbers[:] = 0.0
    levels = estimator.bound_all(exact, np.repeat(packed, len(alone), axis=0), alone).levels
    by_joint: dict[str, dict[str, FloatArray]] = {name: {} for name in poses}
    for (j, _, cause), level in zip(cases, levels, strict=False):
        by_joint[estimator.joints[j]][cause] = level - levels[-1]
    return ArmReliability(angles, joints, by_joint, levels[-1], whole.levels[0], estimator.set_by(whole, 0))
