# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.forward_kinematics import Endpoints
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain, load_chain
from posor.errors import ChainError
from posor.input_text import MAX_BYTES
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.array_types import FloatArray
from posor_lab.harness.case_tables import edited, refusal
from scipy.spatial.transform import Rotation

SOURCE = "arm.urdf"

ONE_JOINT, THREE_JOINTS = (
    Path(__file__).with_name(f"{name}.urdf").read_text(encoding="utf-8") for name in ("one_joint", "three_joints")
)
JOINTS = ("shoulder", "elbow", "wrist")
MOUNT = pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([0.1, 0.2, 0.3]))
BEAMS = (
    pin.SE3(pin.utils.rotate("x", math.pi / 2.0), np.array([0.0, 0.0, 0.8])),
    pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.0])),
    pin.SE3(np.eye(3), np.array([0.0, -0.3, 0.0])),
)


def product_of(transforms: list[pin.SE3]) -> FloatArray:
    """Return base to tip as a product of 4x4 matrices: mount, then measured joint and beam in turn."""
    matrix = np.array(MOUNT.homogeneous)
    for transform, beam in zip(transforms, BEAMS, strict=True):
        matrix = matrix @ transform.homogeneous @ beam.homogeneous
    return np.asarray(matrix)


@pytest.fixture
def chain() -> Chain:
    return Chain(THREE_JOINTS, "tip", source=SOURCE)


@pytest.fixture
def transforms(random_rotation: Callable[[], FloatArray], rng: np.random.Generator) -> list[pin.SE3]:
    return [pin.SE3(random_rotation(), rng.uniform(-0.008, 0.008, 3)) for _ in JOINTS]


@pytest.fixture
def covariances(rng: np.random.Generator) -> list[FloatArray]:
    """Full 6x6 matrices of different sizes, with correlations between translations and rotations."""
    made = []
    for scale in (1e-6, 2e-6, 5e-7):
        root = rng.normal(size=(6, 6)) * scale
        made.append(root @ root.T)
    return made


def measured(transforms: list[pin.SE3], covariances: list[FloatArray]) -> dict[str, MeasuredJoint]:
    return {
        name: MeasuredJoint(transform, covariance)
        for name, transform, covariance in zip(JOINTS, transforms, covariances, strict=True)
    }


