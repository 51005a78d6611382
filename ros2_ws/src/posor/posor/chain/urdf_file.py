# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A robot description (URDF), read strictly: what bears on the geometry is understood, or refused by its line.

The parser of ROS and pinocchio (urdfdom) ignores what it does not know: a misspelt ``origin``, an element that xacro
should have replaced or an element of SDF becomes the identity. Elements without geometry (``visual``, ``collision``,
``inertial``, ``gazebo``, ``transmission``, ``ros2_control``, ...) may have any content.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from posor.chain.urdf_plates import (
    LARGEST_GAP,
    LARGEST_LEAN,
    Urdf,
    UrdfJoint,
    lean_of,
    links_are_plates,
    plate_names,
    rpy_text,
)
from posor.errors import ChainError, similar_name
from posor.ros_names import ROS_NAME_RULE, is_ros_name

if TYPE_CHECKING:
    from collections.abc import Collection

    from posor.numerics.array_types import FloatArray

LONGEST_LINK = 10.0  # [m]
Z_TOLERANCE = 1e-9  # largest difference of an axis from Z that is rounding
UNIT_TOLERANCE = 1e-3  # largest difference of a quaternion's length from one
JOINT_TYPES = ("fixed", "floating", "revolute", "continuous", "prismatic", "planar")
VERSIONS = ("1.0", "1.1", "1.2")
QUATERNION_VERSIONS = ("1.1", "1.2")  # an origin may have ``quat_xyzw``
ATTRIBUTES = {  # of these elements
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
}
URDF_PARTS = ("mimic", "limit", "dynamics", "calibration", "safety_controller")  # others of a joint, without children
PARTS = (*ATTRIBUTES, "mimic")  # elements of a joint that bear on geometry
# Elements of a joint that do not bear on geometry, those of simulators included
PLAIN_PARTS = frozenset(
    (
        *("limit", "dynamics", "calibration", "safety_controller", "gazebo", "transmission", "hardwareInterface"),
        *("actuator", "sensor", "physics", "joint_properties", "property", "map", "verbose", "damping", "friction"),
    )
)
GEOMETRY = ("link", "joint", "parent", "child", "origin", "axis", "pose", "xyz", "rpy", "quat_xyzw")
_ALIKE = 0.8  # similarity of a name to one of these at which the name is misspelt
_UNRESOLVED = re.compile(r"\$\{|\$\(")
_NOT_ZERO = re.compile(r"[^0 .+-]")  # what an origin of the identity does not have: links of real robots have some
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
RESOLVED = "a URDF that xacro has resolved"


@dataclass
class _Element:
    name: str
    attributes: dict[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)
    text: str = ""

    def called(self, name: str) -> list[_Element]:
        return [child for child in self.children if child.name == name]


class _Joint(NamedTuple):
    element: _Element
    name: str
    kind: str
    parent: str
    child: str


