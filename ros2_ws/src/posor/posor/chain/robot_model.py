# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An arm's URDF as a pinocchio model in which every POSOR and every uncertain beam is a floating joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import pinocchio as pin

from posor.chain.urdf_plates import model_text
from posor.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.urdf_plates import Urdf


class FixedTransform(NamedTuple):
    """A fixed joint of the URDF: its child link in its parent link."""

    parent: str
    child: str
    T_parent_child: pin.SE3


@dataclass(frozen=True)
class FreeJoint:
    """A floating joint of the model."""

    name: str  # of the joint
    parent: str  # link that it starts from
    child: str  # link that moves with it
    index: int  # of the joint in the model
    T_parent_joint: pin.SE3  # the joint's origin, in its parent link
    T_before_parent: pin.SE3  # the parent link in the joint before, or in the base


class RobotModel:
    """A pinocchio model with the data of its floating joints.

    Attributes:
        model: The model; ``createData`` gives a workspace for it.
        base_frame: The URDF's root link.
        endpoint: Index of the endpoint's frame.
        endpoint_joint: Index of the joint that the endpoint's link moves with.
        T_joint_endpoint: The endpoint in that joint.
        joints: The floating joints of the URDF, the POSORs.
        freed: The fixed joints that were converted to floating joints, in the given order.

    """

    def __init__(self, urdf: Urdf, endpoint_frame: str, freed: Sequence[str], source: str) -> None:
        """Build the model.

        ``endpoint_frame``: link of the endpoint; ``freed``: names of fixed joints to convert to floating joints,
        because they are not exact; ``source``: name of the URDF in errors. Raises ChainError: the URDF is not an arm of
        POSORs.
        """
        self.model: pin.Model = pin.buildModelFromXML(model_text(urdf, freed))
        self.base_frame: str = self._links(0)[0]
        self.endpoint = self.model.getFrameId(endpoint_frame, pin.FrameType.BODY)
        joints = [self._free_joint(index) for index in range(1, self.model.njoints)]
        by_name = {joint.name: joint for joint in joints}
        self.freed = tuple(by_name[name] for name in freed)
        self.joints = tuple(joint for joint in joints if joint.name not in freed)
        if not self.joints:
            raise ChainError("has no POSOR joint", where=source, expected="at least one joint of type 'floating'")
        frame = self.model.frames[self.endpoint]
        self.endpoint_joint: int = frame.parentJoint
        self.T_joint_endpoint: pin.SE3 = frame.placement.copy()
        moving = {joint.index for joint in self.joints}
        if moving.isdisjoint(self.path()):
            moved = [name for index in range(1, self.model.njoints) for name in self._links(index)]
            raise ChainError(
                f"no POSOR joint moves link '{endpoint_frame}'", where=source, expected=f"one of {', '.join(moved)}"
            )

    def path(self) -> list[int]:
        """Return the indices of the joints from the base to the endpoint."""
        found: list[int] = []
        index = self.endpoint_joint
        while index > 0:
            found.append(index)
            index = self.model.parents[index]
        return found[::-1]

    def fixed_transforms(self) -> list[FixedTransform]:
        """Return the fixed joints that were not converted, on the way to the endpoint or not."""
        frames, found = self.model.frames, []
        for link in frames:
            joint = frames[link.parentFrame]
            is_link = link.type == pin.FrameType.BODY and link.name != self.base_frame
            if is_link and joint.type == pin.FrameType.FIXED_JOINT:
                parent = frames[joint.parentFrame]
                T_parent_child = parent.placement.inverse() * link.placement
                found.append(FixedTransform(parent.name, link.name, T_parent_child))
        return found

    def _links(self, joint: int) -> list[str]:
        """Return the links that move with a joint, the nearest first."""
        frames = self.model.frames
        return [f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint == joint]

    def _free_joint(self, index: int) -> FreeJoint:
        name = self.model.names[index]
        frame = self.model.frames[self.model.getFrameId(name, pin.FrameType.JOINT)]
        parent = self.model.frames[frame.parentFrame]
        while parent.type != pin.FrameType.BODY:
            parent = self.model.frames[parent.parentFrame]
        T_before_parent = parent.placement.copy()
        T_parent_joint = T_before_parent.inverse() * self.model.jointPlacements[index]
        return FreeJoint(name, parent.name, self._links(index)[0], index, T_parent_joint, T_before_parent)
