# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Error budget of an arm's endpoint: contributions of each POSOR and of the measuring beams.

First order (JCGM 100) from the covariance of the chain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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


def configurations(names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return joint angles [rad] as in section 9.3.1: ``extended``, all zero; ``bent``, the last one a right angle."""
    extended = dict.fromkeys(names, 0.0)
    return {"extended": extended, "bent": {**extended, names[-1]: 0.5 * math.pi}}