class _Reader:
    """Reads the elements of a description, and collects what is wrong with them."""

    def __init__(self, source: str) -> None:
        self.source, self.version = source, "1.0"
        self.unresolved = {"xacro"}  # prefixes of elements that a program should have replaced
        self.faults: list[ChainError] = []

    def refuse(self, what: str, line: int, expected: str) -> None:
        self.faults.append(ChainError(what, where=f"{self.source}, line {line}", expected=expected))

    def check_attributes(self, element: _Element, known: Collection[str], owner: str) -> None:
        """Refuse attributes that xacro has not resolved or that are misplaced; in parts of a joint all unknown ones."""
        strict = element.name in PARTS
        for name, value in element.attributes.items():
            prefix, _, local = name.rpartition(":")
            if _UNRESOLVED.search(value):
                self.refuse(f"{name}={quoteattr(value)} of {owner}", element.line, RESOLVED)
            elif name in known or "xmlns" in (prefix, local):
                continue
            elif local.lower() in GEOMETRY or (strict and not prefix):
                expected = similar_name(local.lower(), known, " or ".join(known))
                self.refuse(f"unknown attribute '{name}' of {owner}", element.line, expected)

    def check_child(self, element: _Element, owner: str, known: Collection[str], plain: Collection[str] | None) -> None:
        """Refuse a child element that xacro has not resolved, or that is a misspelt or misplaced one of geometry.

        ``plain``: elements that do not bear on geometry; None: all that are not similar to elements of geometry.
        """
        prefix, _, local = element.name.rpartition(":")
        if prefix in self.unresolved or local == "include":
            self.refuse(f"element '{element.name}' in {owner}", element.line, RESOLVED)
        elif element.name not in known and element.name not in (plain or ()):
            misspelt = get_close_matches(local.lower(), GEOMETRY, n=1, cutoff=_ALIKE)
            if misspelt or (plain is not None and not prefix):
                expected = similar_name(local.lower(), known, f"one of {', '.join(known)}")
                self.refuse(f"unknown element '{element.name}' in {owner}", element.line, expected)

    def is_unresolved(self, element: _Element) -> bool:
        return element.name.rpartition(":")[0] in self.unresolved

    def name_of(self, element: _Element, others: dict[str, int]) -> str:
        """Return the name of a link or joint that no other has, and note its line."""
        name = element.attributes.get("name", "")
        if not name.strip() or name != name.strip():
            self.refuse(f"{element.name} with the name '{name}'", element.line, "a name without spaces at its ends")
        elif name in others:
            self.refuse(f"duplicate {element.name} '{name}', also in line {others[name]}", element.line, "each once")
        others.setdefault(name, element.line)
        return name

    def read_links(self, robot: _Element) -> dict[str, int]:
        """Return the lines of the links by their names."""
        links: dict[str, int] = {}
        for element in robot.called("link"):
            name = self.name_of(element, links)
            owner = f"link '{name}'"
            if name.startswith("/"):
                self.refuse(owner, element.line, f"'{name.lstrip('/')}': tf2 refuses frames that begin with '/'")
            self.check_attributes(element, ("name",), owner)
            for child in element.children:
                if child.name != "origin" or _NOT_ZERO.search(" ".join(child.attributes.values())):
                    self.check_child(child, owner, ("inertial", "visual", "collision"), None)
        return links

    def read_joint(self, element: _Element, joints: dict[str, int], links: dict[str, int]) -> _Joint:
        """Return a joint with its name, type and links; empty where they are wrong."""
        name, kind = self.name_of(element, joints), element.attributes.get("type", "")
        owner = f"joint '{name}'"
        self.check_attributes(element, ("name", "type"), owner)
        if kind not in JOINT_TYPES:
            expected = similar_name(kind.lower(), JOINT_TYPES, f"one of {', '.join(JOINT_TYPES)}")
            self.refuse(f"type '{kind}' of {owner}", element.line, expected)
        ends = []
        for part in ("parent", "child"):
            own = element.called(part)
            link = own[0].attributes.get("link", "") if own else ""
            if len(own) != 1 or not link:
                self.refuse(f"{owner} has {len(own)} elements '{part}' with a link", element.line, "exactly one")
            elif link not in links:
                what = f"{owner} has the {part} '{link}', which is not a link"
                self.refuse(what, own[0].line, similar_name(link, links, f"one of {', '.join(links)}"))
            ends.append(link)
        for child in element.children:
            if self.is_unresolved(child):
                self.check_child(child, owner, PARTS, PLAIN_PARTS)
        return _Joint(element, name, kind, *ends)

    def check_parts(self, element: _Element, owner: str) -> None:
        """Refuse text in a joint, and parts of which it may have one."""
        if text := " ".join(element.text.split()):
            self.refuse(f"text '{text}' in {owner}", element.line, f"elements {', '.join(PARTS)}")
        for name in ("origin", "axis"):
            if len(found := element.called(name)) > 1:
                self.refuse(f"{owner} has {len(found)} elements '{name}'", found[1].line, "at most one")
            if not found and (name == "origin" or element.attributes.get("type") == "floating"):
                self.check_not_inside(element, name, owner)

    def check_not_inside(self, element: _Element, name: str, owner: str) -> None:
        """Refuse an element of a joint inside another one of URDF, where nobody reads it."""
        for part in element.children:
            for misplaced in part.called(name) if part.name in URDF_PARTS else ():
                what = f"{name} inside the {part.name} of {owner}"
                self.refuse(what, misplaced.line, f"'{name}' as a direct child of {owner}")

    def read_geometry(self, joint: _Joint) -> UrdfJoint:
        """Return a joint with its geometry; what is wrong is the identity."""
        element, name, kind, parent, child = joint
        owner = f"joint '{name}'"
        for part in element.children:
            if not self.is_unresolved(part):
                self.check_child(part, owner, PARTS, PLAIN_PARTS)
            if part.name in ATTRIBUTES:
                of_part = f"{part.name} of {owner}"
                known = (*ATTRIBUTES[part.name], *(("rpy",) if part.name == "axis" else ()))
                self.check_attributes(part, known, of_part)
                if part.text.strip() or part.children:
                    content = part.text.strip() or f"element '{part.children[0].name}'"
                    self.refuse(f"{content} inside the {of_part}", part.line, f"attributes {', '.join(known)}")
        self.check_parts(element, owner)
        T_parent_joint, rpy = self.read_origin(element, owner)
        axis = self.read_axis(element, owner, kind)
        if kind == "floating":
            if not is_ros_name(name):
                self.refuse(f"name of POSOR {owner}", element.line, f"{ROS_NAME_RULE}, as in a ROS namespace")
            for mimic in element.called("mimic"):
                self.refuse(f"POSOR {owner} mimics another joint", mimic.line, "no mimic: its POSOR measures it")
        return UrdfJoint(name, kind, parent, child, element.line, T_parent_joint, rpy, axis)

    def read_origin(self, joint: _Element, owner: str) -> tuple[pin.SE3, str]:
        """Return the origin of a joint, and its roll, pitch and yaw as text."""
        place = pin.SE3.Identity()
        origin = next(iter(joint.called("origin")), None)
        if origin is None:
            return place, "0 0 0"
        owner = f"the origin of {owner}"
        xyz, rpy, quaternion = (
            self.numbers(origin, *each, owner) for each in (("xyz", 3), ("rpy", 3), ("quat_xyzw", 4))
        )
        if xyz is not None:
            place.translation = xyz
            length = float(np.linalg.norm(xyz))
            if length > LONGEST_LINK:
                self.refuse(f"{owner} is {length:g} m away", origin.line, f"at most {LONGEST_LINK:g} m (millimetres?)")
        if quaternion is not None:
            if "rpy" in origin.attributes:
                self.refuse(f"{owner} has both rpy and quat_xyzw", origin.line, "one of them")
            if self.version not in QUATERNION_VERSIONS:
                expected = 'rpy, or <robot version="1.1">, from which on URDF parsers read quat_xyzw'
                self.refuse(f"{owner} has quat_xyzw in a URDF of version {self.version}", origin.line, expected)
            if not abs(np.linalg.norm(quaternion) - 1.0) <= UNIT_TOLERANCE:
                self.refuse(f"quat_xyzw of {owner} has the length {np.linalg.norm(quaternion):g}", origin.line, "1")
            else:
                place.rotation = pin.Quaternion(quaternion / np.linalg.norm(quaternion)).toRotationMatrix()
            return place, rpy_text(place.rotation)
        if rpy is None:
            return place, "0 0 0"
        if np.abs(rpy).max() > 2.0 * math.pi + UNIT_TOLERANCE:
            what = f'rpy="{origin.attributes["rpy"]}" of {owner}'
            self.refuse(what, origin.line, "angles of at most 2 pi in rad (degrees?)")
        place.rotation = pin.rpy.rpyToMatrix(rpy)
        return place, " ".join(origin.attributes["rpy"].split())

    def read_axis(self, joint: _Element, owner: str, kind: str) -> FloatArray:
        """Return the axis of a joint, Z if none is stated."""
        z = np.array([0.0, 0.0, 1.0])
        element = next(iter(joint.called("axis")), None)
        if element is None or kind != "floating":
            return z
        axis, turned = self.numbers(element, "xyz", 3, owner), self.numbers(element, "rpy", 3, owner)
        if turned is not None and turned.any():
            self.refuse(f"the axis of {owner} has rpy", element.line, "xyz only")
        if axis is None:
            if "xyz" not in element.attributes:
                self.refuse(f"the axis of {owner} has no xyz", element.line, "three numbers")
            return z
        largest = float(np.abs(axis).max())
        if largest == 0.0:
            self.refuse(f"the axis of {owner} is zero", element.line, "a direction, such as 0 0 1")
            return z
        axis = axis / largest
        axis = axis / np.linalg.norm(axis)
        return z if np.abs(axis - z).max() <= Z_TOLERANCE else axis

    def numbers(self, element: _Element, name: str, count: int, owner: str) -> FloatArray | None:
        """Return the numbers of an attribute, (count,); None: the attribute is missing or wrong."""
        text = element.attributes.get(name)
        if text is None or _UNRESOLVED.search(text):
            return None
        words = text.split()
        is_valid = len(words) == count and all(map(_NUMBER.fullmatch, words))
        numbers = np.array([float(word) for word in words]) if is_valid else np.array([math.nan])
        if np.isfinite(numbers).all():
            return numbers
        points = ", and decimal points" if "," in text else ""
        expected = f"{count} finite numbers, with spaces between{points}"
        self.refuse(f"{name}={quoteattr(text)} of {owner}", element.line, expected)
        return None

    def read_robot(self, robot: _Element, endpoint_frame: str) -> Urdf:
        """Return the links and joints of a description."""
        self.version = robot.attributes.get("version", "1.0")
        if self.version not in VERSIONS:
            self.refuse(f"version '{self.version}' of the robot", robot.line, f"one of {', '.join(VERSIONS)}")
        self.check_attributes(robot, ("name", "version"), "the robot")
        spaces = ((name.removeprefix("xmlns:"), value) for name, value in robot.attributes.items())
        self.unresolved |= {prefix for prefix, space in spaces if "xacro" in space.lower() or "XInclude" in space}
        for child in robot.children:
            self.check_child(child, "the robot", ("link", "joint"), None)
        links = self.read_links(robot)
        lines: dict[str, int] = {}
        joints = [self.read_joint(element, lines, links) for element in robot.called("joint")]
        tree = _Tree(self, links, joints)
        if self.faults:  # which joints are on the way to the endpoint is not sure: all are checked
            for joint in joints:
                self.read_geometry(joint)
            return Urdf(tuple(links), (), ())
        if endpoint_frame not in links:
            where, expected = self.source, f"one of {', '.join(links)}"
            self.faults.append(ChainError(f"has no link '{endpoint_frame}'", where=where, expected=expected))
        way = tree.way_to(endpoint_frame)
        unmeasured = [joint for joint in joints if joint.kind not in ("fixed", "floating")]
        for joint in unmeasured:
            if joint.child in way:
                what, expected = (
                    f"joint '{joint.name}' moves but is not floating",
                    "type 'floating' (a POSOR) or 'fixed'",
                )
                self.refuse(what, joint.element.line, expected)
        off = {joint.child for joint in unmeasured if joint.child not in way}
        beyond = {link for link in links if not off.isdisjoint(tree.way_to(link))}
        kept = tuple(self.read_geometry(joint) for joint in joints if joint.child not in beyond)
        for each in kept:
            self.check_plates(each, links, lines)
        left_out = tuple(joint.name for joint in joints if joint.child in beyond)
        return Urdf(tuple(link for link in links if link not in beyond), kept, left_out)

    def check_plates(self, joint: UrdfJoint, links: Collection[str], joints: Collection[str]) -> None:
        """Refuse a floating joint that needs plates whose names other links have: those are meant as its plates."""
        names = plate_names(joint)
        taken = [*(f"link '{name}'" for name in names if name in links)]
        taken += [f"joint '{name}'" for name in names if name in joints]
        if joint.kind != "floating" or not taken or links_are_plates(joint):
            return
        x, y, z = joint.axis
        distance, lean = float(np.linalg.norm(joint.T_parent_joint.translation)), lean_of(joint)
        reasons = [f"has the axis {x:g} {y:g} {z:g}"] if z != 1.0 else []
        reasons += [f"leans by {lean:.3g} rad"] if lean > LARGEST_LEAN and z == 1.0 else []
        reasons += [f"is {distance:g} m from its parent link"] if distance > LARGEST_GAP else []
        expected = f"the axis 0 0 1 and at most {LARGEST_GAP:g} m, with turn and distance in the fixed joint before it"
        self.refuse(f"joint '{joint.name}' between plates ({taken[0]}) {' and '.join(reasons)}", joint.line, expected)


