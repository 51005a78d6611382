# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_geometry import ArmGeometry, ellipsoid, enlarge
from posor_bringup.view_observation import ArmScan, EndpointView
from posor_lab.harness.case_tables import edited

ANGLES = {"base_swivel": 0.3, "shoulder": -0.2, "elbow": 0.4, "wrist_roll": 0.1, "wrist_yaw": -0.3}
NAN_ENDPOINT = EndpointView(0, 0, 0.0, 0.0, "base", np.full(7, np.nan), np.full((6, 6), np.nan), np.full(6, np.nan))


@pytest.fixture(scope="module")
def geometry() -> ArmGeometry:
    return ArmGeometry(load_checked_arm("five_axis"))


def scan_of(poses: list[pin.SE3], encoders: list[float]) -> ArmScan:
    count = len(poses)
    rows = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses])
    covariances = np.tile(1e-12 * np.eye(6), (count, 1, 1))
    thetas = np.full(count, np.nan)
    return ArmScan(1, rows, covariances, covariances, thetas, np.zeros(count), np.array(encoders))


def nominal_poses(angles: dict[str, float]) -> list[pin.SE3]:
    chain = load_checked_arm("five_axis").chain()
    return [chain.nominal_joint(joint.name, angles[joint.name]) for joint in chain.joints]


def test_nominal_arm_has_the_endpoint_of_the_chain(geometry: ArmGeometry) -> None:
    encoders = [ANGLES[name] for name in geometry.joints]
    drawn = geometry.draw(scan_of(nominal_poses(ANGLES), encoders), NAN_ENDPOINT)
    expected = load_checked_arm("five_axis").chain().nominal_endpoint(ANGLES)
    np.testing.assert_allclose(geometry.place("endpoint", drawn.nominal), expected, atol=1e-12)


def test_deviation_is_that_of_the_endpoint_and_adds_up_over_the_links(geometry: ArmGeometry) -> None:
    poses, encoders = nominal_poses(ANGLES), [ANGLES[name] for name in geometry.joints]
    sag = geometry.draw(scan_of(poses, encoders), NAN_ENDPOINT).deviation
    assert 1e-6 < np.linalg.norm(sag[:3]) < 1e-3
    poses[0] = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-4])) * poses[0]
    drawn = geometry.draw(scan_of(poses, encoders), NAN_ENDPOINT)
    np.testing.assert_allclose(drawn.deviation[:3] - sag[:3], [0.0, 0.0, 1e-4], atol=1e-9)
    assert drawn.unknown == frozenset()
    placed = (
        geometry.place("endpoint", drawn.measured).translation - geometry.place("endpoint", drawn.nominal).translation
    )
    np.testing.assert_allclose(placed, drawn.deviation[:3], atol=1e-12)


def test_joint_without_encoder_has_its_measured_angle(geometry: ArmGeometry) -> None:
    drawn = geometry.draw(scan_of(nominal_poses(ANGLES), [np.nan] * 5), NAN_ENDPOINT)
    np.testing.assert_allclose(drawn.nominal[:5], nominal_poses(ANGLES), atol=1e-9)


def test_what_hangs_on_a_lost_joint_is_unknown(geometry: ArmGeometry) -> None:
    poses = nominal_poses(ANGLES)
    scan = scan_of(poses, [0.0] * 5)
    scan.poses[2] = np.nan
    drawn = geometry.draw(scan, NAN_ENDPOINT)
    np.testing.assert_allclose(drawn.measured[:2], poses[:2], atol=1e-12)
    children = [child for _, child in geometry.ends[:5]]
    assert {geometry.endpoint, *children[2:]} <= drawn.unknown
    assert not {geometry.base, *children[:2]} & drawn.unknown
    assert np.isnan(drawn.deviation).all()


def test_enlarged_deviation() -> None:
    nominal = [pin.SE3.Random()]
    change = pin.exp6(np.array([1e-5, 2e-5, -3e-5, 1e-5, -2e-5, 4e-5]))
    (once,) = enlarge(nominal, [nominal[0] * change], 1.0)
    np.testing.assert_allclose(once, nominal[0] * change, atol=1e-12)
    (thousand,) = enlarge(nominal, [nominal[0] * change], 1000.0)
    np.testing.assert_allclose(pin.log6(nominal[0].inverse() * thousand), 1000.0 * pin.log6(change).vector, rtol=1e-9)


def test_ellipsoid_has_half_axes_of_two_sigma() -> None:
    turn = pin.exp3(np.array([0.3, -0.2, 0.5]))
    half_axes, axes = ellipsoid(turn @ np.diag([1e-12, 4e-12, 9e-12]) @ turn.T)
    np.testing.assert_allclose(half_axes, [2e-6, 4e-6, 6e-6], rtol=1e-6)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(np.abs(turn.T @ axes), np.eye(3), atol=1e-6)


def test_bodies_beyond_the_endpoint_are_not_drawn(tmp_path: Path) -> None:
    """A gripper, whose joint no sensor measures, has no pose."""
    folder = shutil.copytree(load_checked_arm("test_rig").path.parent, tmp_path / "arm")
    urdf, bodies = folder / "test_rig.urdf", ArmGeometry(load_checked_arm("test_rig")).bodies
    finger = (
        '<link name="finger"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>'
        '<joint name="grip" type="prismatic"><parent link="endpoint"/><child link="finger"/><axis xyz="1 0 0"/></joint>'
    )
    urdf.write_text(edited(urdf.read_text(encoding="utf-8"), "</robot>", f"{finger}</robot>"), encoding="utf-8")
    assert ArmGeometry(load_checked_arm(str(folder / "arm.yaml"))).bodies == bodies


def test_bodies_of_the_urdf(geometry: ArmGeometry) -> None:
    first = geometry.bodies[0]
    assert (first.link, first.shape, first.size) == ("base_swivel_receiving", "cylinder", (0.1016, 0.0127))
    assert first.colour == (0.35, 0.45, 0.6)
    assert {body.link for body in geometry.bodies} <= {child for _, child in geometry.ends} | {
        each.child for each in geometry.fixed
    }
