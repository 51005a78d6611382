# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error budget of an arm's endpoint: contributions of each POSOR and of the measuring beams.

First order (JCGM 100) from the covariance of the chain, and by drawing errors through the exact chain (JCGM 101).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.chain.joint_measurements import MeasuredJoint

from posor_design.endpoint_components import ArmPropagation, JointCovariance, Kind

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray

    SharedEffects = Mapping[str, Mapping[str, FloatArray]]

BEAMS = "measuring beams"  # name of the contribution of all beams
SHARED = "shared: "  # before the name of a shared term


@dataclass(frozen=True)
class Spread:
    """Standard uncertainties of the endpoint, k = 1, axes of the base."""

    orientation: FloatArray  # about X, Y, Z [rad], (3,)
    displacement: FloatArray  # along X, Y, Z [m], (3,)

    @staticmethod
    def of(covariance: FloatArray) -> Spread:
        """Return the spread of a covariance (6, 6) in ROS order."""
        sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return Spread(sigmas[3:], sigmas[:3])

    @property
    def total(self) -> float:
        """Root sum square of the displacements [m]."""
        return float(np.linalg.norm(self.displacement))


@dataclass(frozen=True)
class Contribution:
    """Contribution of one POSOR, of all measuring beams, or of a shared term, if everything else were exact."""

    name: str
    spread: Spread


@dataclass(frozen=True)
class EndpointBudget:
    """Standard uncertainties of the endpoint and their contributions."""

    spread: Spread  # total of all contributions
    # of each joint, of the beams unless they are exact, and of shared terms; in decreasing order of displacement
    contributions: tuple[Contribution, ...]


def endpoint_budget(
    chain: Chain,
    angles: Mapping[str, float],
    covariances: Mapping[str, FloatArray],
    shared: SharedEffects | None = None,
) -> EndpointBudget:
    """Return the budget of an arm at rest.

    ``chain``: the arm, with the uncertainty of its beams. ``angles``: angle of each joint [rad], by name.
    ``covariances``: covariance of each POSOR's transform without shared terms, (6, 6) in ROS order, by name.
    ``shared``: effects of shared terms on each POSOR's transform, by joint and term, (6,); None: none.
    """
    joints = {}
    for name, own in covariances.items():
        effects = (shared or {}).get(name, {})
        systematic = own + sum(np.outer(each, each) for each in effects.values())
        joints[name] = JointCovariance(np.zeros((6, 6)), systematic, effects)
    arm = ArmPropagation(chain, {name: chain.nominal_joint(name, angles[name]) for name in joints})
    sums: dict[str, FloatArray] = {}
    for each in arm.components(joints):
        if each.kind not in {Kind.RANDOM, Kind.TEMPERATURE}:
            name = f"{SHARED}{each.source}" if each.kind is Kind.SHARED else each.source
            name = name if each.kind is Kind.SHARED or name in joints else BEAMS
            sums[name] = sums.get(name, np.zeros((6, 6))) + each.covariance
    if not any(beam.covariance.any() or beam.sag_sigma for beam in chain.beams):
        sums.pop(BEAMS, None)
    parts = [Contribution(name, Spread.of(covariance)) for name, covariance in sums.items()]
    parts.sort(key=lambda part: part.spread.total, reverse=True)
    return EndpointBudget(Spread.of(np.sum(list(sums.values()), axis=0)), tuple(parts))


def monte_carlo(
    chain: Chain,
    angles: Mapping[str, float],
    covariances: Mapping[str, FloatArray],
    draws: int,
    seed: int,
    shared: SharedEffects | None = None,
) -> Spread:
    """Return the spread of the endpoint over drawn errors of joints and beams, each through the exact chain.

    ``angles``, ``covariances``, ``shared``: see ``endpoint_budget``. ``draws``: number of draws; relative uncertainty
    of the spread: 1 / sqrt(2 draws). ``seed``: seed of the draws.
    """
    random = np.random.default_rng(seed)
    exact = {joint.name: chain.nominal_joint(joint.name, angles[joint.name]) for joint in chain.joints}
    beams = _beams(chain, exact)
    nominal = chain.estimate({name: MeasuredJoint(pose) for name, pose in exact.items()}).T_base_endpoint
    joint_errors = {name: _drawn(random, covariances[name], draws) for name in exact}
    beam_errors = [_drawn(random, covariance, draws) for _, covariance, _, _ in beams]
    terms = {name: random.normal(size=(draws, 1)) for name in _term_names(chain, shared or {})}
    for name, effects in (shared or {}).items():
        joint_errors[name] += sum(terms[term] * effect for term, effect in effects.items())
    for n, (_, _, effects, _) in enumerate(beams):
        beam_errors[n] += sum(terms[term] * effect for term, effect in effects.items())
    errors = np.empty((draws, 6))
    for n in range(draws):
        # The error of a beam is applied to the measurement of the next joint.
        extra = [
            after.inverse() * link.inverse() * disturbed(link, drawn[n]) * after
            for (link, _, _, after), drawn in zip(beams, beam_errors, strict=True)
        ]
        measured = {
            name: MeasuredJoint(before * disturbed(exact[name], joint_errors[name][n]))
            for before, name in zip(extra, exact, strict=False)
        }
        end = chain.estimate(measured).T_base_endpoint * extra[-1]
        errors[n, :3] = end.translation - nominal.translation
        errors[n, 3:] = pin.log3(end.rotation @ nominal.rotation.T)
    return Spread.of(errors.T @ errors / draws)


def _term_names(chain: Chain, shared: SharedEffects) -> list[str]:
    return list(dict.fromkeys([*chain.shared, *(term for effects in shared.values() for term in effects)]))


def _beams(
    chain: Chain, exact: Mapping[str, pin.SE3]
) -> list[tuple[pin.SE3, FloatArray, Mapping[str, FloatArray], pin.SE3]]:
    """Return for each link its sagging beam, the beam's covariance, its shared terms, and the transform after it."""
    beams: list[tuple[pin.SE3, FloatArray, Mapping[str, FloatArray], pin.SE3]] = []
    effects: Mapping[str, FloatArray]
    pose = pin.SE3.Identity()
    for link, joint in zip(chain.links, [*exact.values(), pin.SE3.Identity()], strict=True):
        pose *= link.before
        if link.beam is None:
            beam, covariance, effects = pin.SE3.Identity(), np.zeros((6, 6)), {}
        else:
            force = pose.rotation.T @ chain.gravity
            beam, covariance = link.beam.T_under(force), link.beam.covariance_under(force)
            effects = link.beam.shared_effects_under(force)
        beams.append((beam, covariance, effects, link.after))
        pose = pose * beam * link.after * joint
    return beams


def _drawn(random: np.random.Generator, covariance: FloatArray, draws: int) -> FloatArray:
    return random.multivariate_normal(np.zeros(6), covariance, draws, method="eigh")


def disturbed(T_parent_child: pin.SE3, error: FloatArray) -> pin.SE3:
    """Return a transform with an error (x, y, z [m], about X, Y, Z [rad]) in the axes of the parent."""
    return pin.SE3(pin.exp3(error[3:]) @ T_parent_child.rotation, T_parent_child.translation + error[:3])


def configurations(names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return joint angles [rad] as in section 9.3.1: ``extended``, all zero; ``bent``, the last one a right angle."""
    extended = dict.fromkeys(names, 0.0)
    return {"extended": extended, "bent": {**extended, names[-1]: 0.5 * math.pi}}