class _Tree:
    """The way from the root link to each link."""

    def __init__(self, reader: _Reader, links: dict[str, int], joints: list[_Joint]) -> None:
        self.parents: dict[str, str] = {}
        for element, name, _, parent, child in joints:
            if child in self.parents:
                what = f"link '{child}' is the child of joint '{name}' and of another joint"
                reader.refuse(what, element.line, "each link the child of one joint")
            self.parents[child] = parent
        roots = [link for link in links if link not in self.parents]
        for link in roots[1:]:
            what = f"link '{link}' is not the child of a joint, nor is '{roots[0]}'"
            reader.refuse(what, links[link], "one tree with one root link")
        if not links:
            reader.refuse("there is no link", 1, "links and joints")
        elif not reader.faults:
            root = roots[0] if roots else next(iter(links))
            for element, name, _, _, child in joints:
                if self.way_to(child)[-1] != root:
                    what = f"joint '{name}' is not connected to the root link '{root}'"
                    reader.refuse(
                        what, element.line, "one tree, in which each link but the root is the child of one joint"
                    )

    def way_to(self, link: str) -> list[str]:
        """Return the links from a link back to the root, or around a cycle."""
        way = [link]
        while (parent := self.parents.get(way[-1])) is not None and parent not in way:
            way.append(parent)
        return way


