"""The arm without any error, at many joint angles at once: where its joints are, and how to bring its endpoint along.

The same geometry as ``Chain.nominal_endpoint``, which does it for one set of angles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_drivers.simulator.poses import Poses

if TYPE_CHECKING:
    import pinocchio as pin
    from posor_estimator.core.chain import Chain
    from posor_estimator.core.types import FloatArray

_STEPS = 200
_SETTLED_RAD = 1e-12
_THERE_M = 1e-9
_BLIND = 1e-6
"""Directions in which the endpoint moves less than this share of its liveliest one count as none."""


class NominalArm:
    """The nominal kinematics of a chain; joints j in order from the base.

    Attributes:
        joints: Names.
        origins: Of each joint's axis in its receiving plate, where its angle is zero.
        links: From each target plate to the next receiving plate, the last to the endpoint; the first from the base.

    """

    def __init__(self, chain: Chain) -> None:
        """Take the fixed transforms out of a chain."""
        self.joints = tuple(joint.name for joint in chain.joints)
        self.origins: tuple[pin.SE3, ...] = tuple(joint.T_parent_joint for joint in chain.joints)
        self.links: tuple[pin.SE3, ...] = tuple(link.T_nominal for link in chain.links)

    def targets(self, angles: FloatArray) -> list[Poses]:
        """Return the target plate of each joint in the base, for angles [rad], (n, j)."""
        here = Poses.repeated(self.links[0], len(angles))
        out = []
        for origin, link, column in zip(self.origins, self.links[1:], angles.T, strict=True):
            target = here @ origin @ Poses.turns(2, column)
            out.append(target)
            here = target @ link
        return out

    def endpoint(self, angles: FloatArray) -> Poses:
        """Return the endpoint in the base, for angles [rad], (n, j)."""
        end: Poses = self.targets(angles)[-1] @ self.links[-1]
        return end

    def jacobian(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the endpoint's position [m], (n, 3), and its derivative by the angles [m/rad], (n, 3, j)."""
        targets = self.targets(angles)
        position = (targets[-1] @ self.links[-1]).translations
        columns = [np.cross(target.rotations[:, :, 2], position - target.translations) for target in targets]
        return position, np.stack(columns, axis=2)

    def angles_for(self, positions: FloatArray, posture: FloatArray) -> FloatArray | None:
        """Return the joint angles nearest to a posture that bring the endpoint to positions.

        Of all ``q`` with ``p(q) = p`` the one with the least ``|q - posture|``: step by step the least-norm solution of
        the linearised constraint.

        Args:
            positions: Of the endpoint in the base [m], (n, 3).
            posture: [rad], (j,).

        Returns:
            Angles [rad], (n, j); None where the arm does not get there from the posture.

        """
        angles = np.tile(posture, (len(positions), 1))
        for _ in range(_STEPS):
            reached, jacobian = self.jacobian(angles)
            wanted = positions - reached + np.einsum("nij,nj->ni", jacobian, angles - posture)
            new = posture + np.einsum("nij,nj->ni", np.linalg.pinv(jacobian, rcond=_BLIND), wanted)
            change = np.max(np.abs(new - angles))
            angles = new
            if change < _SETTLED_RAD:
                there = np.max(np.abs(self.endpoint(angles).translations - positions)) < _THERE_M
                return angles if there else None
            if not change < np.pi:
                return None
        return None
