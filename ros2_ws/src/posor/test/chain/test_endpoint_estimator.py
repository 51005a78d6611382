# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""EndpointEstimator: single scans and many, compared with pinocchio and with each other."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.beam_acceleration import INITIAL_CAPACITY, MINIMUM_SCANS
from posor.chain.endpoint_estimator import EndpointEstimator
from posor.chain.forward_kinematics import Endpoints
from posor.chain.joint_measurements import JointRowLayout
from posor.chain.kinematic_chain import Chain, Endpoint
from posor.model.fault import State
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.array_types import FloatArray, IntArray
from posor_lab.harness.endpoint_effects import endpoint_effects

from .six_axis_arm import FOLDER, JOINTS, PERIOD_NS, SCANS, WINDOW_S, assert_bits, six_axis_chain, swinging

Parts = tuple[FloatArray, FloatArray]

RESULTS = ("pose", "covariance_random", "covariance_systematic", "angles", "stamp_shift")


@pytest.fixture(scope="module")
def chain() -> Chain:
    return six_axis_chain()


@pytest.fixture(scope="module")
def straight() -> Chain:
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
def covariances(rng: np.random.Generator) -> Parts:
    """Random and systematic part, (n, j, 6, 6) each."""
    roots = rng.normal(size=(2, SCANS, JOINTS, 6, 6)) * 1e-6
    random, systematic = roots @ np.swapaxes(roots, -1, -2)
    return random, systematic


@pytest.fixture
def stamp_shifts(rng: np.random.Generator) -> FloatArray:
    """Some joints state no limit of their stamps."""
    return np.abs(rng.normal(size=(SCANS, JOINTS, 6))) * 1e-6 * (rng.uniform(size=(SCANS, JOINTS, 1)) > 0.5)


def exact(scans: int) -> Parts:
    return np.zeros((scans, JOINTS, 6, 6)), np.zeros((scans, JOINTS, 6, 6))


def part_of(covariances: Parts, scans: int | slice) -> Parts:
    return covariances[0][scans], covariances[1][scans]


