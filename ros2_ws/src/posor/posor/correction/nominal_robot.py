# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The robot as its controller knows it: exact links and joint angles, and the errors of its joints by its endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field

from posor.errors import ChainError
from posor.parameter_model import ParameterGroup

if TYPE_CHECKING:
    from posor.chain.kinematic_chain import Chain
    from posor.numerics.array_types import FloatArray


class LeastSquares(ParameterGroup):
    """From six errors of the endpoint to joint angles: the nearest by weighted, damped least squares."""

    rotation_length: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.1,
        description="position error that counts as much as an orientation error of 1 rad [m]; small for robots of less "
        "than six joints, whose position comes first; 0: position only",
    )
    least_lever: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.1,
        description="lever [m] with which the joints must move the endpoint along an error; with less, as near a "
        "singular pose, the error is corrected in part, so that the offsets stay finite",
    )


class NominalRobot:
    """A chain whose POSOR joints turn about the Z axes of their origins by the angles that a controller commands.

    Attributes:
        joints: Names from the base to the endpoint, of all arrays of angles.
        base_frame: Link in which poses are.

    """

    def __init__(self, chain: Chain, weights: LeastSquares | None = None) -> None:
        """Build the model of pinocchio. Raises ChainError: a POSOR of the chain does not move the endpoint."""
        if len(chain.joints) != len(chain.path_joints):
            names = ", ".join(joint.name for joint in chain.joints if joint not in chain.path_joints)
            raise ChainError(
                f"POSOR {names} does not move the endpoint", where="the URDF", expected="joints of one row"
            )
        self.joints = tuple(joint.name for joint in chain.path_joints)
        self.base_frame = chain.base_frame
        self._weights = weights or LeastSquares()
        self._model = pin.Model()
        parent, place = 0, chain.links[0].T_nominal
        for joint, link in zip(chain.path_joints, chain.links[1:], strict=True):
            parent = self._model.addJoint(parent, pin.JointModelRZ(), place * joint.T_parent_joint, joint.name)
            place = link.T_nominal
        self._endpoint = self._model.addFrame(pin.Frame("endpoint", parent, 0, place, pin.FrameType.OP_FRAME))
        self._data = self._model.createData()

    def endpoint(self, angles: FloatArray) -> pin.SE3:
        """Return the endpoint in the base at joint angles (j,) [rad]."""
        pin.framesForwardKinematics(self._model, self._data, angles)
        return self._data.oMf[self._endpoint].copy()

    def jacobian(self, angles: FloatArray) -> FloatArray:
        """Return the derivative of the endpoint by the angles, (6, j): x, y, z [m], about X, Y, Z, axes of the base."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        found = pin.computeFrameJacobian(self._model, self._data, angles, self._endpoint, frame)
        return np.asarray(found).reshape(6, -1)  # of one joint: a vector

    def joint_errors(self, angles: FloatArray, measured: pin.SE3) -> FloatArray:
        """Return by how much the joints seem to be beyond the angles of the controller, (j,) [rad].

        ``angles``: where the controller has the joints (j,); ``measured``: the endpoint at the same time. A robot of
        less than six joints corrects the position first, see ``LeastSquares.rotation_length``.
        """
        nominal = self.endpoint(angles)
        turn = pin.log3(measured.rotation @ nominal.rotation.T)
        scale = np.repeat([1.0, self._weights.rotation_length], 3)
        error = scale * np.concatenate([measured.translation - nominal.translation, turn])
        weighted = scale[:, None] * self.jacobian(angles)
        left, levers, right = np.linalg.svd(weighted, full_matrices=False)
        least = self._weights.least_lever
        damping = 0.25 * np.maximum(least**2 - levers**2, 0.0)  # Maciejewski and Klein 1988: of small levers only
        return np.asarray(right.T @ (levers / (levers**2 + damping) * (left.T @ error)))