def read_urdf(text: str, endpoint_frame: str, source: str) -> tuple[Urdf, list[ChainError]]:
    """Return the content of a description, and all that is wrong with it.

    ``text``: XML; ``endpoint_frame``: link of the endpoint; ``source``: name of the file in errors. Where something is
    wrong, the content is incomplete.
    """
    reader = _Reader(source)
    try:
        robot = _parse_xml(text, source)
    except expat.ExpatError as error:
        what, expected = f"is not XML: {error}", "a robot description (URDF)"
        return Urdf((), (), ()), [ChainError(what, where=source, expected=expected)]
    except ChainError as error:
        return Urdf((), (), ()), [error]
    if robot.name != "robot":
        reader.refuse(f"is not a URDF: its root element is '{robot.name}'", robot.line, "'robot'")
        return Urdf((), (), ()), reader.faults
    return reader.read_robot(robot, endpoint_frame), reader.faults


def _parse_xml(text: str, source: str) -> _Element:
    """Return the root element; names keep their prefixes, as in the parser of ROS, which knows no entities either."""
    parser, opened = expat.ParserCreate(), [_Element("", {}, 0)]

    def start(name: str, attributes: dict[str, str]) -> None:
        element = _Element(name, attributes, parser.CurrentLineNumber)
        opened[-1].children.append(element)
        opened.append(element)

    def add_text(part: str) -> None:
        opened[-1].text += part

    def refuse_definitions(name: str, *_: object) -> None:
        where = f"{source}, line {parser.CurrentLineNumber}"
        raise ChainError(f"has <!DOCTYPE {name}>", where=where, expected="no document type: URDF has no entities")

    parser.StartElementHandler, parser.CharacterDataHandler = start, add_text
    parser.StartDoctypeDeclHandler = refuse_definitions
    parser.EndElementHandler = lambda _: opened.pop()
    parser.Parse(text, True)  # noqa: FBT003  expat takes no keywords
    return opened[0].children[0]
