"""chain_node with an arm of two joints: synchronisation of the joints, and the beam between them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor_estimator.chain_node import ChainNode
from posor_lab.harness.graph import Graph, stamp_seconds, values_of, wait_for_value
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_msgs.msg import EndpointState, JointTransform

from .chain_program import LOSSLESS, ChainRig, chain_node, lost_transform, transform_of

pytestmark = pytest.mark.usefixtures("ros_domain")

TWO_JOINTS = """<robot name="two">
  <link name="base"/><link name="t1"/><link name="r2"/><link name="t2"/>
  <joint name="shoulder" type="floating"><parent link="base"/><child link="t1"/></joint>
  <joint name="beam" type="fixed"><parent link="t1"/><child link="r2"/><origin xyz="0.5 0 0" rpy="0 0 0"/></joint>
  <joint name="elbow" type="floating"><parent link="r2"/><child link="t2"/></joint>
</robot>
"""


@pytest.fixture(scope="module")
def two_joints(tmp_path_factory: pytest.TempPathFactory) -> str:
    urdf = tmp_path_factory.mktemp("two_joints") / "two.urdf"
    urdf.write_text(TWO_JOINTS, encoding="utf-8")
    return str(urdf)


def test_only_complete_scans_of_usable_transforms_give_a_pose(two_joints: str) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        rig = ChainRig(graph)
        shoulder, elbow = rig.joint_publisher("shoulder"), rig.joint_publisher("elbow")
        first, second = ("base", "t1"), ("r2", "t2")
        # Transforms of two scans.
        shoulder.publish(transform_of(1, plates=first))
        elbow.publish(transform_of(2, plates=second))
        shoulder.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 1e-3, 0.0])), plates=first))
        elbow.publish(transform_of(3, pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-3])), plates=second))
        rig.wait_for_poses(1)
        assert stamp_seconds(rig.poses) == [3]
        position = rig.poses[0].pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], [0.5, 1e-3, 1e-3], rtol=0.0, atol=1e-12)
        assert list(rig.joint_states[0].name) == ["shoulder", "elbow"]
        status = graph.wait_for_status("/chain_node: endpoint", "ok")
        assert values_of(status)["scans_incomplete"] == "2"
        named = [status.message for status in graph.diagnostics if status.name == "/chain_node: endpoint"]
        for joint in ("shoulder", "elbow"):
            assert f"no pose: {joint}: transform missing from a scan that the other joints sent" in named
        # One joint lost.
        shoulder.publish(transform_of(4, plates=first))
        elbow.publish(lost_transform(4, JointTransform.FAULT_OUT_OF_RANGE, plates=second))
        rig.wait_for_message("no pose: elbow is lost (OUT_OF_RANGE)")
        assert stamp_seconds(rig.poses) == [3]
        # An invalid stamp does not affect the following scans.
        unstamped = transform_of(6, plates=first)
        unstamped.header.stamp.nanosec = 1_000_000_000
        for message in (transform_of(5, plates=first), unstamped):
            shoulder.publish(message)
        rig.wait_for_message(
            "no pose: shoulder: the stamp of a transform is zero, or its nanoseconds are a second or more"
        )
        for seconds in (6, 7):
            shoulder.publish(transform_of(seconds, plates=first))
        for seconds in (5, 6, 7):
            elbow.publish(transform_of(seconds, plates=second))
        rig.wait_for_poses(4)
        assert stamp_seconds(rig.poses) == [3, 5, 6, 7]
        values = values_of(graph.wait_for_status("/chain_node: endpoint", "ok"))
        assert (values["scans_refused"], values["scans_incomplete"]) == ("2", "2")


@pytest.mark.parametrize("wrong", [2, 900])
def test_a_wrong_stamp_of_one_joint_costs_one_pose(two_joints: str, wrong: int) -> None:
    with chain_node(urdf=two_joints, endpoint_frame="t2", **LOSSLESS), Graph() as graph:
        rig = ChainRig(graph)
        shoulder, elbow = rig.joint_publisher("shoulder"), rig.joint_publisher("elbow")
        for second in range(10, 20):
            shoulder.publish(transform_of(wrong if second == 15 else second, plates=("base", "t1")))
        for second in range(10, 20):
            elbow.publish(transform_of(second, plates=("r2", "t2")))
        rig.wait_for_poses(9)
        assert stamp_seconds(rig.poses) == [*range(10, 15), *range(16, 20)]

        def incomplete() -> set[str]:
            statuses = [status for status in graph.diagnostics if status.name == "/chain_node: endpoint"]
            return {values_of(status).get("scans_incomplete", "") for status in statuses}

        graph.wait_until(lambda: "2" in incomplete(), "a report of the wrong stamp and of the scan that lacks it")


def test_a_joint_without_publisher_is_named_and_a_late_joint_is_awaited(two_joints: str) -> None:
    waiting = {**LOSSLESS, "max_wait": 0.2, "freshness.max_silence": 0.2}
    with chain_node(urdf=two_joints, endpoint_frame="t2", **waiting), Graph() as graph:
        rig = ChainRig(graph)
        shoulder = rig.joint_publisher("shoulder")
        status = rig.wait_for_message("no input on /elbow/transform since activation")
        assert status.level == b"\x02"
        assert float(values_of(status)["since"]) > 0.0
        elbow = rig.joint_publisher("elbow")
        shoulder.publish(transform_of(1, plates=("base", "t1")))
        wait_for_value(graph, "/chain_node: endpoint", "scans_incomplete", "1")
        elbow.publish(transform_of(1, plates=("r2", "t2")))
        later = iter(range(2, 1000))

        def both() -> None:
            second = next(later)
            shoulder.publish(transform_of(second, plates=("base", "t1")))
            elbow.publish(transform_of(second, plates=("r2", "t2")))

        graph.wait_until(lambda: bool(rig.poses), "a pose of a scan that is whole", both)
        assert 1 not in stamp_seconds(rig.poses)


def test_a_refused_transform_is_the_reason_of_its_incomplete_scan(two_joints: str) -> None:
    """The state says so at once, and again when the scan of the other joint is closed."""
    with chain_node(urdf=two_joints, endpoint_frame="t2", **{**LOSSLESS, "max_wait": 0.2}), Graph() as graph:
        states = graph.collect(EndpointState, "endpoint/state")
        rig = ChainRig(graph)
        shoulder, elbow = rig.joint_publisher("shoulder"), rig.joint_publisher("elbow")
        elbow.publish(transform_of(1, plates=("r2", "t2")))
        shoulder.publish(transform_of(1, plates=("base", "t2")))
        graph.wait_until(lambda: len(states) == 2, "both states")
    reason = "shoulder: transforms from 'base' to 't2' arrive; expected 'base' to 't1', as in the URDF"
    for state in states:
        assert (state.header.stamp.sec, state.state, state.joint) == (1, EndpointState.STATE_LOST, "shoulder")
        assert state.reason == reason


BEAMS = """format: posor_beams
version: 1
name: two
provenance: {source: test, method: none, date: none}
gravity: {value: [0.0, 0.0, -10.0], unit: m/s^2}
beams:
  - joint: beam
    uncertainty:
      position: {value: [3.0e-6, 0.0, 0.0], unit: m}
      orientation: {value: [0.0, 0.0, 0.0], unit: rad}
    sag:
      tube:
        outer_diameter: {value: 0.05, unit: m}
        inner_diameter: {value: 0.04, unit: m}
        modulus: {value: 69.0e9, unit: Pa}
        density: {value: 2700, unit: kg/m^3}
      gimbals: {value: [0.0, 0.2], unit: m}
      uncertainty: {value: 0.0, unit: "1"}
