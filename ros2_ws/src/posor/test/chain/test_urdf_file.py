# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math
import random
import re
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.kinematic_chain import Chain
from posor.chain.urdf_file import read_urdf
from posor.chain.urdf_plates import rotation_to
from posor.errors import ChainError
from posor_lab.harness.case_tables import cases, edited, refusal

ONE_JOINT = Path(__file__).with_name("one_joint.urdf").read_text(encoding="utf-8")
GRIPPER = """
  <link name="palm"/><link name="finger" ><visual><origin xyz="0 0 0.01"/></visual></link><link name="thumb"/>
  <joint name="hand" type="fixed"><parent link="tip"/><child link="palm"/><origin xyz="0 0 0.05"/></joint>
  <joint name="grip" type="prismatic"><parent link="palm"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
  <joint name="thumb-1" type="prismatic"><parent link="palm"/><child link="thumb"/><axis xyz="0 -1 0"/>
    <mimic joint="grip"/></joint>
</robot>"""
WITHOUT_GEOMETRY = """
  <material name="grey"><color rgba="1 1 1 1"/></material>
  <gazebo reference="tip"><plugin name="p" filename="$(find x)/p.so"><pose>0 0 1 0 0 0</pose></plugin></gazebo>
  <transmission name="t"><joint name="wrist"><hardwareInterface>x</hardwareInterface></joint></transmission>
  <ros2_control name="c" type="system"><joint name="wrist"><param name="offset">1</param></joint></ros2_control>
  <drake:declare_convex xmlns:drake="d"/><mujoco><compiler meshdir="m"/></mujoco>
</robot>"""
ANGLES = ("shoulder", "elbow", "wrist")
Triple: TypeAlias = tuple[float, float, float]
PI, HALF = math.pi, math.pi / 2.0
# Joints of robots by their makers' dimensions: origin xyz [m] and rpy [rad], and axis; then the tool.
ROBOTS: dict[str, tuple[list[tuple[Triple, Triple, Triple]], tuple[Triple, Triple]]] = {
    "ur5": (
        [
            ((0, 0, 0.089159), (0, 0, 0), (0, 0, 1)),
            ((0, 0.13585, 0), (0, HALF, 0), (0, 1, 0)),
            ((0, -0.1197, 0.425), (0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.39225), (0, HALF, 0), (0, 1, 0)),
            ((0, 0.093, 0), (0, 0, 0), (0, 0, 1)),
            ((0, 0, 0.09465), (0, 0, 0), (0, 1, 0)),
        ],
        ((0, 0.0823, 0), (0, 0, HALF)),
    ),
    "iiwa7": (
        [
            ((0, 0, 0.15), (0, 0, 0), (0, 0, 1)),
            ((0, 0, 0.19), (HALF, 0, PI), (0, 0, 1)),
            ((0, 0.21, 0), (HALF, 0, PI), (0, 0, 1)),
            ((0, 0, 0.19), (HALF, 0, 0), (0, 0, 1)),
            ((0, 0.21, 0), (-HALF, PI, 0), (0, 0, 1)),
            ((0, 0.0607, 0.19), (HALF, 0, 0), (0, 0, 1)),
            ((0, 0.081, 0.0607), (-HALF, PI, 0), (0, 0, 1)),
        ],
        ((0, 0, 0.045), (0, 0, 0)),
    ),
    "irb120": (
        [
            ((0, 0, 0), (0, 0, 0), (0, 0, 1)),
            ((0, 0, 0.29), (0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.27), (0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.07), (0, 0, 0), (1, 0, 0)),
            ((0.302, 0, 0), (0, 0, 0), (0, 1, 0)),
            ((0.072, 0, 0), (0, 0, 0), (1, 0, 0)),
        ],
        ((0, 0, 0), (0, HALF, 0)),
    ),
    "scara": (
        [
            ((0, 0, 0.387), (0, 0, 0), (0, 0, 1)),
            ((0.325, 0, 0), (0, 0, 0), (0, 0, 2)),
            ((0.275, 0, -0.21), (0, 0, 0), (0, 0, -1)),
        ],
        ((0, 0, -0.05), (PI, 0, 0)),
    ),
}


