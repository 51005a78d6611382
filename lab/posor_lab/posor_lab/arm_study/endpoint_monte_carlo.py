# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Spread of an arm's endpoint by drawing errors of joints and beams through the exact chain (JCGM 101)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.chain.joint_measurements import MeasuredJoint
from posor_design.endpoint_budget import Spread

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray
    from posor_design.endpoint_budget import SharedEffects


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