"""


def test_a_beams_file_adds_sag_and_uncertainty_to_the_pose(two_joints: str, tmp_path: Path) -> None:
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS, encoding="utf-8")
    chain = load_chain(Path(two_joints), "t2", beams)
    still = MeasuredJoint(pin.SE3.Identity(), np.zeros((6, 6)))
    sag = chain.estimate({"shoulder": still, "elbow": still}).T_base_endpoint.translation[2]
    assert sag < -1e-6
    with chain_node(urdf=two_joints, endpoint_frame="t2", beams=str(beams), **LOSSLESS), Graph() as graph:
        rig = ChainRig(graph)
        rig.joint_publisher("shoulder").publish(transform_of(1, plates=("base", "t1")))
        rig.joint_publisher("elbow").publish(transform_of(1, plates=("r2", "t2")))
        rig.wait_for_poses(1)
        assert rig.poses[0].pose.position.z == sag
        covariance = np.reshape(rig.with_covariance[0].pose.covariance, (6, 6))
        assert covariance[0, 0] == pytest.approx(2e-12 + 9e-12, rel=1e-6)
        assert values_of(graph.wait_for_status("/chain_node: endpoint", "ok"))["beams"] == str(beams)


def test_beams_in_motion_sag_differently_from_beams_at_rest(two_joints: str, tmp_path: Path) -> None:
    """The shoulder rises ever faster, so the beam weighs a little more than at rest."""
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS, encoding="utf-8")
    moving = {**LOSSLESS, "beams": str(beams), "acceleration_window": 10.0}
    chain = load_chain(Path(two_joints), "t2", beams)
    elbow_at = MeasuredJoint(pin.SE3.Identity(), np.zeros((6, 6)))
    acceleration = 8e-4  # the last scan is 19.6 mm from the nominal joint; the limit is 20 mm
    with chain_node(urdf=two_joints, endpoint_frame="t2", **moving), Graph() as graph:
        rig = ChainRig(graph)
        shoulder, elbow = rig.joint_publisher("shoulder"), rig.joint_publisher("elbow")
        scans = 8
        for second in range(scans):
            up = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5 * acceleration * second**2]))
            shoulder.publish(transform_of(second + 1, up, plates=("base", "t1")))
            elbow.publish(transform_of(second + 1, plates=("r2", "t2")))
        rig.wait_for_poses(scans)
        joints = {"shoulder": MeasuredJoint(up, np.zeros((6, 6))), "elbow": elbow_at}
        heavier = chain.estimate(joints, {"beam": np.array([0.0, 0.0, acceleration])}).T_base_endpoint
        at_rest = chain.estimate(joints).T_base_endpoint
        found = rig.poses[-1].pose.position.z
        assert at_rest.translation[2] - heavier.translation[2] > 2e-11
        assert found == pytest.approx(heavier.translation[2], abs=1e-14)


def test_a_beams_file_of_another_arm_is_refused(
    two_joints: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    beams = tmp_path / "beams.yaml"
    beams.write_text(BEAMS.replace("joint: beam", "joint: boom"), encoding="utf-8")
    sentence = f"URDF {two_joints}: has no fixed joint 'boom', which the beams file names; expected one of beam."
    parameters = {"urdf": two_joints, "endpoint_frame": "t2", "beams": str(beams)}
    assert run_refused_node(ChainNode, parameters, capfd) == (1, [sentence])