def robot_urdf(name: str, joint_type: str) -> str:
    joints, (xyz, rpy) = ROBOTS[name]
    rows = [(f"j{n}", joint_type, f"l{n}", f"l{n + 1}", *joint) for n, joint in enumerate(joints)]
    rows.append(("tool", "fixed", f"l{len(joints)}", "endpoint", xyz, rpy, (0, 0, 1)))
    text = [f'<link name="{link}"/>' for link in (*(f"l{n}" for n in range(len(joints) + 1)), "endpoint")]
    for joint, kind, parent, child, *geometry in rows:
        origin, angles, axis = (" ".join(map(str, each)) for each in geometry)
        text.append(
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{origin}" rpy="{angles}"/><axis xyz="{axis}"/>'
            '<limit lower="-7" upper="7" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="{name}">{"".join(text)}</robot>'


@pytest.mark.parametrize("name", ROBOTS)
def test_the_arm_of_a_usual_robot_is_where_pinocchio_has_the_robot(name: str, rng: np.random.Generator) -> None:
    """Nominal endpoint, measured endpoint and measured angles, against the URDF with revolute joints."""
    chain = Chain(robot_urdf(name, "floating"), "endpoint")
    model = pin.buildModelFromXML(robot_urdf(name, "revolute"))
    data, estimator = model.createData(), chain.estimator()
    names = [joint.name for joint in chain.joints]
    estimator.covariances_random[:] = 1e-12 * np.eye(6)
    for _ in range(20):
        angles = rng.uniform(-3.1, 3.1, len(names))
        pin.framesForwardKinematics(model, data, angles)
        expected = data.oMf[model.getFrameId("endpoint", pin.FrameType.BODY)]
        found = chain.nominal_endpoint(dict(zip(names, angles, strict=True)))
        np.testing.assert_allclose(found.homogeneous, expected.homogeneous, rtol=0.0, atol=1e-12)
        for row, joint, angle in zip(estimator.poses, names, angles, strict=True):
            row[:] = pin.SE3ToXYZQUAT(chain.nominal_joint(joint, angle))
        assert estimator.estimate()
        measured = pin.XYZQUATToSE3(estimator.pose)
        np.testing.assert_allclose(measured.homogeneous, expected.homogeneous, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(estimator.angles, angles, rtol=0.0, atol=1e-12)
    links = model.nframes  # every link of the robot has its place in the tree of frames
    frames = {frame for each in chain.fixed_transforms for frame in (each.parent, each.child)}
    frames |= {frame for joint in chain.joints for frame in (joint.parent, joint.child)}
    assert {model.frames[n].name for n in range(links) if model.frames[n].type == pin.FrameType.BODY} <= frames


def test_plates_are_inserted_where_the_links_cannot_be_plates() -> None:
    def ends(urdf: str) -> tuple[str, str]:
        (joint,) = Chain(urdf, "tip").joints
        return joint.parent, joint.child

    inserted = "wrist_receiving", "wrist_target"
    for part, expected in [
        ('<axis xyz="0 0 5"/>', ("plate_r", "plate_t")),
        ('<origin xyz="0 0 0.01" rpy="0 0.1 3"/>', ("plate_r", "plate_t")),
        ('<origin xyz="0 0 0.03"/>', inserted),
        ('<origin rpy="1 0 0"/>', inserted),
        ('<axis xyz="0 1e-3 1"/>', inserted),
        ('<axis xyz="0 0 -1e-9"/>', inserted),
    ]:
        assert ends(edited(ONE_JOINT, '<child link="plate_t"/>', f'<child link="plate_t"/>{part}')) == expected


def test_an_axis_has_a_rotation_from_z(rng: np.random.Generator) -> None:
    axes = [*np.eye(3), *-np.eye(3), *(rng.normal(size=(50, 3))), *(rng.normal(size=(9, 3)) * 1e-9 - [0, 0, 1])]
    for axis in axes:
        unit = axis / np.linalg.norm(axis)
        turn = rotation_to(unit)
        np.testing.assert_allclose(turn[:, 2], unit, rtol=0.0, atol=3e-16)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), rtol=0.0, atol=1e-15)
        assert np.linalg.det(turn) > 0.0
        if np.count_nonzero(unit) == 1:
            assert set(np.abs(turn).ravel()) == {0.0, 1.0}


@pytest.mark.parametrize(**cases(__file__, "urdf_mistakes.yaml"))
def test_a_mistake_is_refused_with_its_line(
    old: str, new: str, also: tuple[str, str] | None, line: int, sentence: str
) -> None:
    text = edited(ONE_JOINT, old, new)
    text = text.replace(*also) if also else text
    error, *_ = read_urdf(text, "tip", "arm.urdf")[1]
    assert error.where == f"arm.urdf, line {line}"
    assert f"arm.urdf, line {line}: {sentence}" in str(error)


