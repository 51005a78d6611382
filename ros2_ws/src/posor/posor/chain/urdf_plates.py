# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joints of a robot description as POSOR measures them, and the text of the model that pinocchio reads.

A POSOR turns about Z of both of its plates. The links of a floating joint are its plates, unless the joint cannot turn
about their Z axes (its ``axis`` is not Z, or its origin leans by more than ``LARGEST_LEAN``), or its origin is further
than ``LARGEST_GAP`` from its parent link, as in the description of a usual robot. Then the POSOR is where the joint is:
the plates ``<joint>_receiving`` and ``<joint>_target`` are inserted, both at the joint's origin with Z along its axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from posor.numerics.array_types import FloatArray

LARGEST_GAP = 0.02  # largest distance of a floating joint's origin from its parent link, if its links are plates [m]
LARGEST_LEAN = math.pi / 4.0  # largest lean of the axis of a floating joint in its parent link, likewise [rad]


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the description."""

    name: str
    kind: str  # ``type`` of the URDF
    parent: str  # link
    child: str  # link
    line: int  # of the file
    T_parent_joint: pin.SE3  # its origin
    rpy: str  # roll, pitch, yaw of the origin [rad], as in the file where they are there
    axis: FloatArray  # unit vector in the axes of the origin, (3,)


class Urdf(NamedTuple):
    """Links and joints of a description, as far as they can bear on the endpoint."""

    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    left_out: tuple[str, ...]  # names of moving joints off the way to the endpoint, and of all joints beyond them


def links_are_plates(joint: UrdfJoint) -> bool:
    """Return whether the links of a floating joint can be the plates of its POSOR, see above."""
    near = np.linalg.norm(joint.T_parent_joint.translation) <= LARGEST_GAP
    return bool(near and joint.axis[2] == 1.0 and lean_of(joint) <= LARGEST_LEAN)


def lean_of(joint: UrdfJoint) -> float:
    """Return the angle between the joint's axis and Z of its parent link [rad]."""
    x, y, z = joint.T_parent_joint.rotation @ joint.axis
    return math.atan2(math.hypot(x, y), z)


def plate_names(joint: UrdfJoint) -> tuple[str, str]:
    """Return the names of the plates that a floating joint gets if its links are not its plates."""
    return f"{joint.name}_receiving", f"{joint.name}_target"


def model_text(urdf: Urdf, freed: Collection[str]) -> str:
    """Return the description of the model: links and joints only, with the plates of all POSORs.

    ``freed``: names of fixed joints that become floating joints.
    """
    return f'<robot name="arm">{"".join(_model_parts(urdf, freed))}</robot>'


def _model_parts(urdf: Urdf, freed: Collection[str]) -> Iterator[str]:
    for link in urdf.links:
        yield f"<link name={quoteattr(link)}/>"
    for joint in urdf.joints:
        name, T, parent, child = joint.name, joint.T_parent_joint, joint.parent, joint.child
        kind = "floating" if name in freed else joint.kind
        if joint.kind == "fixed" or links_are_plates(joint):
            yield _joint_text(name, kind, parent, child, T.translation, joint.rpy)
            continue
        receiving, target = plate_names(joint)
        turn = rotation_to(joint.axis)
        yield f"<link name={quoteattr(receiving)}/><link name={quoteattr(target)}/>"
        yield _joint_text(receiving, "fixed", parent, receiving, T.translation, rpy_text(T.rotation @ turn))
        yield _joint_text(name, kind, receiving, target, np.zeros(3), "0 0 0")
        yield _joint_text(target, "fixed", target, child, np.zeros(3), rpy_text(turn.T))


def _joint_text(name: str, kind: str, parent: str, child: str, xyz: FloatArray, rpy: str) -> str:
    ends = f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>"
    origin = f'<origin xyz="{" ".join(map(repr, xyz.tolist()))}" rpy="{rpy}"/>'
    return f"<joint name={quoteattr(name)} type={quoteattr(kind)}>{ends}{origin}</joint>"


def rotation_to(axis: FloatArray) -> FloatArray:
    """Return a rotation, (3, 3), that turns Z to a unit vector, exact for axes along X, Y and Z."""
    flip = np.diag([1.0, -1.0, -1.0]) if axis[2] < 0.0 else np.eye(3)  # Z to the same side
    start = flip[:, 2]
    across = pin.skew(np.cross(start, axis))
    turned: FloatArray = (np.eye(3) + across + across @ across / (1.0 + start @ axis)) @ flip
    return turned


def rpy_text(rotation: FloatArray) -> str:
    """Return roll, pitch and yaw [rad] of a rotation; their rotation is the same also near a pitch of 90 degrees."""
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    back = pin.utils.rotate("z", -yaw) @ rotation
    roll = math.atan2(-back[1, 2], back[1, 1])
    pitch = math.atan2(-back[2, 0], back[0, 0])
    return f"{roll!r} {pitch!r} {yaw!r}"
