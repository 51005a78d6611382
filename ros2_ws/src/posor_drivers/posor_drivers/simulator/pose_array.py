# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arrays of poses, with the operations of pinocchio's SE3, and the true poses of an arm."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class PoseArray:
    """n poses ``T_parent_child``."""

    rotations: FloatArray  # (n, 3, 3)
    translations: FloatArray  # [m], (n, 3)

    @classmethod
    def from_rotation_vectors(cls, translations: FloatArray, rotation_vectors: FloatArray) -> Self:
        """Return the poses with origins [m] and rotation vectors [rad], (n, 3) each."""
        return cls(Rotation.from_rotvec(rotation_vectors).as_matrix(), translations)

    @classmethod
    def from_axis_angles(cls, axis: int, angles: FloatArray) -> Self:
        """Return rotations about X, Y or Z (0, 1, 2) by angles [rad], (n,)."""
        return cls.from_rotation_vectors(np.zeros((len(angles), 3)), angles[:, None] * np.eye(3)[axis])

    @classmethod
    def repeat(cls, pose: pin.SE3, count: int) -> Self:
        """Return one pose ``count`` times."""
        return cls(np.tile(pose.rotation, (count, 1, 1)), np.tile(pose.translation, (count, 1)))

    def __len__(self) -> int:
        return len(self.rotations)

    def __getitem__(self, index: int) -> pin.SE3:
        return pin.SE3(self.rotations[index], self.translations[index])

    def select(self, indices: IntArray | BoolArray) -> PoseArray:
        """Return the poses of some indices, or of a mask."""
        return PoseArray(self.rotations[indices], self.translations[indices])

    def __matmul__(self, other: PoseArray | pin.SE3) -> PoseArray:
        """Return the products, pose by pose, or with one pose as right factor of all."""
        rotation, translation = (
            (other.rotations, other.translations)
            if isinstance(other, PoseArray)
            else (other.rotation, other.translation)
        )
        return PoseArray(self.rotations @ rotation, self.translations + self.rotate(translation))

    def inverse(self) -> PoseArray:
        """Return ``T_child_parent``."""
        return PoseArray(np.swapaxes(self.rotations, 1, 2), -self.rotate_back(self.translations))

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (n, 3) or (3,) of the child axes in the parent axes, (n, 3)."""
        return np.asarray(np.einsum("nij,j->ni" if vectors.ndim == 1 else "nij,nj->ni", self.rotations, vectors))

    def rotate_back(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (n, 3) or (3,) of the parent axes in the child axes, (n, 3)."""
        return np.asarray(np.einsum("nji,j->ni" if vectors.ndim == 1 else "nji,nj->ni", self.rotations, vectors))

    def displace(self, translations: FloatArray, rotation_vectors: FloatArray) -> PoseArray:
        """Return the poses after small motions [m], [rad] in the parent axes; rotations are about each own origin."""
        rotations = Rotation.from_rotvec(rotation_vectors).as_matrix()
        return PoseArray(rotations @ self.rotations, self.translations + translations)


def poses_between(poses: PoseArray, around: Sequence[PoseArray], share: float | FloatArray) -> PoseArray:
    """Return poses a share of a tick later, one or (n, 1), on the parabola through the poses of three ticks.

    ``around`` are the poses one tick before, at the same tick, and one tick later, of which only the motion counts.
    """
    before, present, after = around
    weights = 0.5 * share * (share - 1.0), 0.5 * share * (share + 1.0)
    turn, shift = np.zeros_like(poses.translations), np.zeros_like(poses.translations)
    for weight, other in zip(weights, (before, after), strict=True):
        relative = np.swapaxes(present.rotations, 1, 2) @ other.rotations
        turn += weight * Rotation.from_matrix(relative).as_rotvec()
        shift += weight * (other.translations - present.translations)
    return PoseArray(poses.rotations @ Rotation.from_rotvec(turn).as_matrix(), poses.translations + shift)


@dataclass(frozen=True)
class ArmTruth:
    """The truth at n ticks; joints j in order from the base."""

    joints: tuple[str, ...]  # names
    commanded: FloatArray  # commanded angles, which the motors follow exactly [rad], (n, j)
    encoder: FloatArray  # readings of the motors' encoders [rad], (n, j)
    angles: FloatArray  # true joint angles [rad], (n, j)
    T_parent_child: Mapping[str, PoseArray]  # target plate in the receiving plate of each POSOR, by joint
    R_parent_base: FloatArray  # rotation of vectors of the base into the axes of the last receiving plate, (n, 3, 3)
    endpoint: PoseArray  # in the base
    target: PoseArray  # commanded endpoint: nominal kinematics of the commanded angles, in the base
    # Specific forces of both gimbals of beams with ``vibration`` [m/s^2], axes of the beam's start, (n, 2, 3), by beam
    specific_forces: Mapping[str, FloatArray] = field(default_factory=dict)

    def select(self, indices: IntArray) -> ArmTruth:
        """Return the truth at some indices, (n,)."""
        arrays = ("commanded", "encoder", "angles", "R_parent_base")
        poses = ("endpoint", "target")
        return replace(
            self,
            T_parent_child={joint: seen.select(indices) for joint, seen in self.T_parent_child.items()},
            specific_forces={beam: force[indices] for beam, force in self.specific_forces.items()},
            **{name: getattr(self, name)[indices] for name in arrays},
            **{name: getattr(self, name).select(indices) for name in poses},
        )

    def with_stage(self, positions: FloatArray) -> ArmTruth:
        """Return the truth with the stage at positions [m], (n, 3), axes of the endpoint.

        The stage displaces the last measuring beam, and with it the last target plate and the endpoint.
        """
        shift = self.endpoint.rotate(positions)
        endpoint = PoseArray(self.endpoint.rotations, self.endpoint.translations + shift)
        last = self.T_parent_child[self.joints[-1]]
        shift_in_parent = np.einsum("nij,nj->ni", self.R_parent_base, shift)
        moved = PoseArray(last.rotations, last.translations + shift_in_parent)
        poses = {**self.T_parent_child, self.joints[-1]: moved}
        return replace(self, T_parent_child=poses, endpoint=endpoint)
