# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of an arm for the kernels: the elements on the way from the base to the endpoint, with named fields."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.joint_measurements import RecordArray
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.chain.robot_model import RobotModel
    from posor.numerics.array_types import FloatArray, IntArray

NO_INDEX = -1
ELEMENT = np.dtype([("joint", np.int64), ("beam", np.int64), ("rotation", float, (3, 3)), ("translation", float, 3)])
"""A moving element, which is a joint or a beam (index, or ``NO_INDEX``), and the fixed transform before it."""
BEAM = np.dtype(
    [
        ("rotation", float, (3, 3)),  # start to end without sag
        ("translation", float, 3),  # [m]
        # Effect of a specific force [m/s^2] in the axes of the beam's start:
        ("shift_gain", float, (3, 3)),  # shift of the end relative to the start [m], axes of the start
        ("start_turn_gain", float, (3, 3)),  # turn of the start [rad], axes of the start
        ("end_turn_gain", float, (3, 3)),  # turn of the end [rad], axes of the end
        # The same for a specific force that grows by 1 m/s^2 along the beam, from -0.5 m/s^2 at its start:
        ("tilt_shift_gain", float, (3, 3)),
        ("tilt_start_turn_gain", float, (3, 3)),
        ("tilt_end_turn_gain", float, (3, 3)),
        # ``MeasuringBeam.sag_gain`` and ``tilt_gain``: shift of the end [m] and its turn [rad], axes of the start:
        ("plate_shift_gain", float, (3, 3)),
        ("plate_turn_gain", float, (3, 3)),
        ("tilt_plate_shift_gain", float, (3, 3)),
        ("tilt_plate_turn_gain", float, (3, 3)),
        ("sigma_shift_gain", float, (3, 3)),  # one standard deviation of the sag: translation [m], axes of the start
        ("sigma_turn_gain", float, (3, 3)),  # the same: rotation [rad], axes of the start
        ("covariance", float, (6, 6)),  # ``MeasuringBeam.covariance_without_sag``
        ("expansion", float, 3),  # ``MeasuringBeam.expansion`` [m]
    ]
)


class ArmGeometry(NamedTuple):
    """An arm of j joints and b beams, of which k are on the way to the endpoint."""

    # Elements on the way, then one without joint and beam for the endpoint, (k + 1,) of ``ELEMENT``
    elements: RecordArray
    beams: RecordArray  # (b,) of ``BEAM``
    joint_origins: FloatArray  # rotation of each joint's origin in its parent link, (j, 3, 3)
    joint_positions: FloatArray  # each joint's origin in its parent link [m], (j, 3)
    gravity: FloatArray  # [m/s^2], (3,), axes of the base
    # Shared terms: T of a joint at most, K of the arm
    joint_terms: IntArray  # which of the arm's terms each term of a joint is, (j, T); ``NO_INDEX``: none
    beam_effects: FloatArray  # ``MeasuringBeam.shared_effects``, (K, b, 6)
    beam_sags: FloatArray  # gain of the sag times its change, (K, b, 6, 3), as ``MeasuringBeam.sag_gain``

    @classmethod
    def from_model(cls, robot: RobotModel, beams: Sequence[MeasuringBeam], gravity: FloatArray) -> ArmGeometry:
        """Return the geometry of an arm.

        ``robot``: the model of its URDF; ``beams``: its measuring beams, in the order of ``robot.freed``; ``gravity``:
        [m/s^2], (3,), axes of the base.
        """
        elements = []
        for index in robot.path():
            joint, beam = (
                next((n for n, each in enumerate(joints) if each.index == index), NO_INDEX)
                for joints in (robot.joints, robot.freed)
            )
            frame = (robot.joints[joint] if beam == NO_INDEX else robot.freed[beam]).T_before_parent
            elements.append((joint, beam, frame.rotation, frame.translation))
        frame = robot.T_joint_endpoint
        elements.append((NO_INDEX, NO_INDEX, frame.rotation, frame.translation))
        return cls(
            np.array(elements, dtype=ELEMENT),
            np.array([beam_record(beam) for beam in beams], dtype=BEAM),
            np.array([joint.T_parent_joint.rotation for joint in robot.joints]),
            np.array([joint.T_parent_joint.translation for joint in robot.joints]),
            np.array(gravity, dtype=float),
            np.zeros((len(robot.joints), 0), dtype=np.int64),
            np.zeros((0, len(beams), 6)),
            np.zeros((0, len(beams), 6, 3)),
        )

    def with_terms(
        self, beams: Sequence[MeasuringBeam], of_joints: Sequence[Sequence[str]]
    ) -> tuple[tuple[str, ...], ArmGeometry]:
        """Return the names of all shared terms, and the same arm with them; ``of_joints``: names of each joint's."""
        names = tuple(dict.fromkeys(chain(*(beam.shared_effects for beam in beams), *of_joints)))
        of_joint = np.full((len(of_joints), max(map(len, of_joints), default=0)), NO_INDEX, dtype=np.int64)
        for row, own in zip(of_joint, of_joints, strict=True):
            row[: len(own)] = [names.index(name) for name in own]
        effects = [[beam.shared_effects.get(name, np.zeros(6)) for beam in beams] for name in names]
        sags = [[beam.shared_sags.get(name, 0.0) * beam.sag_gain for beam in beams] for name in names]
        return names, self._replace(
            joint_terms=of_joint,
            beam_effects=np.reshape(effects, (len(names), len(beams), 6)).astype(float),
            beam_sags=np.reshape(sags, (len(names), len(beams), 6, 3)).astype(float),
        )


def beam_record(beam: MeasuringBeam) -> tuple[FloatArray, ...]:
    """Return the fields of ``BEAM``."""
    span, sigma_gain = beam.T_start_end, beam.sag_sigma * beam.sag_gain
    return (
        span.rotation,
        span.translation,
        beam.end_gain[:3] - beam.start_gain[:3],
        beam.start_gain[3:],
        span.rotation.T @ beam.end_gain[3:],
        beam.end_tilt_gain[:3] - beam.start_tilt_gain[:3],
        beam.start_tilt_gain[3:],
        span.rotation.T @ beam.end_tilt_gain[3:],
        *np.split(beam.sag_gain, 2),
        *np.split(beam.tilt_gain, 2),
        sigma_gain[:3],
        sigma_gain[3:],
        beam.covariance_without_sag,
        beam.expansion,
    )
