# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Nominal kinematics of an arm for many joint angles at once, and the inverse for positions of the endpoint.

The geometry equals that of ``Chain.nominal_endpoint``, which handles one set of angles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_drivers.simulator.pose_array import PoseArray

if TYPE_CHECKING:
    import pinocchio as pin
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.truth_model import TrueArm

_MAX_ITERATIONS = 200
_CONVERGED_RAD = 1e-12
_REACHED_M = 1e-9
_SINGULAR = 1e-6
"""Singular values below this share of the largest one are treated as zero."""


class NominalArm:
    """Nominal kinematics of a chain with joints j in order from the base.

    Attributes:
        joints: Names.
        origins: Pose of each joint axis in its receiving plate at angle zero.
        links: From each target plate to the next receiving plate; the first starts at the base, the last ends at the
            endpoint.

    """

    def __init__(self, chain: Chain, truth: TrueArm | None = None) -> None:
        """Read the fixed transforms of a chain, or of a model of the same arm instead."""
        self.joints = tuple(joint.name for joint in chain.joints)
        self.origins: tuple[pin.SE3, ...] = tuple(joint.T_parent_joint for joint in chain.joints)
        self.links: tuple[pin.SE3, ...] = tuple(link.T_nominal for link in chain.links)
        if truth is not None:
            self.joints, self.origins = truth.joints, truth.origins
            self.links = tuple(link.before * link.end * link.after for link in truth.links)

    def target_plates(self, angles: FloatArray) -> list[PoseArray]:
        """Return the target plate of each joint in the base, for angles [rad], (n, j)."""
        receiving = PoseArray.repeat(self.links[0], len(angles))
        targets = []
        for origin, link, column in zip(self.origins, self.links[1:], angles.T, strict=True):
            target = receiving @ origin @ PoseArray.from_axis_angles(2, column)
            targets.append(target)
            receiving = target @ link
        return targets

    def endpoint(self, angles: FloatArray) -> PoseArray:
        """Return the endpoint in the base, for angles [rad], (n, j)."""
        endpoint: PoseArray = self.target_plates(angles)[-1] @ self.links[-1]
        return endpoint

    def jacobian(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the endpoint's position [m], (n, 3), and its derivative with respect to the angles, (n, 3, j)."""
        targets = self.target_plates(angles)
        position = (targets[-1] @ self.links[-1]).translations
        columns = [np.cross(target.rotations[:, :, 2], position - target.translations) for target in targets]
        return position, np.stack(columns, axis=2)

    def solve_angles(self, positions: FloatArray, posture: FloatArray) -> FloatArray | None:
        """Return the joint angles nearest to a posture that bring the endpoint to positions.

        Minimises ``|q - posture|`` subject to ``p(q) = p`` by least-norm solutions of the linearised constraint, for
        positions in the base [m], (n, 3), and a posture [rad], (j,). The angles are in rad, (n, j); None where the
        iteration does not reach the positions.
        """
        angles = np.tile(posture, (len(positions), 1))
        for _ in range(_MAX_ITERATIONS):
            reached, jacobian = self.jacobian(angles)
            wanted = positions - reached + np.einsum("nij,nj->ni", jacobian, angles - posture)
            solution = posture + np.einsum("nij,nj->ni", np.linalg.pinv(jacobian, rcond=_SINGULAR), wanted)
            change = np.max(np.abs(solution - angles))
            angles = solution
            if change < _CONVERGED_RAD:
                error = np.max(np.abs(self.endpoint(angles).translations - positions))
                return angles if error < _REACHED_M else None
            if not change < np.pi:
                return None
        return None
