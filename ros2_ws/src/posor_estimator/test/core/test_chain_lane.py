"""Endpoints of one scan and of many by the compiled walk: against pinocchio, and against one another."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest
from posor_estimator.core.beam_motion import ROOM
from posor_estimator.core.chain import Chain, Endpoint
from posor_estimator.core.chain_records import ChainRecords, JointColumns
from posor_estimator.core.fault import State
from posor_estimator.core.kernels.chain_motion import LEAST_SCANS
from posor_estimator.core.native import native_from_rotation

from .six_axis import FOLDER, JOINTS, PERIOD_NS, SCANS, WINDOW_S, assert_bits, six_axis_chain, swinging

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.chain_lane import Endpoints
    from posor_estimator.core.types import FloatArray, IntArray


@pytest.fixture(scope="module")
def chain() -> Chain:
    return six_axis_chain()


@pytest.fixture(scope="module")
def straight() -> Chain:
    """The same arm with beams that are straight and exact."""
    return Chain((FOLDER / "six_axis.urdf").read_text(encoding="utf-8"), "endpoint")


@pytest.fixture
def poses(random_rotation: Callable[[], FloatArray], rng: np.random.Generator) -> FloatArray:
    return np.array(
        [
            [pin.SE3ToXYZQUAT(pin.SE3(random_rotation(), rng.uniform(-0.01, 0.01, 3))) for _ in range(JOINTS)]
            for _ in range(SCANS)
        ]
    )


@pytest.fixture
def covariances(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(SCANS, JOINTS, 6, 6)) * 1e-6
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def pinocchio_endpoint(
    chain: Chain, poses: FloatArray, covariances: FloatArray, accelerations: FloatArray | None = None
) -> Endpoint:
    """Return the endpoint by pinocchio's model of the arm: forward kinematics, and the Jacobian of the endpoint.

    First with beams that do not sag, which tells how they lie; then with the sag of ``MeasuringBeam``.
    """
    robot = chain._robot
    model, data = robot.model, robot.model.createData()
    q, covariance = pin.neutral(model), np.zeros((model.nv, model.nv))

    def put(index: int, motion: pin.SE3, turn: FloatArray, own: FloatArray) -> None:
        joint = model.joints[index]
        q[joint.idx_q : joint.idx_q + 7] = pin.SE3ToXYZQUAT(motion)
        local = np.kron(np.eye(2), turn.T)
        block = slice(joint.idx_v, joint.idx_v + 6)
        covariance[block, block] = local @ own @ local.T

    for joint, pose, own in zip(robot.joints, poses, covariances, strict=True):
        measured = pin.XYZQUATToSE3(pose)
        put(joint.index, joint.T_parent_joint.inverse() * measured, measured.rotation, own)
    pin.forwardKinematics(model, data, q)
    starts = [data.oMi[model.parents[joint.index]].rotation @ joint.T_before_parent.rotation for joint in robot.freed]
    for number, (beam, joint, start) in enumerate(zip(chain.beams, robot.freed, starts, strict=True)):
        force = start.T @ (chain.gravity - (0.0 if accelerations is None else accelerations[number]))
        under = beam.T_under(force)
        put(joint.index, joint.T_parent_joint.inverse() * under, under.rotation, beam.covariance_under(force))
    jacobian = pin.computeFrameJacobian(model, data, q, robot.endpoint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    pose = pin.updateFramePlacement(model, data, robot.endpoint)
    return Endpoint(pin.SE3(pose), jacobian @ covariance @ jacobian.T)


def one_by_one(
    chain: Chain, poses: FloatArray, covariances: FloatArray, stamps: IntArray, window_s: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    lane = chain.lane(window_s)
    found = []
    for pose, covariance, stamp in zip(poses, covariances, stamps, strict=True):
        lane.poses[:], lane.covariances[:] = pose, covariance
        lane.run(int(stamp))
        found.append((lane.pose.copy(), lane.covariance.copy(), lane.angles.copy()))
    first, second, third = (np.array(each) for each in zip(*found, strict=True))
    return first, second, third


@pytest.mark.parametrize("which", ["chain", "straight"])
def test_the_walk_is_pinocchios_kinematics_and_jacobian(
    which: str, request: pytest.FixtureRequest, poses: FloatArray, covariances: FloatArray
) -> None:
    arm: Chain = request.getfixturevalue(which)
    found = arm.endpoints(poses, covariances)
    for n in range(SCANS):
        expected = pinocchio_endpoint(arm, poses[n], covariances[n])
        T = expected.T_base_endpoint
        np.testing.assert_allclose(found.poses[n], pin.SE3ToXYZQUAT(T), rtol=0.0, atol=3e-15)
        scale = np.sqrt(np.diag(expected.covariance))
        np.testing.assert_allclose(
            found.covariances[n] / np.outer(scale, scale),
            expected.covariance / np.outer(scale, scale),
            rtol=0.0,
            atol=1e-12,
        )
        np.testing.assert_array_equal(found.covariances[n], found.covariances[n].T)


def test_the_sag_is_there_and_so_is_its_uncertainty(
    chain: Chain, straight: Chain, poses: FloatArray, covariances: FloatArray
) -> None:
    sound, stiff = (arm.endpoints(poses, covariances) for arm in (chain, straight))
    assert np.abs(sound.poses[:, :3] - stiff.poses[:, :3]).max() > 1e-5
    assert np.all(np.linalg.det(sound.covariances) > np.linalg.det(stiff.covariances))


def test_a_link_between_two_joints_can_be_the_endpoint(poses: FloatArray, covariances: FloatArray) -> None:
    """The joints beyond it are looked at, but have no part in it."""
    text = (FOLDER / "six_axis.urdf").read_text(encoding="utf-8")
    link = Chain(text, "endpoint").joints[3].parent
    arm = Chain(text, link)
    found = arm.endpoints(poses, covariances)
    expected = pinocchio_endpoint(arm, poses[0], covariances[0])
    np.testing.assert_allclose(found.poses[0], pin.SE3ToXYZQUAT(expected.T_base_endpoint), rtol=0.0, atol=3e-15)
    others = poses.copy()
    others[:, 3:] = poses[::-1, 3:]
    assert_bits(arm.endpoints(others, covariances).covariances, found.covariances)


@pytest.mark.parametrize("window_s", [0.0, WINDOW_S])
def test_many_scans_give_the_numbers_of_one_after_the_other(
    chain: Chain, covariances: FloatArray, window_s: float
) -> None:
    poses, stamps = swinging(chain, SCANS)
    found = chain.endpoints(poses, covariances, stamps, acceleration_window=window_s)
    alone = one_by_one(chain, poses, covariances, stamps, window_s)
    for together, single in zip((found.poses, found.covariances, found.angles), alone, strict=True):
        assert_bits(together, single)
    assert found.sound.all()


def test_a_chunk_goes_on_from_the_motion_of_the_chunk_before(chain: Chain) -> None:
    """Over chunks of all sizes, shorter than the least number of scans too, and with a loop in the stamps."""
    poses, stamps = swinging(chain, SCANS)
    poses, stamps = np.tile(poses, (2, 1, 1)), np.tile(stamps, 2)
    covariances = np.zeros((2 * SCANS, JOINTS, 6, 6))
    whole = chain.endpoints(poses, covariances, stamps, acceleration_window=WINDOW_S)
    lane = chain.lane(WINDOW_S)
    chunks: list[Endpoints] = []
    begin = 0
    for size in (1, 2, LEAST_SCANS, 13, 30, 2 * SCANS):
        end = min(begin + size, 2 * SCANS)
        chunks.append(lane.endpoints(poses[begin:end], covariances[begin:end], stamps[begin:end]))
        begin = end
    assert_bits(np.concatenate([chunk.poses for chunk in chunks]), whole.poses)
    assert_bits(whole.poses[:SCANS], whole.poses[SCANS:])  # the second round knows nothing of the first


def test_a_window_of_more_scans_than_there_is_room_for_at_first(chain: Chain) -> None:
    scans = 2 * ROOM + LEAST_SCANS
    poses, stamps = swinging(chain, scans)
    covariances = np.zeros((scans, JOINTS, 6, 6))
    window_s = 1.5 * ROOM * PERIOD_NS * 1e-9
    assert_bits(
        chain.endpoints(poses, covariances, stamps, acceleration_window=window_s).poses,
        one_by_one(chain, poses, covariances, stamps, window_s)[0],
    )


def test_beams_weigh_more_by_the_acceleration_that_their_centres_tell_of(chain: Chain) -> None:
    poses, stamps = swinging(chain, SCANS)
    covariances = np.zeros((SCANS, JOINTS, 6, 6))
    lane = chain.lane(WINDOW_S)
    for n in range(SCANS):
        lane.poses[:] = poses[n]
        assert lane.run(int(stamps[n]))
        expected = pinocchio_endpoint(chain, poses[n], covariances[n], lane.accelerations)
        np.testing.assert_allclose(lane.pose, pin.SE3ToXYZQUAT(expected.T_base_endpoint), rtol=0.0, atol=3e-15)
        assert lane.accelerations.any() == (n >= LEAST_SCANS)
    assert np.abs(lane.accelerations).max() > 1.0
    still = chain.endpoints(poses, covariances).poses
    assert np.abs(lane.pose - still[-1])[:3].max() > 1e-7


def test_angles_are_counted_with_theta(chain: Chain, poses: FloatArray, covariances: FloatArray) -> None:
    rotations = [[pin.XYZQUATToSE3(pose).rotation for pose in scan] for scan in poses]
    own = np.array([[native_from_rotation(rotation)[2] for rotation in scan] for scan in rotations])
    uncounted = chain.lane().endpoints(poses, covariances).angles
    counted = chain.lane().endpoints(poses, covariances, thetas=own + 6.0 * math.pi).angles
    for column, joint in enumerate(chain.joints):
        seen = [native_from_rotation(joint.T_parent_joint.rotation.T @ scan[column])[2] for scan in rotations]
        np.testing.assert_allclose(uncounted[:, column], seen, rtol=0.0, atol=1e-13)
        turns = (counted[:, column] - 6.0 * math.pi - uncounted[:, column]) / (2.0 * math.pi)
        np.testing.assert_allclose(turns, np.round(turns), rtol=0.0, atol=1e-13)


def test_home_turns_the_pose_and_its_covariance(chain: Chain, poses: FloatArray, covariances: FloatArray) -> None:
    found = chain.endpoints(poses, covariances)
    home = found.poses[0].copy()
    relative, own = found.relative_to(home)
    back = pin.XYZQUATToSE3(home).inverse()
    turn = np.kron(np.eye(2), back.rotation)
    lane = chain.lane()
    for n in range(SCANS):
        expected = pin.SE3ToXYZQUAT(back * pin.XYZQUATToSE3(found.poses[n]))
        np.testing.assert_allclose(relative[n], expected, rtol=0.0, atol=3e-15)
        scale = np.abs(own[n]).max()
        np.testing.assert_allclose(own[n], turn @ found.covariances[n] @ turn.T, rtol=0.0, atol=1e-14 * scale)
        lane.poses[:], lane.covariances[:] = poses[n], covariances[n]
        lane.run()
        lane.find_relative_to(home)
        assert_bits(lane.relative_pose, relative[n])
        assert_bits(lane.relative_covariance, own[n])
    np.testing.assert_allclose(relative[0], [0, 0, 0, 0, 0, 0, 1], rtol=0.0, atol=1e-15)


def test_a_quaternion_that_is_a_little_too_long_turns_all_the_same(chain: Chain, poses: FloatArray) -> None:
    """A message from a sender of single precision: the arm must not grow by it."""
    covariances = np.zeros((SCANS, JOINTS, 6, 6))
    longer = poses.copy()
    longer[..., 3:] *= 1.0 + 0.9e-6
    np.testing.assert_allclose(
        chain.endpoints(longer, covariances).poses, chain.endpoints(poses, covariances).poses, rtol=0.0, atol=3e-15
    )


def test_arrays_that_may_not_be_written_are_read(chain: Chain, poses: FloatArray, covariances: FloatArray) -> None:
    """As those that stand upon the bytes of a bag."""
    expected = chain.endpoints(poses, covariances).poses
    for array in (poses, covariances):
        array.flags.writeable = False
    assert_bits(chain.endpoints(poses, covariances).poses, expected)


def test_rows_of_measurements_give_the_bits_of_the_lane(chain: Chain, covariances: FloatArray) -> None:
    """A window of more scans than there is room for at first, and joints whose rows begin elsewhere."""
    scans = ROOM + 40
    poses, stamps = swinging(chain, scans)
    lane, other = (chain.lane(scans * PERIOD_NS * 1e-9) for _ in range(2))
    columns = [
        JointColumns(pose=8 * (j + 1), theta=8 * (j + 8), covariance=8 * (j + 9), state=3, size=400)
        for j in range(JOINTS)
    ]
    records = ChainRecords(lane, columns)
    numbers = records.rows.view(np.float64)
    thetas = np.linspace(-20.0, 20.0, scans)
    for n in range(scans):
        states = [int(State.DEGRADED) if n % 7 == j else int(State.OK) for j in range(JOINTS)]
        bad = n in (20, 21, 22)
        states[1] = {20: int(State.LOST), 21: int(State.UNCOUNTED)}.get(n, states[1])
        for j in range(JOINTS):
            row = numbers[j]
            row[j + 1 : j + 8], row[j + 8] = poses[n, j], thetas[n]
            row[j + 9 : j + 45] = covariances[n % len(covariances), j].ravel()
            records.rows[j, 3] = states[j]
        if n == 22:
            numbers[0, 1] = math.nan
        if n == 30:
            lane.make_room()  # as whoever else runs the lane may
        worst = records.run(int(stamps[n]))
        if bad:
            assert worst < 0
            assert bool(lane.faults.any()) == (n == 22)
            continue
        assert worst == max(states)
        other.poses[:], other.covariances[:] = poses[n], covariances[n % len(covariances)]
        other.thetas[:] = thetas[n]
        assert other.run(int(stamps[n]))
        for name in ("pose", "covariance", "angles", "accelerations"):
            assert_bits(getattr(lane, name), getattr(other, name))
    assert other.accelerations.any()
