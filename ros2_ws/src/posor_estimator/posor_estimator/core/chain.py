"""The kinematic chain: measuring beams as links, POSORs as floating joints, the endpoint as a frame of the last link.

Pinocchio reads the URDF, does the forward kinematics and gives the Jacobian that carries each joint's covariance to the
endpoint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from posor_estimator.core.quiet import caught_output
from posor_estimator.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class MeasuredJoint:
    """One POSOR's measurement.

    Attributes:
        T_parent_child: Pose of the target plate in the receiving plate.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the parent (as ``posor_msgs/JointTransform``).

    """

    T_parent_child: pin.SE3
    covariance: FloatArray


@dataclass(frozen=True)
class Endpoint:
    """The endpoint in the chain's base frame.

    Attributes:
        T_base_endpoint: Its pose.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad], axes of the base frame, the small turn applied on the
            base's side at the endpoint (ROS order, REP-103).

    """

    T_base_endpoint: pin.SE3
    covariance: FloatArray

    def relative_to(self, home: Endpoint) -> Endpoint:
        """Return this endpoint in the axes of the endpoint at home; home counts as exact."""
        back = home.T_base_endpoint.inverse()
        turn = np.kron(np.eye(2), back.rotation)
        return Endpoint(back * self.T_base_endpoint, turn @ self.covariance @ turn.T)


@dataclass(frozen=True)
class PosorJoint:
    """A floating joint of the URDF: ``name``, the links it joins, and where its six numbers stand in the model."""

    name: str
    parent: str
    child: str
    index: int
    T_parent_joint: pin.SE3


class Chain:
    """A URDF whose floating joints are measured by POSORs."""

    def __init__(self, urdf: str, endpoint_frame: str, *, source: str = "the URDF") -> None:
        """Build the chain.

        Args:
            urdf: The robot description (XML text).
            endpoint_frame: Link whose pose is wanted.
            source: What to call the URDF in complaints, such as its file name.

        Raises:
            ChainError: The URDF cannot be read, has no floating joint, a moving joint of another type, or no such link.

        """
        try:
            ET.fromstring(urdf)  # noqa: S314  only to say where it is malformed; urdfdom then reads it
        except ET.ParseError as error:
            raise ChainError(f"is not XML: {error}", where=source, expected="a robot description (URDF)") from error
        with caught_output() as printed:
            try:
                self._model = pin.buildModelFromXML(urdf)
            except (ValueError, RuntimeError) as error:
                self._model = None
                failure = error
        if self._model is None:
            said = " ".join(line.strip() for line in printed if line.strip() and " at line " not in line)
            reason = (said.removeprefix("Error:").strip() or str(failure)).rstrip(". ")
            raise ChainError(f"cannot be read as a robot description: {reason}", where=source) from failure
        self._data = self._model.createData()
        self.base_frame: str = self._links(0)[0]
        if not self._model.existBodyName(endpoint_frame):
            raise ChainError(
                f"has no link '{endpoint_frame}'", where=source, expected=f"one of {', '.join(self._all_links())}"
            )
        self._endpoint = self._model.getFrameId(endpoint_frame, pin.FrameType.BODY)
        self.joints = tuple(self._posor_joint(index, source) for index in range(1, self._model.njoints))
        if not self.joints:
            raise ChainError("has no POSOR joint", where=source, expected="at least one joint of type 'floating'")
        if self._model.frames[self._endpoint].parentJoint == 0:
            moved = [name for joint in self.joints for name in self._links(joint.index)]
            raise ChainError(
                f"no POSOR joint moves link '{endpoint_frame}'", where=source, expected=f"one of {', '.join(moved)}"
            )

    def _all_links(self) -> list[str]:
        return [frame.name for frame in self._model.frames if frame.type == pin.FrameType.BODY]

    def _links(self, joint: int) -> list[str]:
        """Return the links that move with a joint, the one nearest to it first."""
        frames = self._model.frames
        return [f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint == joint]

    def _posor_joint(self, index: int, source: str) -> PosorJoint:
        joint = self._model.joints[index]
        name = self._model.names[index]
        if joint.shortname() != "JointModelFreeFlyer":
            raise ChainError(
                f"joint '{name}' moves but is not floating",
                where=source,
                expected="type 'floating' (a POSOR) or 'fixed'",
            )
        frame = self._model.frames[self._model.getFrameId(name, pin.FrameType.JOINT)]
        parent = self._model.frames[frame.parentFrame]
        while parent.type != pin.FrameType.BODY:
            parent = self._model.frames[parent.parentFrame]
        T_parent_joint = parent.placement.inverse() * self._model.jointPlacements[index]
        return PosorJoint(name, parent.name, self._links(index)[0], index, T_parent_joint)

    def joint_between(self, parent: str, child: str) -> PosorJoint:
        """Return the floating joint between two links.

        Raises:
            ChainError: There is none.

        """
        for joint in self.joints:
            if (joint.parent, joint.child) == (parent, child):
                return joint
        known = ", ".join(f"{joint.parent} -> {joint.child}" for joint in self.joints)
        raise ChainError(
            f"no floating joint from '{parent}' to '{child}'", where="the URDF", expected=f"one of {known}"
        )

    def endpoint(self, measured: Mapping[str, MeasuredJoint]) -> Endpoint:
        """Return the endpoint's pose and covariance.

        Args:
            measured: One measurement for each floating joint, by joint name. Joints are taken as independent.

        """
        q = pin.neutral(self._model)
        covariance = np.zeros((self._model.nv, self._model.nv))
        for joint in self.joints:
            reading = measured[joint.name]
            start = self._model.joints[joint.index].idx_q
            q[start : start + 7] = pin.SE3ToXYZQUAT(joint.T_parent_joint.inverse() * reading.T_parent_child)
            start = self._model.joints[joint.index].idx_v
            to_local = np.kron(np.eye(2), reading.T_parent_child.rotation.T)
            covariance[start : start + 6, start : start + 6] = to_local @ reading.covariance @ to_local.T
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, q, self._endpoint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pose = pin.updateFramePlacement(self._model, self._data, self._endpoint)
        return Endpoint(pin.SE3(pose), jacobian @ covariance @ jacobian.T)
