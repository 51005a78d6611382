from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.forward_kinematics import Endpoints
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import Chain, Endpoint, load_chain
from posor.errors import ChainError
from posor.input_text import MAX_BYTES
from posor.model.native_coordinates import native_from_rotation
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

SOURCE = "arm.urdf"

ONE_JOINT = """<robot name="one">
  <link name="base"/><link name="plate_r"/><link name="plate_t"/><link name="tip"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="plate_r"/><origin xyz="0 0 1" rpy="0 0 0"/></joint>
  <joint name="wrist" type="floating"><parent link="plate_r"/><child link="plate_t"/></joint>
  <joint name="beam" type="fixed"><parent link="plate_t"/><child link="tip"/><origin xyz="0.5 0 0" rpy="0 0 0"/></joint>
</robot>
"""

JOINTS = ("shoulder", "elbow", "wrist")
# The second POSOR's floating joint has an origin of its own: the measurement is still that of plate in plate.
THREE_JOINTS = """<robot name="three">
  <link name="base"/>
  <link name="r1"/><link name="t1"/><link name="r2"/><link name="t2"/><link name="r3"/><link name="t3"/>
  <link name="tip"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="r1"/>
    <origin xyz="0.1 0.2 0.3" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="shoulder" type="floating"><parent link="r1"/><child link="t1"/></joint>
  <joint name="beam1" type="fixed"><parent link="t1"/><child link="r2"/>
    <origin xyz="0 0 0.8" rpy="1.5707963267948966 0 0"/></joint>
  <joint name="elbow" type="floating"><parent link="r2"/><child link="t2"/>
    <origin xyz="0.001 0.002 0.003" rpy="0.1 0.2 0.3"/></joint>
  <joint name="beam2" type="fixed"><parent link="t2"/><child link="r3"/><origin xyz="0.6 0 0" rpy="0 0 0"/></joint>
  <joint name="wrist" type="floating"><parent link="r3"/><child link="t3"/></joint>
  <joint name="beam3" type="fixed"><parent link="t3"/><child link="tip"/><origin xyz="0 -0.3 0" rpy="0 0 0"/></joint>
</robot>
"""
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
    endpoint = chain.estimate({"wrist": MeasuredJoint(quarter, np.zeros((6, 6)))})
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


def test_a_link_in_the_middle_can_be_the_endpoint(transforms: list[pin.SE3], covariances: list[FloatArray]) -> None:
    endpoint = Chain(THREE_JOINTS, "r2").estimate(measured(transforms, covariances))
    expected = MOUNT * transforms[0] * BEAMS[0]
    np.testing.assert_allclose(endpoint.T_base_endpoint.homogeneous, expected.homogeneous, rtol=0.0, atol=5e-15)
    # The joints beyond it have no part in its covariance.
    alone = Chain(THREE_JOINTS, "r2").estimate(measured(transforms, [covariances[0], *2 * [np.zeros((6, 6))]]))
    np.testing.assert_array_equal(endpoint.covariance, alone.covariance)


