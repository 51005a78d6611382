"""Protection levels of an arm's endpoint: bounds of its error in spite of an undetected error of a single reading.

As in receiver autonomous integrity monitoring (RAIM) of satellite navigation. Along and about each axis k of the base,

    PL_k = max over joints and readings |effect_k of the minimal detectable bias|
           + sum over beams |effect_k of the largest expansion| + K sigma_k,

K the two-sided normal quantile of the integrity risk. An error of a reading beyond its minimal detectable bias passes a
scan with at most the probability of a missed detection; a smaller one, or none, leaves the error of the endpoint within
PL_k except with at most the integrity risk. Errors of two readings at once are not covered.

No reading shows the temperature of the measuring beams. Their expansions enter as a sum of amounts, so that the bound
holds for beams that deviate together, alone or against each other. The covariance does not contain them.

Source: R. G. Brown, *A baseline GPS RAIM scheme and a note on the equivalence of three RAIM methods*, Navigation 39(3),
1992; RTCA DO-229 (protection levels).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from posor.chain.joint_measurements import MeasuredJoint
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import model_covariances, scan_at
from posor.uncertainty.reliability import joint_reliability, transformed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.reliability import Reliability

INTEGRITY_RISK = 1e-5
"""Probability, of one scan and axis, that noise and calibration errors alone exceed their part of the level."""
COVERAGE_FACTOR = float(-ndtri(0.5 * INTEGRITY_RISK))
"""K, 4.42: the standard uncertainties of the endpoint in a protection level."""
NO_EXPANSIONS: FloatArray = np.zeros((0, 6))  # of an arm without measuring beams, or of a single joint


def endpoint_effects(chain: Chain, T_parent_child: Mapping[str, pin.SE3]) -> dict[str, FloatArray]:
    """Return how a shift of each joint's transform moves the endpoint.

    The sag of the beams is left out: it changes the levers by less than a thousandth.

    ``T_parent_child``: transform of each joint, by name. Returns the matrix (6, 6) of each joint, by name: from a shift
    of the transform (ROS order, axes of the joint's parent) to one of the endpoint (ROS order, axes of the base, the
    small turn applied at the endpoint).
    """
    pose = chain.links[0].T_nominal
    axes, centres = {}, {}
    for joint, link in zip(chain.joints, chain.links[1:], strict=True):
        axes[joint.name] = pose.rotation
        pose = pose * T_parent_child[joint.name]
        centres[joint.name] = pose.translation
        pose = pose * link.T_nominal
    return {name: _effect(axes[name], pose.translation - centres[name]) for name in axes}


def _effect(rotation: FloatArray, lever: FloatArray) -> FloatArray:
    x, y, z = lever
    effect = np.zeros((6, 6))
    effect[:3, :3] = effect[3:, 3:] = rotation
    effect[:3, 3:] = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ rotation  # turn x lever
    return effect


def expansion_shifts(chain: Chain, T_parent_child: Mapping[str, pin.SE3]) -> FloatArray:
    """Return how the endpoint moves if each measuring beam has the largest expansion that its temperature may cause.

    A beam of uniform temperature keeps its shape, so its expansion moves the endpoint without turning it. The sag of
    the beams is left out, as in ``endpoint_effects``.

    ``T_parent_child``: transform of each joint, by name. Returns the shift by each of the b beams between the base and
    the endpoint, (b, 6), ROS order, axes of the base [m, rad].
    """
    moved = [T_parent_child[joint.name].rotation for joint in chain.joints]
    shifts, rotation = [], np.eye(3)
    for link, turn in zip(chain.links, [*moved, np.eye(3)], strict=True):
        if link.beam is not None:
            shift = rotation @ link.before.rotation @ link.beam.expansion
            shifts.append(np.concatenate([shift, np.zeros(3)]))
        rotation = rotation @ link.T_nominal.rotation @ turn
    return np.reshape(shifts, (-1, 6))


def expansion_bound(expansions: FloatArray) -> FloatArray:
    """Return the bound of the endpoint's error by the temperature of the measuring beams, (6,) [m, rad].

    ``expansions``: of the beams, (b, 6), as ``expansion_shifts``.
    """
    return np.asarray(np.abs(expansions).sum(axis=0))


def endpoint_protection_level(
    shifts: Sequence[FloatArray],
    effects: Sequence[FloatArray],
    covariance: FloatArray,
    expansions: FloatArray = NO_EXPANSIONS,
) -> FloatArray:
    """Return the protection level of the endpoint along and about X, Y, Z of the base, (6,) [m, rad].

    ``shifts``: of each joint: the undetected shifts of its readings, (m, 6), as ``Reliability.shifts``. ``effects``: of
    each joint: its matrix of ``endpoint_effects``, (6, 6). ``covariance``: of the endpoint, (6, 6). ``expansions``: of
    the measuring beams, (b, 6), as ``expansion_shifts``. Returns the levels; infinite where an error that moves the
    endpoint is not detectable.
    """
    moved = np.concatenate([np.abs(transformed(effect, own)) for own, effect in zip(shifts, effects, strict=True)])
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return np.asarray(np.max(moved, axis=0, initial=0.0) + expansion_bound(expansions) + COVERAGE_FACTOR * sigmas)


@dataclass(frozen=True)
class ArmReliability:
    """Reliability of all joints of an arm in one posture, and what it means for the endpoint."""

    angles: Mapping[str, float]  # of the joints [rad], by name
    joints: Mapping[str, Reliability]  # reliability of each joint
    # of each joint: change of the endpoint by the minimal detectable bias of each reading, (m, 6), ROS order, axes of
    # the base [m, rad]; infinite: not bounded
    endpoint_shifts: Mapping[str, FloatArray]
    expansions: FloatArray  # change of the endpoint by the largest expansion of each measuring beam, (b, 6), likewise
    protection_level: FloatArray  # of the endpoint, (6,)


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
    measured = {name: MeasuredJoint(pose, random[name], systematic[name], shared[name]) for name, pose in poses.items()}
    joints, endpoint_shifts = {}, {}
    for name, effect in endpoint_effects(chain, poses).items():
        posor = Posor(calibrations[name])
        joints[name] = joint_reliability(posor, scan_at(posor, poses[name]), poses[name])
        endpoint_shifts[name] = transformed(effect, joints[name].shifts)
    shifts, unchanged = list(endpoint_shifts.values()), np.eye(6)
    covariance, expansions = chain.estimate(measured).covariance(), expansion_shifts(chain, poses)
    level = endpoint_protection_level(shifts, [unchanged] * len(shifts), covariance, expansions)
    return ArmReliability(angles, joints, endpoint_shifts, expansions, level)
