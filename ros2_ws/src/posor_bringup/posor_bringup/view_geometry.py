# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Geometry of the live page: links and bodies of an arm, its poses as measured and by the encoders, their difference.

The nominal arm has joints without error motions at the encoders' angles, and straight beams. A joint without an encoder
has its measured angle there. The difference is enlarged joint by joint, so that the drawn arm stays connected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray

    from posor_bringup.view_observation import ArmScan, EndpointView

DEFAULT_COLOUR = (0.6, 0.6, 0.6)


class Body(NamedTuple):
    """A body of a link."""

    link: str  # of the URDF
    shape: str  # ``cylinder``, ``box`` or ``sphere``
    size: tuple[float, ...]  # radius and length; the three edges; the radius [m]
    T_link_body: pin.SE3  # its pose
    colour: tuple[float, ...]  # red, green, blue, 0 to 1


@dataclass(frozen=True)
class DrawnArm:
    """An arm at one time."""

    nominal: Sequence[pin.SE3]  # child link in parent link of each joint and beam, by the encoders
    measured: Sequence[pin.SE3]  # the same as measured; nominal where that is not known
    unknown: frozenset[str]  # links whose pose is not known: beyond a joint without a usable transform
    deviation: FloatArray
    """Measured endpoint relative to the endpoint by the encoders, (6,): translation [m], rotation vector [rad], in axes
    of the base; NaN: not known."""


class ArmGeometry:
    """Links of an arm and their poses.

    Attributes:
        base: The root link.
        endpoint: The link of the endpoint.
        joints: Names of the joints, in the order of the chain.
        ends: Parent and child link of each joint, then of each beam.
        fixed: Parent link, child link and pose of each fixed joint.
        bodies: Of all links that the chain does not leave out.
        links: All links that the chain does not leave out.

    """

    def __init__(self, arm: ArmFile) -> None:
        """Read the arm's URDF and beams.

        Raises ChainError: the URDF is invalid; CalibrationError: the beams file is invalid.
        """
        self._chain = arm.chain()
        self._estimator = self._chain.estimator()
        self.base, self.endpoint = self._chain.base_frame, arm.endpoint_frame
        self.joints = tuple(joint.name for joint in self._chain.joints)
        self.ends = [(each.parent, each.child) for each in (*self._chain.joints, *self._chain.beam_joints)]
        self.fixed = self._chain.fixed_transforms
        links = {self.base, *(child for _, child in self.ends), *(each.child for each in self.fixed)}
        self.bodies = [body for body in _bodies(self._chain.urdf) if body.link in links]  # without those left out
        self.at_zero = self._nominal(np.zeros(len(self.joints)))
        self._paths = {link: self.path(link).split("/") for link in links}
        self.links = frozenset(links)

    def draw(self, scan: ArmScan, endpoint: EndpointView) -> DrawnArm:
        """Return the arm of a scan."""
        estimator = self._estimator
        estimator.poses[:], estimator.thetas[:] = scan.poses, scan.thetas
        estimator.covariances_random[:] = scan.covariances_random
        estimator.covariances_systematic[:] = scan.covariances_systematic
        has_pose = estimator.estimate()
        angles = np.where(np.isnan(scan.encoders), estimator.angles, scan.encoders)
        nominal = self._nominal(np.nan_to_num(angles))
        if not has_pose:
            measured, lost = list(nominal), set()
            for number, pose in enumerate(scan.poses):
                if np.isfinite(pose).all():
                    measured[number] = pin.XYZQUATToSE3(pose)
                else:
                    lost.add(self.ends[number][1])
            unknown = {link for link, path in self._paths.items() if lost.intersection(path)}
            return DrawnArm(nominal, measured, frozenset(unknown) or self.links, np.full(6, np.nan))
        measured = [pin.XYZQUATToSE3(pose) for pose in (*estimator.poses, *estimator.beam_transforms)]
        # The published pose knows the accelerations of the beams too; with ``reference: home`` it is not in the base.
        is_same = endpoint.stamp_ns == scan.stamp_ns and endpoint.frame == self.base
        pose = endpoint.pose if is_same and np.isfinite(endpoint.pose).all() else estimator.pose
        T_base_endpoint = pin.XYZQUATToSE3(pose)
        T_nominal = self.place(self.endpoint, nominal)
        turn = pin.log3(T_base_endpoint.rotation @ T_nominal.rotation.T)
        deviation = np.concatenate([T_base_endpoint.translation - T_nominal.translation, turn])
        return DrawnArm(nominal, measured, frozenset(), deviation)

    def place(self, link: str, transforms: Sequence[pin.SE3]) -> pin.SE3:
        """Return the pose of a link in the base, from the poses of joints and beams."""
        parents = {child: (parent, T) for (parent, child), T in zip(self.ends, transforms, strict=True)}
        parents |= {each.child: (each.parent, each.T_parent_child) for each in self.fixed}
        pose = pin.SE3.Identity()
        while link != self.base:
            link, T_parent_link = parents[link]
            pose = T_parent_link * pose
        return pose

    def path(self, link: str) -> str:
        """Return a link as a path of links from the base, for example ``base/plate/arm``."""
        parents = {child: parent for parent, child in (*self.ends, *((each.parent, each.child) for each in self.fixed))}
        names = [link]
        while names[-1] in parents:
            names.append(parents[names[-1]])
        return "/".join(reversed(names))

    def _nominal(self, angles: FloatArray) -> list[pin.SE3]:
        joints = [self._chain.nominal_joint(name, angle) for name, angle in zip(self.joints, angles, strict=True)]
        return [*joints, *(beam.T_parent_joint for beam in self._chain.beam_joints)]


def enlarge(nominal: Sequence[pin.SE3], measured: Sequence[pin.SE3], factor: float) -> list[pin.SE3]:
    """Return the nominal transforms with their deviations from the measured ones enlarged."""
    return [
        T_nominal * pin.exp6(factor * pin.log6(T_nominal.inverse() * T_measured))
        for T_nominal, T_measured in zip(nominal, measured, strict=True)
    ]


def ellipsoid(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return half axes of two sigma [m], (3,), and the rotation of a position covariance, (3, 3)."""
    variances, axes = np.linalg.eigh(covariance)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return 2.0 * np.sqrt(np.maximum(variances, 0.0)), axes


def _bodies(urdf: str) -> Iterator[Body]:
    """Yield the cylinders, boxes and spheres of a URDF; meshes are not drawn."""
    root = ET.fromstring(urdf)  # noqa: S314  the chain has parsed the same text
    colours = {each.get("name"): _colour(each) for each in root.findall("material")}
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            shape = next(iter(visual.find("geometry") or ()), None)
            if shape is None or shape.tag not in ("cylinder", "box", "sphere"):
                continue
            keys = {"cylinder": ("radius", "length"), "box": ("size",), "sphere": ("radius",)}[shape.tag]
            size = tuple(number for key in keys for number in _numbers(shape.get(key, "")))
            origin = visual.find("origin")
            place = {} if origin is None else origin.attrib
            xyz, rpy = (np.array(_numbers(place.get(key, "0 0 0"))) for key in ("xyz", "rpy"))
            material = visual.find("material")
            colour = None if material is None else _colour(material) or colours.get(material.get("name"))
            T_link_body = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
            yield Body(link.get("name", ""), shape.tag, size, T_link_body, colour or DEFAULT_COLOUR)


def _colour(material: ET.Element) -> tuple[float, ...] | None:
    colour = material.find("color")
    return None if colour is None else _numbers(colour.get("rgba", ""))[:3]


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in text.split())