def test_an_earlier_endpoint_is_not_changed_by_the_next(
    chain: Chain, transforms: list[pin.SE3], covariances: list[FloatArray]
) -> None:
    first = chain.estimate(measured(transforms, covariances))
    before = np.array(first.T_base_endpoint.homogeneous), first.covariance.copy()
    chain.estimate(measured(transforms[::-1], covariances[::-1]))
    np.testing.assert_array_equal(first.T_base_endpoint.homogeneous, before[0])
    np.testing.assert_array_equal(first.covariance, before[1])


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
    np.testing.assert_allclose(endpoint.covariance, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_covariance_is_that_of_a_monte_carlo_run(
    chain: Chain, transforms: list[pin.SE3], covariances: list[FloatArray], rng: np.random.Generator
) -> None:
    """JCGM 101: draw the joints' errors, look at the tip's; every variance ratio is 1 within five of its deviations."""
    runs = 20_000
    tip = np.broadcast_to(np.array(MOUNT.homogeneous), (runs, 4, 4))
    for transform, covariance, beam in zip(transforms, covariances, BEAMS, strict=True):
        errors = rng.multivariate_normal(np.zeros(6), covariance, runs)
        joint = np.broadcast_to(np.array(transform.homogeneous), (runs, 4, 4)).copy()
        joint[:, :3, :3] = Rotation.from_rotvec(errors[:, 3:]).as_matrix() @ joint[:, :3, :3]
        joint[:, :3, 3] += errors[:, :3]
        tip = tip @ joint @ beam.homogeneous
    truth = product_of(transforms)
    turns = Rotation.from_matrix(tip[:, :3, :3] @ truth[:3, :3].T).as_rotvec()
    moves = np.column_stack([tip[:, :3, 3] - truth[:3, 3], turns])
    white = np.linalg.inv(np.linalg.cholesky(chain.estimate(measured(transforms, covariances)).covariance))
    drawn = white @ np.cov(moves.T) @ white.T
    np.testing.assert_allclose(drawn, np.eye(6), rtol=0.0, atol=5.0 * math.sqrt(2.0 / runs))


def test_a_lean_of_the_joint_moves_the_tip_by_the_lever() -> None:
    """One microradian about Z at the plate is half a micrometre along Y at the end of the half-metre beam."""
    covariance = np.zeros((6, 6))
    covariance[5, 5] = 1e-12
    endpoint = Chain(ONE_JOINT, "tip").estimate({"wrist": MeasuredJoint(pin.SE3.Identity(), covariance)})
    expected = np.zeros((6, 6))
    expected[1, 1], expected[1, 5], expected[5, 1], expected[5, 5] = 0.25e-12, 0.5e-12, 0.5e-12, 1e-12
    np.testing.assert_allclose(endpoint.covariance, expected, rtol=1e-12, atol=1e-27)


def relative_to(home: Endpoint, now: Endpoint) -> Endpoint:
    """Return an endpoint in the axes of another, as a chain's endpoints are put there."""
    here = Endpoints.allocate(1, 0)
    here.poses[0], here.covariances[0] = pin.SE3ToXYZQUAT(now.T_base_endpoint), now.covariance
    poses, covariances = here.relative_to(pin.SE3ToXYZQUAT(home.T_base_endpoint))
    return Endpoint(pin.XYZQUATToSE3(poses[0]), covariances[0])


def test_relative_to_home_is_in_the_axes_of_the_endpoint_at_home() -> None:
    home = Endpoint(pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([1.0, 2.0, 3.0])), np.eye(6))
    covariance = np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0])
    covariance[0, 4] = covariance[4, 0] = 3.0  # x with about Y
    now = Endpoint(pin.SE3(pin.utils.rotate("z", math.pi / 2.0), np.array([1.0, 2.1, 3.0])), covariance)
    relative = relative_to(home, now)
    # What base calls Y the endpoint at home calls X; what base calls X it calls -Y.
    np.testing.assert_allclose(relative.T_base_endpoint.translation, [0.1, 0.0, 0.0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(relative.T_base_endpoint.rotation, np.eye(3), rtol=0.0, atol=1e-15)
    expected = np.diag([4.0, 1.0, 9.0, 25.0, 16.0, 36.0])
    expected[1, 3] = expected[3, 1] = -3.0
    np.testing.assert_allclose(relative.covariance, expected, rtol=0.0, atol=1e-14)


def test_relative_covariance_is_that_along_the_axes_at_home() -> None:
    """Home's X axis heads 30 degrees from base's X toward Y, where the errors along X and Y help each other."""
    heading = math.radians(30.0)
    home = Endpoint(pin.SE3(pin.utils.rotate("z", heading), np.zeros(3)), np.eye(6))
    covariance = np.diag([1.0, 4.0, 9.0, 1.0, 4.0, 9.0])
    for first in (0, 3):
        covariance[first, first + 1] = covariance[first + 1, first] = 1.5
    relative = relative_to(home, Endpoint(home.T_base_endpoint, covariance))
    along = np.array([math.cos(heading), math.sin(heading)])
    for first in (0, 3):
        block = covariance[first : first + 2, first : first + 2]
        assert relative.covariance[first, first] == pytest.approx(along @ block @ along, rel=1e-14)
    assert relative.covariance[0, 0] == pytest.approx(0.75 + 1.0 + 1.5 * math.sqrt(0.75), rel=1e-14)


def test_relative_to_itself_is_the_identity(
    chain: Chain, transforms: list[pin.SE3], covariances: list[FloatArray]
) -> None:
    endpoint = chain.estimate(measured(transforms, covariances))
    back = relative_to(endpoint, endpoint).T_base_endpoint
    np.testing.assert_allclose(back.homogeneous, np.eye(4), rtol=0.0, atol=1e-15)


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


def refusal(urdf: str, endpoint_frame: str = "tip") -> str:
    with pytest.raises(ChainError) as caught:
        Chain(urdf, endpoint_frame, source=SOURCE)
    sentence = str(caught.value)
    assert sentence.startswith(f"{SOURCE}: ")
    assert sentence.endswith(".")
    assert "\n" not in sentence
    return sentence


def test_a_urdf_without_a_posor_is_refused() -> None:
    assert refusal(ONE_JOINT.replace('"floating"', '"fixed"')) == (
        "arm.urdf: has no POSOR joint; expected at least one joint of type 'floating'."
    )


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous", "planar"])
def test_a_moving_joint_that_is_not_floating_is_refused(kind: str) -> None:
    moving = THREE_JOINTS.replace(
        'name="elbow" type="floating">',
        f'name="elbow" type="{kind}"><limit lower="-1" upper="1" effort="1" velocity="1"/>',
    )
    assert refusal(moving) == (
        "arm.urdf: joint 'elbow' moves but is not floating; expected type 'floating' (a POSOR) or 'fixed'."
    )


@pytest.mark.parametrize("name", ["hand", "", "wrist"])
def test_an_unknown_endpoint_link_is_refused(name: str) -> None:
    assert refusal(ONE_JOINT, name) == f"arm.urdf: has no link '{name}'; expected one of base, plate_r, plate_t, tip."


@pytest.mark.parametrize(
    ("urdf", "reason"),
    [
        ("", "no element found: line 1, column 0"),
        (ONE_JOINT.removesuffix("</robot>\n"), "no element found: line 6, column 0"),
        (ONE_JOINT.replace("</robot>", "</robt>"), "mismatched tag: line 6, column 2"),
    ],
    ids=["empty", "cut off", "mismatched"],
)
def test_malformed_xml_is_refused_with_its_place(urdf: str, reason: str) -> None:
    sentence = refusal(urdf)
    assert sentence.startswith(f"arm.urdf: is not XML: {reason}")
    assert sentence.endswith("; expected a robot description (URDF).")


WRONG_DESCRIPTIONS = {
    "no robot": ("<html/>", "robot"),
    "unknown joint type": (ONE_JOINT.replace('"floating"', '"floatin"'), "floatin"),
    "missing link": (ONE_JOINT.replace('<link name="tip"/>', ""), "tip"),
    "two roots": (ONE_JOINT.replace('<link name="tip"/>', '<link name="tip"/><link name="loose"/>'), "loose"),
    "link twice": (ONE_JOINT.replace('<link name="tip"/>', '<link name="tip"/><link name="tip"/>'), "tip"),
    "not a number": (ONE_JOINT.replace('xyz="0.5 0 0"', 'xyz="far 0 0"'), "far"),
    "two coordinates": (ONE_JOINT.replace('xyz="0.5 0 0"', 'xyz="0.5 0"'), "0.5 0"),
}


@pytest.mark.parametrize("case", WRONG_DESCRIPTIONS)
def test_xml_without_a_robot_description_is_refused(case: str) -> None:
    refusal(WRONG_DESCRIPTIONS[case][0])


@pytest.mark.parametrize("case", WRONG_DESCRIPTIONS)
def test_errors_of_the_urdf_parser_are_reported(case: str, capfd: pytest.CaptureFixture[str]) -> None:
    urdf, culprit = WRONG_DESCRIPTIONS[case]
    assert culprit in refusal(urdf)
    assert capfd.readouterr() == ("", "")


def test_an_endpoint_that_no_joint_moves_is_refused() -> None:
    with pytest.raises(ChainError, match=r"no POSOR joint moves link 'base'; expected one of .*tip"):
        Chain(ONE_JOINT, "base")


def test_joints_of_a_cycle_are_refused() -> None:
    """The parser starts at the root link and leaves out, without a word, what is not connected to it."""
    cycle = (
        '<link name="left"/><link name="right"/>'
        '<joint name="there" type="floating"><parent link="left"/><child link="right"/></joint>'
        '<joint name="back" type="floating"><parent link="right"/><child link="left"/></joint>'
    )
    assert refusal(ONE_JOINT.replace("</robot>", f"{cycle}</robot>")) == (
        "arm.urdf: joint 'there' is not connected to the root link 'base'; expected one tree, in which each link but "
        "the root is the child of one joint."
    )


@pytest.mark.parametrize(("path", "reason"), [("pipe", "a pipe or device, not a file"), ("large", "32 MiB, more than")])
def test_a_urdf_that_is_no_file_or_too_large_is_refused(tmp_path: Path, path: str, reason: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(ChainError, match=f"cannot be read: {reason}"):
        load_chain(tmp_path / path, "tip")