def test_all_mistakes_are_found() -> None:
    text = edited(ONE_JOINT, 'link="tip"/><origin xyz="0.5', 'link="tip"/><orgin xyz="0.5')
    text = edited(edited(text, '"wrist"', '"wrist-1"'), 'xyz="0 0 1"', 'xyz="0 0"')
    faults = read_urdf(text, "tip", "arm.urdf")[1]
    assert [fault.where for fault in faults] == [f"arm.urdf, line {line}" for line in (3, 4, 5)]
    assert refusal(ChainError, Chain, text, "tip").what.endswith("(and 2 more)")


def test_what_bears_on_no_geometry_is_accepted() -> None:
    text = edited(ONE_JOINT, "</robot>", WITHOUT_GEOMETRY)
    text = edited(text, "<robot", '<robot xmlns="urdf" xmlns:joint="slider" xmlns:xacro="http://ros.org/wiki/xacro"')
    unread = '<limit/><dynamics damping="1"><axis xyz="0 1 0"/></dynamics><drake:damping/>'  # the joint is fixed
    text = edited(text, '<child link="tip"/>', f'<child link="tip"/>{unread}')
    simulated = '<gazebo><sensor><origin xyz="0 0 1"/></sensor></gazebo>'
    text = edited(text, '<child link="plate_t"/>', f'<child link="plate_t"/>{simulated}')
    text = edited(text, '<link name="tip"/>', '<link name="tip"><origin xyz="0 0 0" rpy="0 -0 0.0"/></link>')
    text = edited(text, '"fixed"', '"fixed" dont_collapse="true"')
    assert read_urdf(text, "tip", "")[1] == []
    plain = Chain(ONE_JOINT, "tip").nominal_endpoint({"wrist": 0.3})
    assert Chain(text, "tip").nominal_endpoint({"wrist": 0.3}) == plain


def test_a_quaternion_is_read_from_version_1_1_on() -> None:
    turned = edited(ONE_JOINT, 'xyz="0 0 1" rpy="0 0 0"', 'xyz="0 0 1" quat_xyzw="0 0.6 0 0.8"')
    found = Chain(edited(turned, "<robot", '<robot version="1.1"'), "tip").nominal_endpoint({"wrist": 0.3})
    expected = pin.Quaternion(0.8, 0.0, 0.6, 0.0).toRotationMatrix() @ pin.utils.rotate("z", 0.3)
    np.testing.assert_allclose(found.rotation, expected, rtol=0.0, atol=1e-15)


def test_joints_beyond_the_endpoint_are_left_out() -> None:
    chain = Chain(edited(ONE_JOINT, "</robot>", GRIPPER), "tip")
    assert chain.left_out == ("grip", "thumb-1")
    assert [joint.name for joint in chain.joints] == ["wrist"]
    assert [each.child for each in chain.fixed_transforms] == ["plate_r", "tip", "palm"]
    error = refusal(ChainError, Chain, edited(ONE_JOINT, "</robot>", GRIPPER), "finger", source="arm.urdf")
    assert error.where == "arm.urdf, line 9"
    assert error.what == "joint 'grip' moves but is not floating"


def test_a_damaged_name_is_refused_or_changes_nothing() -> None:
    """One letter of the name of an element or attribute is doubled, left out, or changed."""
    text = Path(__file__).with_name("three_joints.urdf").read_text(encoding="utf-8")
    text = edited(text, '<child link="t1"/>', '<child link="t1"/><axis xyz="1 0 0"/>')
    places = [n for found in re.finditer(r"(?:<| )(\w+)[ =]", text) for n in range(*found.span(1))]
    chance, expected = random.Random(41), Chain(text, "tip").nominal_endpoint(dict.fromkeys(ANGLES, 0.4))  # noqa: S311
    refused = 0
    for _ in range(400):
        place = chance.choice(places)
        letter = text[place]
        new = chance.choice(["", 2 * letter, letter.swapcase(), chance.choice("abcxyz")])
        damaged = text[:place] + new + text[place + 1 :]
        if read_urdf(damaged, "tip", "")[1]:
            refused += 1
        else:
            assert Chain(damaged, "tip").nominal_endpoint(dict.fromkeys(ANGLES, 0.4)) == expected, damaged
    assert refused > 250