def test_one_quarter_turn_moves_the_tip_as_computed_by_hand() -> None:
    chain = Chain(ONE_JOINT, "tip")
    quarter = pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([0.001, 0.002, 0.003]))
    endpoint = chain.estimate({"wrist": MeasuredJoint(quarter)})
    np.testing.assert_allclose(endpoint.T_base_endpoint.translation, [0.001, 0.502, 1.003], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(endpoint.T_base_endpoint.rotation, quarter.rotation, rtol=0.0, atol=1e-15)


def test_plates_of_a_joint_are_read_from_the_urdf(chain: Chain) -> None:
    assert chain.base_frame == "base"
    named = [(joint.name, joint.parent, joint.child) for joint in chain.joints]
    assert named == [("shoulder", "r1", "t1"), ("elbow", "r2", "t2"), ("wrist", "r3", "t3")]


def test_the_endpoint_is_the_product_of_joints_and_beams(
    chain: Chain, random_rotation: Callable[[], FloatArray], rng: np.random.Generator
) -> None:
    for _ in range(50):
        transforms = [pin.SE3(random_rotation(), rng.uniform(-0.008, 0.008, 3)) for _ in JOINTS]
        endpoint = chain.estimate(measured(transforms, [np.zeros((6, 6))] * 3))
        np.testing.assert_allclose(endpoint.T_base_endpoint.homogeneous, product_of(transforms), rtol=0.0, atol=5e-15)


def test_an_earlier_endpoint_is_not_changed_by_the_next(
    chain: Chain, transforms: list[pin.SE3], covariances: list[FloatArray]
) -> None:
    first = chain.estimate(measured(transforms, covariances))
    before = copy.deepcopy(first)
    chain.estimate(measured(transforms[::-1], covariances[::-1]))
    np.testing.assert_array_equal(first.T_base_endpoint.homogeneous, before.T_base_endpoint.homogeneous)
    np.testing.assert_array_equal(first.covariance(), before.covariance())


def disturbed(transform: pin.SE3, step: FloatArray) -> pin.SE3:
    """Return a transform moved by (x, y, z, about X, Y, Z), parent's axes, the turn applied on the parent's side."""
    turned = Rotation.from_rotvec(step[3:]).as_matrix() @ transform.rotation
    return pin.SE3(turned, transform.translation + step[:3])


def movement(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return (x, y, z, about X, Y, Z) of base from one tip matrix to another."""
    turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    return np.concatenate([after[:3, 3] - before[:3, 3], turn])


def test_covariance_is_that_of_finite_differences(
    chain: Chain, transforms: list[pin.SE3], covariances: list[FloatArray]
) -> None:
    step = 1e-6
    expected = np.zeros((6, 6))
    for joint, covariance in enumerate(covariances):
        columns = []
        for direction in np.eye(6):
            tips = []
            for sign in (-1.0, 1.0):
                moved = transforms.copy()
                moved[joint] = disturbed(moved[joint], sign * step * direction)
                tips.append(product_of(moved))
            columns.append(movement(*tips) / (2.0 * step))
        jacobian = np.column_stack(columns)
        expected += jacobian @ covariance @ jacobian.T
    endpoint = chain.estimate(measured(transforms, covariances))
    np.testing.assert_allclose(endpoint.covariance_random, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_a_lean_of_the_joint_moves_the_tip_by_the_lever() -> None:
    """One microradian about Z at the plate is half a micrometre along Y at the end of the half-metre beam."""
    covariance = np.zeros((6, 6))
    covariance[5, 5] = 1e-12
    endpoint = Chain(ONE_JOINT, "tip").estimate({"wrist": MeasuredJoint(pin.SE3.Identity(), covariance)})
    expected = np.zeros((6, 6))
    expected[1, 1], expected[1, 5], expected[5, 1], expected[5, 5] = 0.25e-12, 0.5e-12, 0.5e-12, 1e-12
    np.testing.assert_allclose(endpoint.covariance(), expected, rtol=1e-12, atol=1e-27)


def test_relative_to_home_is_in_the_axes_of_the_endpoint_at_home() -> None:
    home = pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([1.0, 2.0, 3.0]))
    now = pin.SE3(home.rotation, np.array([1.0, 2.1, 3.0]))
    found = Endpoints.allocate(1, 0)
    found.poses[0], found.covariances_random[0] = pin.SE3ToXYZQUAT(now), np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0])
    found.covariances_random[0][0, 4] = found.covariances_random[0][4, 0] = 3.0  # x with about Y
    (pose,), (covariance,), *_ = found.relative_to(pin.SE3ToXYZQUAT(home))
    # What base calls Y the endpoint at home calls X; what base calls X it calls -Y.
    np.testing.assert_allclose(pose, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], rtol=0.0, atol=1e-15)
    expected = np.diag([4.0, 1.0, 9.0, 25.0, 16.0, 36.0])
    expected[1, 3] = expected[3, 1] = -3.0
    np.testing.assert_allclose(covariance, expected, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("turns", [0, 3, -2])
def test_a_joints_angle_is_counted_from_the_urdfs_origin_about_its_axis(chain: Chain, turns: int) -> None:
    estimator = chain.estimator()
    for number, name in enumerate(JOINTS):
        for angle in (-3.0, -0.4, 0.0, 1.3, 3.1):
            pose = chain.nominal_joint(name, angle)
            theta = native_from_rotation(pose.rotation)[2]
            estimator.poses[number] = pin.SE3ToXYZQUAT(pose)
            estimator.thetas[number] = theta + 2.0 * math.pi * turns
            assert estimator.estimate()
            found = estimator.angles[number]
            assert math.remainder(found - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-14)
            assert found - theta - 2.0 * math.pi * turns == pytest.approx(0.0, abs=0.5)
            if name != "elbow":  # the URDF turns the others' plates by nothing: their angle is theta, to the last bit
                assert found == theta + 2.0 * math.pi * turns


def refused(urdf: str, endpoint_frame: str = "tip") -> ChainError:
    error = refusal(ChainError, Chain, urdf, endpoint_frame, source=SOURCE)
    assert error.where.startswith(SOURCE)
    return error


LOOSE_CYCLE = (  # a parser that starts at the root link leaves out what is not connected to it
    '<link name="left"/><link name="right"/>'
    '<joint name="there" type="floating"><parent link="left"/><child link="right"/></joint>'
    '<joint name="back" type="floating"><parent link="right"/><child link="left"/></joint>'
)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"floating"', '"fixed"', ": has no POSOR joint; expected at least one joint of type 'floating'."),
        (
            "</robot>",
            f"{LOOSE_CYCLE}</robot>",
            (
                ", line 6: joint 'there' is not connected to the root link 'base' (and 1 more); expected one tree, in "
                "which each link but the root is the child of one joint."
            ),
        ),
        ("</robot>", "</robt>", ": is not XML: mismatched tag: line 6, column 2; expected a robot description (URDF)."),
        ("</robot>", "", ": is not XML: no element found: line 7, column 0; expected a robot description (URDF)."),
    ],
    ids=["no POSOR", "cycle", "mismatched", "cut off"],
)
def test_a_urdf_that_is_no_tree_with_a_posor_is_refused(old: str, new: str, sentence: str) -> None:
    assert str(refused(ONE_JOINT.replace(old, new))) == f"{SOURCE}{sentence}"


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous", "planar"])
def test_a_moving_joint_that_is_not_floating_is_refused(kind: str) -> None:
    limits = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    error = refused(edited(THREE_JOINTS, 'name="elbow" type="floating">', f'name="elbow" type="{kind}">{limits}'))
    assert error.what == "joint 'elbow' moves but is not floating"
    assert error.expected == "type 'floating' (a POSOR) or 'fixed'"


@pytest.mark.parametrize("name", ["hand", "", "wrist"])
def test_an_unknown_endpoint_link_is_refused(name: str) -> None:
    error = refused(ONE_JOINT, name)
    assert (error.what, error.expected) == (f"has no link '{name}'", "one of base, plate_r, plate_t, tip")


def test_an_endpoint_that_no_joint_moves_is_refused() -> None:
    error = refused(ONE_JOINT, "base")
    assert error.what == "no POSOR joint moves link 'base'"
    assert error.expected.startswith("one of ")
    assert error.expected.endswith("tip")


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("pipe", "a pipe or device, not a file"),
        ("large", "32 MiB, more than"),
        ("arm\0urdf", "its name contains a null character"),
    ],
)
def test_a_urdf_that_is_no_file_or_too_large_is_refused(tmp_path: Path, path: str, reason: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    assert refusal(ChainError, load_chain, tmp_path / path, "tip").what.startswith(f"cannot be read: {reason}")
