"""Many poses at once: what pinocchio's SE3 is for one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class Poses:
    """n poses ``T_parent_child``.

    Attributes:
        rotations: (n, 3, 3).
        translations: [m], (n, 3).

    """

    rotations: FloatArray
    translations: FloatArray

    @classmethod
    def turns(cls, axis: int, angles: FloatArray) -> Self:
        """Return turns about X, Y or Z (0, 1, 2) by angles [rad], (n,)."""
        return cls.motions(np.zeros((len(angles), 3)), angles[:, None] * np.eye(3)[axis])

    @classmethod
    def motions(cls, translations: FloatArray, rotation_vectors: FloatArray) -> Self:
        """Return the poses of origins [m] and rotation vectors [rad], (n, 3) each."""
        return cls(Rotation.from_rotvec(rotation_vectors).as_matrix(), translations)

    @classmethod
    def repeated(cls, pose: pin.SE3, count: int) -> Self:
        """Return one pose n times."""
        return cls(np.tile(pose.rotation, (count, 1, 1)), np.tile(pose.translation, (count, 1)))

    def __len__(self) -> int:
        """Return n."""
        return len(self.rotations)

    def __getitem__(self, index: int) -> pin.SE3:
        """Return one of the poses."""
        return pin.SE3(self.rotations[index], self.translations[index])

    def __matmul__(self, other: Poses | pin.SE3) -> Poses:
        """Return the products, pose by pose; a single pose follows each of them."""
        rotation, translation = (
            (other.rotations, other.translations) if isinstance(other, Poses) else (other.rotation, other.translation)
        )
        return Poses(self.rotations @ rotation, self.translations + self.turned(translation))

    def turned(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (n, 3) or (3,), given in the children's axes, in the parents'."""
        return np.asarray(np.einsum("nij,j->ni" if vectors.ndim == 1 else "nij,nj->ni", self.rotations, vectors))

    def turned_back(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (n, 3) or (3,), given in the parents' axes, in the children's."""
        return np.asarray(np.einsum("nji,j->ni" if vectors.ndim == 1 else "nji,nj->ni", self.rotations, vectors))

    def inverse(self) -> Poses:
        """Return ``T_child_parent``."""
        return Poses(np.swapaxes(self.rotations, 1, 2), -self.turned_back(self.translations))

    def moved(self, translations: FloatArray, rotation_vectors: FloatArray) -> Poses:
        """Return the children after small motions in the parents' axes, each turned about its own origin."""
        return Poses(
            Rotation.from_rotvec(rotation_vectors).as_matrix() @ self.rotations, self.translations + translations
        )

    def at(self, indices: FloatArray) -> Poses:
        """Return the poses of some indices."""
        return Poses(self.rotations[indices], self.translations[indices])
