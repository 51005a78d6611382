# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Components of the uncertainty of an arm's endpoint: what each joint, beam and shared term contributes at a pose.

To first order (JCGM 100, 5.1 and 5.2) the components are independent, so their covariances add up to that of the
endpoint. The covariances of joints, placements, sag and shared terms are those that ``chain_node`` publishes. Two
components are added to them, both from stated bounds as rectangular distributions (JCGM 100, 4.3.7): the temperature of
the beams, taken as one quantity for all beams, and errors of the stamps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.kinematic_chain import Chain
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

ALL_BEAMS, ALL_JOINTS = "all beams", "all joints"
RECTANGULAR = 1.0 / 3.0  # variance of a rectangular distribution over the square of its half-width


class Kind(StrEnum):
    """Kind of a component."""

    RANDOM = "random"  # noise of a joint's readings
    SYSTEMATIC = "systematic"  # calibration of a joint, placement of a beam
    SHARED = "shared"  # error that several files share
    SAG = "sag"  # of a beam
    TEMPERATURE = "temperature"  # of the beams
    STAMPS = "stamps"  # errors of the stamps of an arm in motion


@dataclass(frozen=True)
class Component:
    """An independent component of the endpoint's uncertainty at one pose."""

    source: str  # joint, beam or shared term; ``ALL_BEAMS``, ``ALL_JOINTS``
    kind: Kind
    covariance: FloatArray  # of the endpoint, (6, 6), ROS order, axes of the base
    freedoms: float = math.inf  # degrees of freedom of the component


class JointCovariance(NamedTuple):
    """Uncertainty of the transform of one joint, ROS order, axes of the receiving plate."""

    random: FloatArray  # (6, 6)
    systematic: FloatArray  # with shared terms, (6, 6)
    shared: Mapping[str, FloatArray]  # effect of each shared term, by name, (6,)
    random_freedoms: float = math.inf
    systematic_freedoms: float = math.inf


class ArmPropagation:
    """How errors of joints and beams move the endpoint at one pose of an arm at rest.

    Attributes:
        T_base_endpoint: The endpoint, with the sag of the beams.
        joints: Change of the endpoint by a small motion of each joint's transform, by name, (6, 6).

    """

    def __init__(self, chain: Chain, transforms: Mapping[str, pin.SE3]) -> None:
        """Follow the chain; ``transforms``: of the joints, receiving plate to target plate, by name."""
        pose, unbent = pin.SE3.Identity(), np.eye(3)
        places: dict[str, tuple[FloatArray, FloatArray]] = {}
        beams: list[tuple[MeasuringBeam, FloatArray, FloatArray, FloatArray]] = []
        joints = [*(joint.name for joint in chain.path_joints), None]
        for link, name in zip(chain.links, joints, strict=True):
            pose, unbent = pose * link.before, unbent @ link.before.rotation
            if link.beam is not None:
                force = unbent.T @ chain.gravity
                start, pose = pose.rotation, pose * link.beam.T_under(force)
                beams.append((link.beam, force, start, pose.translation))
                unbent = unbent @ link.beam.T_start_end.rotation
            pose, unbent = pose * link.after, unbent @ link.after.rotation
            if name is not None:
                parent, pose = pose.rotation, pose * transforms[name]
                unbent = unbent @ transforms[name].rotation
                places[name] = parent, pose.translation
        self.T_base_endpoint = pose
        self.joints = {name: self._moved(*place) for name, place in places.items()}
        self._beams = [(beam, force, self._moved(start, end)) for beam, force, start, end in beams]

    def _moved(self, rotation: FloatArray, place: FloatArray) -> FloatArray:
        """Return the change of the endpoint by a small motion at a place, in axes of a rotation, (6, 6)."""
        lever = self.T_base_endpoint.translation - place
        return np.block([[rotation, -pin.skew(lever) @ rotation], [np.zeros((3, 3)), rotation]])

    def components(
        self, joints: Mapping[str, JointCovariance], stamp_shift: FloatArray | None = None
    ) -> tuple[Component, ...]:
        """Return all components, also those that are zero.

        ``joints``: by name. ``stamp_shift``: largest error of the endpoint by errors of the stamps, (6,); None: the arm
        is at rest.
        """
        found: list[Component] = []
        shared: dict[str, FloatArray] = {}

        def add_shared(effects: Mapping[str, FloatArray], to_endpoint: FloatArray) -> None:
            for term, effect in effects.items():
                shared[term] = shared.get(term, np.zeros(6)) + to_endpoint @ effect

        for name, to_endpoint in self.joints.items():
            own = joints[name]
            alone = own.systematic - sum(np.outer(each, each) for each in own.shared.values())
            parts = (Kind.RANDOM, own.random, own.random_freedoms), (Kind.SYSTEMATIC, alone, own.systematic_freedoms)
            found += [Component(name, k, to_endpoint @ part @ to_endpoint.T, freedoms) for k, part, freedoms in parts]
            add_shared(own.shared, to_endpoint)
        expansion = np.zeros(6)
        for beam, force, to_endpoint in self._beams:
            sag = beam.sag_sigma * (to_endpoint @ beam.sag_gain @ force)
            placement = to_endpoint @ beam.covariance @ to_endpoint.T
            spread = to_endpoint @ beam.spread_covariance @ to_endpoint.T  # as published without accelerometers
            found += [Component(beam.name, Kind.SYSTEMATIC, placement)]
            found.append(Component(beam.name, Kind.SAG, _square(sag) + spread))
            add_shared(beam.shared_effects_under(force), to_endpoint)
            if len(beam.thermal):  # a stated spread replaces the largest deviation
                found.append(Component(beam.name, Kind.TEMPERATURE, _products(to_endpoint @ beam.thermal.T)))
            else:
                expansion[:3] += to_endpoint[:3, :3] @ beam.expansion
        found += [Component(term, Kind.SHARED, _square(effect)) for term, effect in shared.items()]
        found.append(Component(ALL_BEAMS, Kind.TEMPERATURE, RECTANGULAR * _square(expansion)))
        if stamp_shift is not None:
            found.append(Component(ALL_JOINTS, Kind.STAMPS, RECTANGULAR * np.diag(np.square(stamp_shift))))
        return tuple(found)


def total_covariance(components: Sequence[Component]) -> FloatArray:
    """Return the covariance of the endpoint, (6, 6)."""
    return np.asarray(np.sum([each.covariance for each in components], axis=0))


def _products(effects: FloatArray) -> FloatArray:
    """Return the covariance by independent effects, (6, n)."""
    return np.asarray(effects @ effects.T)


def _square(effect: FloatArray) -> FloatArray:
    return np.outer(effect, effect)