def pinocchio_endpoint(
    chain: Chain, poses: FloatArray, covariances: Parts, accelerations: FloatArray | None = None
) -> Endpoint:
    """Return the endpoint by pinocchio's model of the arm: forward kinematics, and the Jacobian of the endpoint.

    First with beams that do not sag, which tells how they lie; then with the sag of ``MeasuringBeam``.
    ``covariances``: random and systematic part, (j, 6, 6) each.
    """
    robot = chain._robot
    model, data = robot.model, robot.model.createData()
    q, covariance = pin.neutral(model), np.zeros((2, model.nv, model.nv))

    def put(index: int, motion: pin.SE3, turn: FloatArray, own: FloatArray) -> None:
        joint = model.joints[index]
        q[joint.idx_q : joint.idx_q + 7] = pin.SE3ToXYZQUAT(motion)
        local = np.kron(np.eye(2), turn.T)
        block = slice(joint.idx_v, joint.idx_v + 6)
        covariance[:, block, block] = local @ own @ local.T

    for joint, pose, random, systematic in zip(robot.joints, poses, *covariances, strict=True):
        measured = pin.XYZQUATToSE3(pose)
        own = np.stack([random, systematic])
        put(joint.index, joint.T_parent_joint.inverse() * measured, measured.rotation, own)
    pin.forwardKinematics(model, data, q)
    starts = [data.oMi[model.parents[joint.index]].rotation @ joint.T_before_parent.rotation for joint in robot.freed]
    for number, (beam, joint, start) in enumerate(zip(chain.beams, robot.freed, starts, strict=True)):
        force = start.T @ (chain.gravity - (0.0 if accelerations is None else accelerations[number]))
        under = beam.T_under(force)
        own = np.stack([np.zeros((6, 6)), beam.covariance_under(force)])  # a beam is common to all scans
        put(joint.index, joint.T_parent_joint.inverse() * under, under.rotation, own)
    jacobian = pin.computeFrameJacobian(model, data, q, robot.endpoint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    pose = pin.updateFramePlacement(model, data, robot.endpoint)
    return Endpoint(pin.SE3(pose), *(jacobian @ covariance @ jacobian.T))


def one_by_one(
    chain: Chain, poses: FloatArray, covariances: Parts, stamps: IntArray, window_s: float = 0.0
) -> list[FloatArray]:
    estimator = chain.estimator(window_s)
    found = []
    for n, stamp in enumerate(stamps):
        set_scan(estimator, poses[n], part_of(covariances, n))
        estimator.estimate(int(stamp))
        found.append([np.copy(getattr(estimator, name)) for name in RESULTS])
    return [np.array(each) for each in zip(*found, strict=True)]


def set_scan(estimator: EndpointEstimator, poses: FloatArray, covariances: Parts) -> None:
    estimator.poses[:], (estimator.covariances_random[:], estimator.covariances_systematic[:]) = poses, covariances


@pytest.mark.parametrize("which", ["chain", "straight"])
def test_pose_and_covariance_agree_with_pinocchio(
    which: str, request: pytest.FixtureRequest, poses: FloatArray, covariances: Parts
) -> None:
    arm: Chain = request.getfixturevalue(which)
    found = arm.estimate_all(poses, *covariances)
    for n in range(SCANS):
        expected = pinocchio_endpoint(arm, poses[n], part_of(covariances, n))
        T = expected.T_base_endpoint
        np.testing.assert_allclose(found.poses[n], pin.SE3ToXYZQUAT(T), rtol=0.0, atol=3e-15)
        for own, other in (
            (found.covariances_random[n], expected.covariance_random),
            (found.covariances_systematic[n], expected.covariance_systematic),
            (found.covariances()[n], expected.covariance()),
        ):
            scale = np.sqrt(np.outer(np.diag(other), np.diag(other)))
            np.testing.assert_allclose(own / scale, other / scale, rtol=0.0, atol=1e-12)
            np.testing.assert_array_equal(own, own.T)


def test_a_link_between_two_joints_can_be_the_endpoint(poses: FloatArray, covariances: Parts) -> None:
    """Joints beyond the link are checked but do not contribute."""
    text = (FOLDER / "six_axis.urdf").read_text(encoding="utf-8")
    link = Chain(text, "endpoint").joints[3].parent
    arm = Chain(text, link)
    found = arm.estimate_all(poses, *covariances)
    expected = pinocchio_endpoint(arm, poses[0], part_of(covariances, 0))
    np.testing.assert_allclose(found.poses[0], pin.SE3ToXYZQUAT(expected.T_base_endpoint), rtol=0.0, atol=3e-15)
    others = poses.copy()
    others[:, 3:] = poses[::-1, 3:]
    assert_bits(arm.estimate_all(others, *covariances).covariances(), found.covariances())


@pytest.mark.parametrize("window_s", [0.0, WINDOW_S])
def test_many_scans_give_the_bits_of_single_scans(chain: Chain, covariances: Parts, window_s: float) -> None:
    poses, stamps = swinging(chain, SCANS)
    found = chain.estimate_all(poses, *covariances, stamps, acceleration_window=window_s)
    alone = one_by_one(chain, poses, covariances, stamps, window_s)
    for together, single in zip((*found[:4], found.stamp_shifts), alone, strict=True):
        assert_bits(together, single)
    assert found.usable.all()


def test_chunks_continue_the_motion_of_the_chunk_before(chain: Chain) -> None:
    """Chunks of all sizes, also shorter than MINIMUM_SCANS, with stamps that start over."""
    poses, stamps = swinging(chain, SCANS)
    poses, stamps = np.tile(poses, (2, 1, 1)), np.tile(stamps, 2)
    covariances = exact(2 * SCANS)
    whole = chain.estimate_all(poses, *covariances, stamps, acceleration_window=WINDOW_S)
    estimator = chain.estimator(WINDOW_S)
    chunks: list[Endpoints] = []
    begin = 0
    for size in (1, 2, MINIMUM_SCANS, 13, 30, 2 * SCANS):
        end = min(begin + size, 2 * SCANS)
        part = slice(begin, end)
        chunks.append(estimator.estimate_all(poses[part], *part_of(covariances, part), stamps[part]))
        begin = end
    assert_bits(np.concatenate([chunk.poses for chunk in chunks]), whole.poses)
    assert_bits(whole.poses[:SCANS], whole.poses[SCANS:])  # the history was emptied in between


def test_a_window_of_more_scans_than_the_initial_capacity(chain: Chain) -> None:
    scans = 2 * INITIAL_CAPACITY + MINIMUM_SCANS
    poses, stamps = swinging(chain, scans)
    covariances = exact(scans)
    window_s = 1.5 * INITIAL_CAPACITY * PERIOD_NS * 1e-9
    assert_bits(
        chain.estimate_all(poses, *covariances, stamps, acceleration_window=window_s).poses,
        one_by_one(chain, poses, covariances, stamps, window_s)[0],
    )


def test_scans_close_together_give_no_acceleration(chain: Chain) -> None:
    """Their noise would pass for acceleration: 30 stamps 0.1 ms apart moved the endpoint by millimetres."""
    poses, _ = swinging(chain, 1)
    chance = np.random.default_rng(5)
    estimator = chain.estimator(WINDOW_S)
    for n in range(30):
        estimator.poses[:] = poses[0]
        estimator.poses[:, :3] += chance.normal(scale=1e-7, size=(JOINTS, 3))
        assert estimator.estimate(1 + n * 100_000)
        assert not estimator.accelerations.any()


def test_accelerations_of_the_beams_change_their_sag(chain: Chain) -> None:
    poses, stamps = swinging(chain, SCANS)
    covariances = exact(SCANS)
    estimator = chain.estimator(WINDOW_S)
    for n in range(SCANS):
        estimator.poses[:] = poses[n]
        assert estimator.estimate(int(stamps[n]))
        expected = pinocchio_endpoint(chain, poses[n], part_of(covariances, n), estimator.accelerations)
        np.testing.assert_allclose(estimator.pose, pin.SE3ToXYZQUAT(expected.T_base_endpoint), rtol=0.0, atol=3e-15)
        spans_half = n > 0 and 2 * (stamps[n - 1] - stamps[0]) >= WINDOW_S * 1e9
        assert estimator.accelerations.any() == (n >= MINIMUM_SCANS and spans_half)
    assert np.abs(estimator.accelerations).max() > 1.0
    still = chain.estimate_all(poses, *covariances).poses
    assert np.abs(estimator.pose - still[-1])[:3].max() > 1e-7


def test_angles_are_counted_with_theta(chain: Chain, poses: FloatArray, covariances: Parts) -> None:
    rotations = [[pin.XYZQUATToSE3(pose).rotation for pose in scan] for scan in poses]
    own = np.array([[native_from_rotation(rotation)[2] for rotation in scan] for scan in rotations])
    uncounted = chain.estimator().estimate_all(poses, *covariances).angles
    counted = chain.estimator().estimate_all(poses, *covariances, thetas=own + 6.0 * math.pi).angles
    for column, joint in enumerate(chain.joints):
        seen = [native_from_rotation(joint.T_parent_joint.rotation.T @ scan[column])[2] for scan in rotations]
        np.testing.assert_allclose(uncounted[:, column], seen, rtol=0.0, atol=1e-13)
        turns = (counted[:, column] - 6.0 * math.pi - uncounted[:, column]) / (2.0 * math.pi)
        np.testing.assert_allclose(turns, np.round(turns), rtol=0.0, atol=1e-13)


def test_pose_and_covariance_relative_to_home(chain: Chain, poses: FloatArray, covariances: Parts) -> None:
    found = chain.estimate_all(poses, *covariances)
    home = found.poses[0].copy()
    relative = found.relative_to(home)
    back = pin.XYZQUATToSE3(home).inverse()
    turn = np.kron(np.eye(2), back.rotation)
    estimator = chain.estimator()
    for n in range(SCANS):
        expected = pin.SE3ToXYZQUAT(back * pin.XYZQUATToSE3(found.poses[n]))
        np.testing.assert_allclose(relative.poses[n], expected, rtol=0.0, atol=3e-15)
        for own, before in zip(relative[1:3], found[1:3], strict=True):
            scale = np.abs(own[n]).max()
            np.testing.assert_allclose(own[n], turn @ before[n] @ turn.T, rtol=0.0, atol=1e-14 * scale)
        set_scan(estimator, poses[n], part_of(covariances, n))
        estimator.estimate()
        estimator.estimate_relative_to(home)
        for own, expected in zip(estimator.result(relative=True), relative[:3], strict=True):
            assert_bits(own, expected[n])
    np.testing.assert_allclose(relative.poses[0], [0, 0, 0, 0, 0, 0, 1], rtol=0.0, atol=1e-15)
    assert_bits(relative.angles, found.angles)


def test_stamp_shifts_add_up_by_their_effects_on_the_endpoint(
    straight: Chain, poses: FloatArray, stamp_shifts: FloatArray
) -> None:
    stamp_shifts[0] = 0.0
    stamp_shifts[1, 3, 5] = math.inf
    found = straight.estimator().estimate_all(poses, *exact(SCANS), stamp_shifts=stamp_shifts)
    relative = found.relative_to(found.poses[0])
    back = np.kron(np.eye(2), pin.XYZQUATToSE3(found.poses[0]).rotation.T)
    for n in range(SCANS):
        names = [joint.name for joint in straight.joints]
        effects = endpoint_effects(
            straight, {name: pin.XYZQUATToSE3(pose) for name, pose in zip(names, poses[n], strict=True)}
        )
        with np.errstate(invalid="ignore"):
            amounts = [np.abs(effects[name]) * stamp_shifts[n, j] for j, name in enumerate(names)]
        expected = np.nansum(amounts, axis=(0, 2))
        np.testing.assert_allclose(found.stamp_shifts[n], expected, rtol=1e-4)  # turns of 1e-6 rad after one another
        if n != 1:
            moved = np.abs(back) @ found.stamp_shifts[n]
            np.testing.assert_allclose(relative.stamp_shifts[n], moved, rtol=1e-9, atol=1e-18)
    assert not found.stamp_shifts[0].any()
    assert np.isinf(found.stamp_shifts[1]).any()


def test_large_stamp_shifts_bound_the_endpoint(straight: Chain, rng: np.random.Generator) -> None:
    angles = rng.uniform(-2.0, 2.0, JOINTS)
    joints = [straight.nominal_joint(joint.name, angle) for joint, angle in zip(straight.joints, angles, strict=True)]
    poses = np.array([pin.SE3ToXYZQUAT(pose) for pose in joints])
    shifts = np.tile([1e-3, 1e-3, 1e-3, 0.01, 0.01, 0.3], (JOINTS, 1))
    (bound,) = straight.estimator().estimate_all(poses[None], *exact(1), stamp_shifts=shifts[None]).stamp_shifts
    amounts = rng.uniform(-1.0, 1.0, (500, JOINTS, 6))
    amounts[:8] = np.sign(amounts[:8])
    moved = np.empty((len(amounts), JOINTS, 7))
    for n, amount in enumerate(amounts * shifts):
        for j, own in enumerate(amount):
            turned = pin.SE3(pin.exp3(own[3:]) @ joints[j].rotation, joints[j].translation + own[:3])
            moved[n, j] = pin.SE3ToXYZQUAT(turned)
    found = straight.estimator().estimate_all(moved, *exact(len(moved))).poses
    sound = pin.XYZQUATToSE3(straight.estimator().estimate_all(poses[None], *exact(1)).poses[0])
    for pose in found:
        end = pin.XYZQUATToSE3(pose)
        turn = pin.log3(end.rotation @ sound.rotation.T)
        assert (np.abs(np.concatenate([end.translation - sound.translation, turn])) <= bound).all()


def test_a_quaternion_slightly_off_unit_length_is_normalised(chain: Chain, poses: FloatArray) -> None:
    """As from a sender of single precision."""
    longer = poses.copy()
    longer[..., 3:] *= 1.0 + 0.9e-6
    np.testing.assert_allclose(
        chain.estimate_all(longer, *exact(SCANS)).poses,
        chain.estimate_all(poses, *exact(SCANS)).poses,
        rtol=0.0,
        atol=3e-15,
    )


def test_read_only_arrays_are_accepted(chain: Chain, poses: FloatArray, covariances: Parts) -> None:
    """As views of the bytes of a bag."""
    expected = chain.estimate_all(poses, *covariances).poses
    for array in (poses, *covariances):
        array.flags.writeable = False
    assert_bits(chain.estimate_all(poses, *covariances).poses, expected)


def test_serialised_rows_give_the_bits_of_arrays(chain: Chain, covariances: Parts, stamp_shifts: FloatArray) -> None:
    """With a window above the initial capacity, and different offsets in each row."""
    scans = INITIAL_CAPACITY + 40
    poses, stamps = swinging(chain, scans)
    columns = [
        JointRowLayout(
            8 * (j + 1),
            8 * (j + 8),
            8 * (j + 14),
            8 * (j + 50),
            shared=0,
            effects=0,
            stamp_shift=8 * (j + 86),
            state=3,
            size=776,
        )
        for j in range(JOINTS)
    ]
    estimator, other = (chain.estimator(scans * PERIOD_NS * 1e-9, columns) for _ in range(2))
    numbers = estimator.rows.view(np.float64)
    turns = 2.0 * math.pi * np.round(np.linspace(-3.0, 3.0, scans))
    natives = np.array(
        [[[*pose[:3], *native_from_rotation(pin.XYZQUATToSE3(pose).rotation)] for pose in row] for row in poses]
    )
    natives[..., 5] += turns[:, None]
    for n in range(scans):
        states = [int(State.DEGRADED) if n % 7 == j else int(State.OK) for j in range(JOINTS)]
        bad = n in (20, 21, 22)
        states[1] = {20: int(State.LOST), 21: int(State.UNCOUNTED)}.get(n, states[1])
        for j in range(JOINTS):
            row = numbers[j]
            row[j + 1 : j + 8], row[j + 8 : j + 14] = poses[n, j], natives[n, j]
            row[j + 14 : j + 86] = np.ravel([part[j] for part in part_of(covariances, n % SCANS)])
            row[j + 86 : j + 92] = stamp_shifts[n % SCANS, j]
            estimator.rows[j, 3] = states[j]
        if n == 22:
            numbers[0, 1] = math.nan
        worst = estimator.estimate_rows(int(stamps[n]))
        if bad:
            assert worst < 0
            assert bool(estimator.faults.any()) == (n == 22)
            continue
        assert worst == max(states)
        set_scan(other, poses[n], part_of(covariances, n % SCANS))
        other.thetas[:], other.stamp_shifts[:] = natives[n, :, 5], stamp_shifts[n % SCANS]
        assert other.estimate(int(stamps[n]))
        for name in (*RESULTS, "accelerations"):
            assert_bits(getattr(estimator, name), getattr(other, name))
    assert other.accelerations.any()
